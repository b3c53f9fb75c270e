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
    bound: Annotated[
        bool,
        typer.Option(
            "--bound",
            help="Hold alerts against ideal tests, which know the law of the wind and of fronts: 15"
            " s of CPU a field. Over flat ground only.",
        ),
    ] = False,
    missions: Annotated[
        int, typer.Option(min=0, help="Missions to fly by each policy; 0: none.")
    ] = 0,
    mission_draws: Annotated[
        int, typer.Option(min=1, help="Fields drawn about each half, in which missions are flown.")
    ] = 3,
    wind_air: Annotated[
        float, typer.Option(min=0.05, max=1.5, help="Of missions: mean wind over airspeed.")
    ] = 0.4,
    tier: Annotated[
        str, typer.Option(help="Of missions, as promise has it: hard or easy.")
    ] = "hard",
    max_loss: Annotated[
        float,
        typer.Option(min=0.0001, max=0.5, help="Share of the missions that may be lost."),
    ] = 0.01,
    lie: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=20.0,
            help="Fly missions again with a desk that adds so many m/s of tailwind for the way home"
            " to all that it tells; 0: not.",
        ),
    ] = 0.0,
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
    lies, is frozen or mute; fronts told ahead, and false alerts. With --missions also deliveries,
    decided by the flight's own gate, with own wind alone and with what the fleet tells, where both
    lose the same. Ctrl-C keeps what is done: the same command goes on.

    Example: sim-bridge research fleet-wind --wind-log site.csv --drones 8 --json fleet.json
    """
    import msgspec

    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.fleet_wind import mission_verdict, sheets
    from sim_bridge.research.fleet_wind.mission_study import (
        MissionSetting,
        MissionsFlown,
        fly_missions,
        works_of,
    )
    from sim_bridge.research.fleet_wind.study import (
        DrawResult,
        FleetWindSetting,
        computed_flows,
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
    if tier not in ("hard", "easy"):
        raise LeewayError(f"--tier {tier}: expected hard or easy")
    if max(draws, alert_draws, missions) < 1:
        raise LeewayError(
            "--draws 0, --alert-draws 0, --missions 0: expected one of them to be 1 or more"
        )
    made = None if field is None else made_field(field)
    files = [wind_log or field or Path()]
    if made is not None and field is not None:
        if bound and (made.obstacles or made.flows):
            raise LeewayError(
                f"--field {field}: ideal tests know no obstacles, and this field has some: expected"
                " it without --bound"
            )
        files += [field.parent / one.file for one in made.flows]
    setting = FleetWindSetting(
        wind_log=None if wind_log is None else str(wind_log),
        field=None if field is None else str(field),
        file="".join(digest(file) for file in files),
        drones=drones,
        hovering=hovering,
        along=along if along is not None else made.coherence_along if made else 4.0,
        across=across if across is not None else made.coherence_across if made else 13.0,
        seed=seed,
    )
    computed_flows(setting)  # a grid that cannot be used is said before anything is drawn
    out.mkdir(parents=True, exist_ok=True)
    work = draws_of(setting, draws, alert_draws, bounds=bound)
    kept = Journal(out / f"{digest_of(work)[:12]}.partial", digest_of(work), DrawResult)
    workers = workers_of(jobs, cluster)
    done = run_journaled("fields", work, judge_draw, workers, kept)
    whole = summed(done)
    ordinary, front, alerts = whole.ordinary, whole.front, whole.alerts
    rows = sheets.error_rows(ordinary, front)
    shown = {}
    if rows:
        shown["error"] = sheets.error_sheet(done, rows, setting)
        shown["stages"] = sheets.stage_sheet(sheets.stage_rows(ordinary, front))
        shown["members"] = sheets.member_sheet(rows, ordinary)
    if alerts.fronts:
        shown["alerts"] = sheets.alert_sheet(alerts)
        if bound:
            shown["bounds"] = sheets.bound_sheet(sheets.bound_rows(alerts, whole.bounds))
    for stem, sheet in shown.items():
        sheet.write(out, stem)
        typer.echo(sheet.markdown())
    document = sheets.as_document(setting, whole)
    if missions:
        asked = MissionSetting(setting, mission_draws, missions, wind_air, tier, max_loss, lie)
        pieces = works_of(asked)
        name = digest_of(pieces)
        half_flown = Journal(out / f"{name[:12]}.missions.partial", name, MissionsFlown)
        flown = run_journaled("missions", pieces, fly_missions, workers, half_flown)
        ends = mission_verdict.MissionEnds.of(flown, seed)
        for stem, sheet in mission_verdict.mission_sheets(ends, flown, asked).items():
            sheet.write(out, stem)
            typer.echo(sheet.markdown())
        document["missions"] = mission_verdict.mission_row(ends, max_loss)
        document["missions_flown"] = mission_verdict.mission_setting_row(ends, flown, asked)
        half_flown.remove()
    sheets.draw_field(out / "fleet_wind.png", setting)
    if json is not None:
        write_whole(json, msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n")
    typer.echo(f"wrote {out}", err=True)
    kept.remove()
