"""`sim-bridge research fleet-wind`: what is the wind worth that a fleet shares?"""

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

app = typer.Typer()


@app.command("fleet-wind")
def fleet_wind(
    wind_log: Annotated[
        Path | None,
        typer.Option(
            help="Recording (t_s, wind_speed_mps, wind_from_deg): each half is judged with the"
            " process of the other."
        ),
    ] = None,
    field: Annotated[
        Path | None, typer.Option(help="Instead of a recording: a made field (wind-field/1).")
    ] = None,
    drones: Annotated[int, typer.Option(min=1, max=100, help="Who tell what they feel.")] = 8,
    hovering: Annotated[
        int, typer.Option(min=0, help="So many of them hover or wait; the others fly orders.")
    ] = 0,
    along: Annotated[
        float | None,
        typer.Option(help="Davenport's decay along the wind. Default: 4, or the field's."),
    ] = None,
    across: Annotated[
        float | None, typer.Option(help="Across the wind. Default: 13, or the field's.")
    ] = None,
    draws: Annotated[
        int, typer.Option(min=0, help="Fields drawn about each half, in which errors are judged.")
    ] = 4,
    alert_draws: Annotated[
        int, typer.Option(min=0, help="Fields drawn about each half, in which alerts are judged.")
    ] = 12,
    seed: Annotated[int, typer.Option(min=0, help="Of fields, ways, noise and fronts.")] = 1,
    json: Annotated[Path | None, typer.Option(help="Write all figures here.")] = None,
    jobs: Jobs = 0,
    cluster: Cluster = None,
    out: Annotated[
        Path, typer.Option(help="Folder for tables, the picture and the journal.")
    ] = Path("logs/fleet-wind"),
) -> None:
    """Wind known from own data alone against wind known by all, in fields that lose coherence.

    Errors at each drone's own place and where nobody is, with honest members and with one that
    lies, is frozen or mute; fronts told ahead, and false alerts. Ctrl-C keeps what is done: the
    same command goes on.

    Example: sim-bridge research fleet-wind --wind-log site.csv --drones 8 --json fleet.json
    """
    import msgspec

    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.fleet_wind import sheets
    from sim_bridge.research.fleet_wind.study import (
        DrawResult,
        FleetWindSetting,
        draws_of,
        judge_draw,
        made_field,
        summed,
    )
    from sim_bridge.research.promise.world import digest

    if (wind_log is None) == (field is None):
        raise LeewayError("expected either --wind-log or --field")
    if hovering > drones:
        raise LeewayError(f"--hovering {hovering}: expected at most --drones, {drones}")
    if max(draws, alert_draws) < 1:
        raise LeewayError("--draws 0, --alert-draws 0: expected one of them to be 1 or more")
    made = None if field is None else made_field(field)
    setting = FleetWindSetting(
        wind_log=None if wind_log is None else str(wind_log),
        field=None if field is None else str(field),
        file=digest(wind_log or field or Path()),
        drones=drones,
        hovering=hovering,
        along=along if along is not None else made.coherence_along if made else 4.0,
        across=across if across is not None else made.coherence_across if made else 13.0,
        seed=seed,
    )
    out.mkdir(parents=True, exist_ok=True)
    work = draws_of(setting, draws, alert_draws)
    kept = Journal(out / f"{digest_of(work)[:12]}.partial", digest_of(work), DrawResult)
    done = run_journaled("fields", work, judge_draw, workers_of(jobs, cluster), kept)
    ordinary, front, alerts = summed(done)
    rows = sheets.error_rows(ordinary, front)
    shown = {}
    if rows:
        shown["error"] = sheets.error_sheet(done, rows, setting)
        shown["members"] = sheets.member_sheet(rows, ordinary)
    if alerts.fronts:
        shown["alerts"] = sheets.alert_sheet(alerts)
    for stem, sheet in shown.items():
        sheet.write(out, stem)
        typer.echo(sheet.markdown())
    sheets.draw_field(out / "fleet_wind.png", setting)
    if json is not None:
        document = sheets.as_document(setting, ordinary, front, alerts)
        write_whole(json, msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n")
    typer.echo(f"wrote {out}", err=True)
    kept.remove()
