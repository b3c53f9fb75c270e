"""Command line of `companion fit-wind`. The implementation is imported when it runs."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()


@app.command(name="fit-wind")
def fit_wind_command(
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="CSV of t_s, wind_speed_mps, wind_from_deg, or folders of them: one per site."
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Output file (wind-process/1, TOML).")] = None,
    name: Annotated[
        str | None, typer.Option(help="Name of the process; default: name of the output file.")
    ] = None,
    parts: Annotated[
        int, typer.Option(min=2, max=3, help="Number of Ornstein-Uhlenbeck processes per axis.")
    ] = 3,
    beside: Annotated[
        list[str] | None,
        typer.Option(
            help="Also evaluate this process (a name in params/wind, or a file); repeatable."
        ),
    ] = None,
    params: Annotated[
        Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
    ] = None,
) -> None:
    """Fit a wind process to recordings and validate it on held-out data.

    Implausible samples are excluded and reported with their line. Fly with --wind-process site.

    companion fit-wind site.csv --out params/wind/site.toml
    """
    from rich.console import Console

    from companion.adapters.files.params import read_wind_process
    from companion.app.tools.fit_wind import (
        fit_and_cross_validate_wind,
        print_fit_and_scores,
        read_averaged_wind_recordings,
        write_wind_process_file,
    )

    label = name or (out.stem if out is not None else "fitted")
    others = tuple(read_wind_process(other, params) for other in beside or [])
    if out is not None and not out.parent.is_dir():
        raise LeewayError(f"{out.parent}: no such folder")
    recordings = read_averaged_wind_recordings(logs, lambda words: typer.echo(words, err=True))
    found = fit_and_cross_validate_wind(recordings, label, parts, others, Console(stderr=True))
    print_fit_and_scores(found, Console())
    if out is not None:
        words = ["companion", "fit-wind", *(p.name for p in logs), "--parts", str(parts)]
        words += [part for other in beside or [] for part in ("--beside", Path(other).name)]
        words += ["--name", label, "--out", out.name]
        write_wind_process_file(found, logs, shlex.join(words), out)
        typer.echo(f"wrote {out}", err=True)
