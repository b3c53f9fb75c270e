"""The command line of `companion fit-wind`; what it does is imported when it runs."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()


@app.command(name="fit-wind")
def fit_wind_command(
    logs: Annotated[
        list[Path], typer.Argument(help="Recordings: CSV of t_s, wind_speed_mps, wind_from_deg.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Write the process here, a wind-process/1 TOML file.")
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="The process's name; default: that of the file written.")
    ] = None,
    parts: Annotated[
        int, typer.Option(min=2, max=3, help="Ornstein-Uhlenbeck processes on each axis.")
    ] = 3,
    beside: Annotated[
        list[str] | None,
        typer.Option(
            help="Also judge this process (a name in params/wind, or a file), without fitting it."
        ),
    ] = None,
    params: Annotated[
        Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
    ] = None,
) -> None:
    """Fit how wind changes to recordings, and judge it on wind that was held out.

    Example: companion fit-wind site.csv --out params/wind/site.toml, then fly with
    --wind-process site. Samples that cannot be right are left out and named by line.
    """
    from rich.console import Console

    from companion.adapters.files.params import read_wind_process
    from companion.app.tools.fit_wind import fit_wind, read_recordings, show, write_process

    label = name or (out.stem if out is not None else "fitted")
    others = tuple(read_wind_process(other, params) for other in beside or [])
    if out is not None and not out.parent.is_dir():
        raise LeewayError(f"{out.parent}: no such folder")
    recordings = read_recordings(logs, lambda words: typer.echo(words, err=True))
    found = fit_wind(recordings, label, parts, others, Console(stderr=True))
    show(found, Console())
    if out is not None:
        words = ["companion", "fit-wind", *(p.name for p in logs), "--parts", str(parts)]
        words += [part for other in beside or [] for part in ("--beside", Path(other).name)]
        words += ["--name", label, "--out", out.name]
        write_process(found, logs, shlex.join(words), out)
        typer.echo(f"wrote {out}", err=True)
