"""`sim-bridge research rates`: losses per flight hour, by simulation of rare events."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.running import (
    Cluster,
    Jobs,
    run_journaled,
    workers_of,
    write_whole,
)

app = typer.Typer(add_completion=False)


@app.command("rates")
def rates(
    rate: Annotated[
        list[float] | None,
        typer.Option(help="Losses per flight hour that are accepted; default 1e-2, 1e-3, 1e-4."),
    ] = None,
    samples: Annotated[int, typer.Option(min=20, help="Of each level, rounded to tens.")] = 300,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each rate.")] = 2,
    plain: Annotated[
        int, typer.Option(min=250, help="Deliveries by plain Monte Carlo, for the check.")
    ] = 4000,
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn.")] = 1,
    json: Annotated[Path | None, typer.Option(help="Every figure as JSON.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the tables.")] = Path("logs/rates"),
    jobs: Jobs = 0,
    cluster: Cluster = None,
) -> None:
    """Say what an accepted rate of losses per flight hour loses in simulation, and what it costs.

    The gate flies deliveries on simulated days, each with its own wind, sensor noise and pack. Rare
    losses are found by subset simulation, which is checked against plain Monte Carlo where that can
    be had. Ctrl-C keeps what is done: the same command goes on.

    Example: sim-bridge research rates --rate 1e-3 --seed 2
    """
    import msgspec

    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.rates.sheets import check_sheet, choice_sheet
    from sim_bridge.research.rates.study import (
        CHECKED_RATE,
        PLAIN,
        SUBSET,
        RateRun,
        row_of,
        run_work,
        works,
    )

    asked = tuple(rate or (1e-2, 1e-3, 1e-4))
    for one in asked:
        if not 1e-6 <= one <= 1.0:
            raise LeewayError(f"--rate {one:g}: 1e-6 to 1 expected")
    work = works(asked, 10 * round(samples / 10), repeats, plain, seed)
    out.mkdir(parents=True, exist_ok=True)
    kept = Journal(out / f"{digest_of(work)[:12]}.partial", digest_of(work), RateRun)
    runs = run_journaled("rates", work, run_work, workers_of(jobs, cluster), kept)
    chosen = [row_of(one, SUBSET, runs) for one in asked]
    checked = row_of(CHECKED_RATE, PLAIN, runs), row_of(CHECKED_RATE, SUBSET, runs)
    written = []
    for stem, sheet in (("choice", choice_sheet(chosen)), ("check", check_sheet(*checked))):
        written += sheet.write(out, stem)
        typer.echo(sheet.markdown())
    if json is not None:
        content = {"format": "rates/1", "rows": [*chosen, *checked], "runs": runs}
        write_whole(json, msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n")
        written.append(json)
    typer.echo("wrote " + ", ".join(str(path) for path in written), err=True)
    kept.remove()
