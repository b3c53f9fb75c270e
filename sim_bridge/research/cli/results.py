"""`sim-bridge research results`: the pages of docs/results, each made by its commands."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from companion.core.base.errors import LeewayError

app = typer.Typer(add_completion=False)

INTERRUPTED = 130


@app.command()
def results(
    names: Annotated[list[str] | None, typer.Argument(help="Pages to make.")] = None,
    list_pages: Annotated[
        bool, typer.Option("--list", help="List the pages and what each needs.")
    ] = False,
    all_quick: Annotated[
        bool, typer.Option("--all-quick", help="Make every page of at most two minutes.")
    ] = False,
    out: Annotated[Path, typer.Option(help="Folder of the pages.")] = Path("docs/results"),
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of other people's data: pages that need it are skipped without."),
    ] = None,
) -> None:
    """Run the commands of a page of results and write it, with seed, commit, machine and date.

    Ctrl-C leaves the old page as it was; commands that can go on where they stopped do so on the
    same commit. What people have written below the page's mark is kept.

    Example: sim-bridge research results energy-speed paths
    """
    from sim_bridge.research.result_pages.registry import PAGES, by_name
    from sim_bridge.research.result_pages.write import make_page, missing

    if data is not None and not data.is_dir():
        raise LeewayError(f"--data {data}: no such folder")
    if list_pages:
        for page in PAGES:
            words = missing(page, data)
            typer.echo(f"{page.name:18} {page.minutes:5.1f} min  {page.shows}")
            if words:
                typer.echo(f"{'':18} {words}")
        return
    wanted = [page for page in PAGES if all_quick and page.is_quick]
    for name in names or []:
        page = by_name(name)
        if page is None:
            raise LeewayError(
                f"{name}: no such page; there are: {', '.join(p.name for p in PAGES)}"
            )
        wanted.append(page)
    if not wanted:
        raise LeewayError("results: expected names of pages, --all-quick or --list")
    console = Console(stderr=True)
    for page in wanted:
        if words := missing(page, data):
            typer.echo(f"{page.name}: skipped: {words}", err=True)
            continue
        try:
            file = make_page(page, out, data, console)
        except KeyboardInterrupt:
            typer.echo(f"{page.name}: stopped; the old page stays as it was", err=True)
            raise typer.Exit(INTERRUPTED) from None
        typer.echo(f"wrote {file}", err=True)
