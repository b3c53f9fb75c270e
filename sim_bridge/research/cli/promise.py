"""`sim-bridge research promise`: is the P(home) that the return budget states calibrated?"""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.running import (
    Cluster,
    run_journaled,
    workers_of,
    write_whole,
)

app = typer.Typer()


@app.command()
def promise(
    wind_log: Annotated[
        list[Path] | None,
        typer.Option(
            help="Recording (t_s, wind_speed_mps, wind_from_deg); repeat it to pool several."
            " Bad rows are named and left out."
        ),
    ] = None,
    simulated_days: Annotated[
        int,
        typer.Option(min=0, help="Instead of recordings: so many independent hours of wind."),
    ] = 0,
    airspeed: Annotated[
        float | None,
        typer.Option(
            help="m/s through the air. Default: the mean wind over 0.4 (hard, easy), 0.63 (stress)."
        ),
    ] = None,
    tier: Annotated[
        str,
        typer.Option(
            help="Round trips that need, in the last 30 s of wind, 50 to 110 % of the budget (hard,"
            " stress) or 20 to 110 % (easy)."
        ),
    ] = "hard",
    missions: Annotated[int, typer.Option(help="How many missions.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Of starts, directions, distances, noise.")] = 1,
    max_loss: Annotated[
        float, typer.Option(help="Share of the vehicles that the operator accepts to lose.")
    ] = 0.01,
    pack_std: Annotated[
        float,
        typer.Option(
            help="How much packs differ from what is believed of them, as a share of the budget"
            " (1 sigma); the gate is told how much."
        ),
    ] = 0.0,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0: all cores.")] = 0,
    cluster: Cluster = None,
    json: Annotated[Path | None, typer.Option(help="Write the verdict here.")] = None,
    out: Annotated[
        Path, typer.Option(help="Folder for tables, the reliability diagram and the journal.")
    ] = Path("logs/promise"),
) -> None:
    """Fly missions through recorded wind by the flight's gate, and hold it to what it said.

    Straight out, deliver, straight back, thousands of times; PX4's time rule, fixed thresholds and
    a clairvoyant fly the same missions. The gate learns its spread and its risk only from blocks
    that are not judged. Ctrl-C prints what was flown so far and keeps it: the same command goes on.

    Example: sim-bridge research promise --wind-log site.csv --tier hard --json promise.json
    """
    import msgspec

    from companion.adapters.files.params import params_dir
    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.promise import flying, sheets
    from sim_bridge.research.promise.world import Setting, digest

    logs = tuple(wind_log or ())
    if json is not None and not json.parent.is_dir():
        raise LeewayError(f"{json}: its folder does not exist")
    setting = Setting(
        wind_logs=tuple(str(path) for path in logs),
        files=tuple(digest(path) for path in logs),
        simulated_days=simulated_days,
        airspeed_mps=airspeed,
        tier=tier,
        missions=missions,
        seed=seed,
        max_loss=max_loss,
        airframe="m100",
        truth_file=str(params_dir() / "truth" / "m100.toml"),
        wind_process="coast",
        pack_std_frac=pack_std,
    )
    world = flying.world_of(setting)
    for recording in world.recordings:
        for words in recording.troubles:
            typer.echo(f"sim-bridge promise: {words}", err=True)
    out.mkdir(parents=True, exist_ok=True)
    name = digest_of(setting)[:12]
    folds = [flying.FoldWork(setting, fold) for fold in range(len(world.folds))]
    learned = Journal(out / f"{name}.folds.partial", digest_of(folds), flying.Fitted)
    fitted = run_journaled("fitting", folds, flying.fit_fold, workers_of(jobs, cluster), learned)
    works = flying.works_of(world, fitted)
    kept = Journal(out / f"{name}.partial", digest_of(works), list[flying.GateFlight])
    try:
        flown = run_journaled("missions", works, flying.fly, workers_of(jobs, cluster), kept)
    except (typer.Exit, SystemExit):  # Ctrl-C, and SIGTERM
        if done := kept.read():
            so_far = sheets.result_of(world, fitted, done.values())
            typer.echo(sheets.rules_sheet(world, so_far).markdown())
            typer.echo(sheets.reliability_sheet(so_far).markdown())
        raise
    result = sheets.result_of(world, fitted, flown)
    rules, reliability = sheets.rules_sheet(world, result), sheets.reliability_sheet(result)
    written = [*rules.write(out, "rules"), *reliability.write(out, "reliability")]
    picture = out / "reliability.png"
    sheets.draw(result, sheets.title_of(world, setting.missions), picture)
    if json is not None:
        content = msgspec.json.format(msgspec.json.encode(result.verdict), indent=1)
        write_whole(json, content + b"\n")
        written.append(json)
    typer.echo(rules.markdown())
    typer.echo(reliability.markdown())
    shown = ", ".join(str(path) for path in (*written, picture))
    typer.echo(f"wrote {shown}", err=True)
    learned.remove()
    kept.remove()
