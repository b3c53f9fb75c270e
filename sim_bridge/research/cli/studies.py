"""Studies of the product's promises: promise, rates, monitor, fleet-wind, and recorded flights."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import command_class_with_options
from sim_bridge.research.cli.options import (
    EXPERIMENT_OPTIONS,
    Airframe,
    MaxLoss,
    Tier,
    TierOption,
    create_experiment_run,
    seed_option_or,
)

app = typer.Typer()


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS, "seed"))
def promise(
    wind_log: Annotated[
        list[Path] | None,
        typer.Option(
            help="Recording (t_s, wind_speed_mps, wind_from_deg); repeat it to pool several."
            " Bad rows are named and left out."
        ),
    ] = None,
    simulated_days: Annotated[
        int, typer.Option(min=0, help="Simulated days of an hour each, in place of --wind-log.")
    ] = 0,
    airspeed: Annotated[
        float | None,
        typer.Option(
            min=3.0,
            max=30.0,
            help="Airspeed, m/s. Default: mean wind / 0.4 (hard, easy) or / 0.63 (stress).",
        ),
    ] = None,
    tier: TierOption = Tier.HARD,
    missions: Annotated[int, typer.Option(min=1, help="Number of missions.")] = 1000,
    max_loss: MaxLoss = 0.01,
) -> None:
    """Fly missions through recorded wind by the flight's gate, and compare outcomes with P(home).

    Straight out, deliver, straight back, thousands of times; PX4's time rule, fixed thresholds and
    a clairvoyant fly the same missions. The gate learns its spread and its risk only from blocks
    that are not judged. Ctrl-C keeps what is done: the same command goes on.

    Example: sim-bridge research promise --wind-log site.csv --tier hard --json promise.json
    """
    from sim_bridge.research.promise.recording import file_sha256_prefix
    from sim_bridge.research.promise.report import evaluate_promise
    from sim_bridge.research.promise.world import PromiseSetting

    run, logs = create_experiment_run("logs/promise"), tuple(wind_log or ())
    setting = PromiseSetting(
        wind_logs=tuple(str(path) for path in logs),
        files=tuple(file_sha256_prefix(path) for path in logs),
        simulated_days=simulated_days,
        airspeed_mps=airspeed,
        tier=tier.value,
        missions=missions,
        seed=seed_option_or(1),
        max_loss=max_loss,
    )
    run.print_and_write_report(evaluate_promise(setting, run))


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS, "seed"))
def rates(
    samples: Annotated[int, typer.Option(min=20, help="Samples per level, rounded to tens.")] = 300,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each rate.")] = 2,
    plain: Annotated[
        int, typer.Option(min=250, help="Deliveries by plain Monte Carlo, for the check.")
    ] = 4000,
) -> None:
    """Estimate what rates of 1e-2, 1e-3 and 1e-4 losses per flight hour lose, and what they cost.

    The gate flies deliveries on simulated days, each with its own wind, sensor noise and pack. Rare
    losses are found by subset simulation, which is checked against plain Monte Carlo where that can
    be had. Ctrl-C keeps what is done: the same command goes on.

    Example: sim-bridge research rates --samples 200 --seed 2
    """
    from sim_bridge.research.rates.study import estimate_loss_rates

    requested = (1e-2, 1e-3, 1e-4)
    run, per_level = create_experiment_run("logs/rates"), 10 * round(samples / 10)
    run.print_and_write_report(
        estimate_loss_rates(requested, per_level, repeats, plain, seed_option_or(1), run)
    )


@app.command(cls=command_class_with_options("json_out", "out", "seed"))
def monitor(
    services: Annotated[
        int, typer.Option(min=100, help="Services of 500 flights without a fault.")
    ] = 10_000,
) -> None:
    """Follow simulated services by the companion's own bets, on draws of days and flights.

    Example: sim-bridge research monitor --services 10000 --seed 1 --out logs/monitor
    """
    from sim_bridge.research.monitor.study import evaluate_monitor

    create_experiment_run("logs/monitor").print_and_write_report(
        evaluate_monitor(services, seed_option_or(1))
    )


@app.command("fleet-wind", cls=command_class_with_options(*EXPERIMENT_OPTIONS, "seed"))
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
    drones: Annotated[int, typer.Option(min=1, max=100, help="Drones that report wind.")] = 8,
    hovering: Annotated[
        int, typer.Option(min=0, help="Number of drones that hover or wait; the others fly orders.")
    ] = 0,
    draws: Annotated[int, typer.Option(min=0, help="Drawn fields per half, for errors.")] = 4,
    alert_draws: Annotated[
        int, typer.Option(min=0, help="Drawn fields per half, for alerts.")
    ] = 12,
    missions: Annotated[int, typer.Option(min=0, help="Missions per policy; 0: none.")] = 0,
    mission_draws: Annotated[
        int, typer.Option(min=1, help="Drawn fields per half, for missions.")
    ] = 3,
    wind_air: Annotated[
        float, typer.Option(min=0.05, max=1.5, help="Mean wind / airspeed of the missions.")
    ] = 0.4,
    tier: TierOption = Tier.HARD,
    max_loss: MaxLoss = 0.01,
) -> None:
    """Compare own wind estimates with the fleet's, in fields that lose coherence with distance.

    Errors at each drone's own place and where nobody is, with honest members and with one that
    reports false data, is frozen or silent; fronts reported ahead, and false alerts. With
    --missions also deliveries, decided by the flight's own gate, with own wind alone and with what
    the fleet reports, where both lose the same. Ctrl-C keeps what is done: the same command goes
    on.

    Example: sim-bridge research fleet-wind --wind-log site.csv --drones 8 --json fleet.json
    """
    from sim_bridge.research.fleet_wind.fields import create_validated_setting
    from sim_bridge.research.fleet_wind.missions import MissionSetting
    from sim_bridge.research.fleet_wind.study import evaluate_fleet_wind

    if tier is Tier.STRESS:
        raise LeewayError("--tier stress: expected hard or easy, with --wind-air")
    if max(draws, alert_draws, missions) < 1:
        raise LeewayError(
            "--draws 0, --alert-draws 0, --missions 0: expected one of them to be 1 or more"
        )
    run = create_experiment_run("logs/fleet-wind")
    setting = create_validated_setting(wind_log, field, drones, hovering, seed_option_or(1))
    requested = MissionSetting(setting, mission_draws, missions, wind_air, tier.value, max_loss)
    run.print_and_write_report(evaluate_fleet_wind(setting, draws, alert_draws, requested, run))


@app.command("real-flights", cls=command_class_with_options(*EXPERIMENT_OPTIONS))
def real_flights(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Folder of evaluated flights, with parameters.csv."),
    ],
    fit: Annotated[
        Path | None,
        typer.Option(
            help="Folder of flights to fit; without it each day is predicted from the others."
        ),
    ] = None,
    airframe: Airframe = "m100",
) -> None:
    """Predict recorded flights from those of other days: energy with its bound, and the wind.

    The airframe is fitted by `companion calibrate`'s own code; nothing is fitted to a day that
    judges it. What is wrong with a flight is reported by its name and row on stderr.

    Example: sim-bridge research real-flights m100_flights --json real.json
    """
    from sim_bridge.research.real_flights.figures import evaluate_real_flights

    run = create_experiment_run("logs/real_flights")
    run.print_and_write_report(evaluate_real_flights(folder, fit, airframe, run))


@app.command("windbench", cls=command_class_with_options(*EXPERIMENT_OPTIONS))
def windbench(
    folders: Annotated[
        list[str],
        typer.Argument(
            metavar="DIR[=AIRFRAME]...",
            help="Folders of flights with an anemometer: parameters.csv and N.csv(.gz), or CSV logs"
            " with airspeed_mps or wind_to_n_ref_mps and wind_to_e_ref_mps. After = the airframe of"
            " this folder.",
        ),
    ],
    estimator: Annotated[
        list[str] | None,
        typer.Option(help="A further estimator: entry point or MODULE:CLASS; repeatable."),
    ] = None,
    airframe: Airframe = "m100",
    symmetric: Annotated[
        bool,
        typer.Option("--symmetric", help="Equal frontal and side drag (see companion calibrate)."),
    ] = False,
    starts_s: Annotated[
        float | None,
        typer.Option("--starts", min=10.0, help="Start anew in the air, every so many seconds."),
    ] = None,
) -> None:
    """Score multirotor wind estimators on real flights by one rule, each day from the others.

    They receive velocity and attitude; an anemometer judges the airspeed. The airframe is fitted to
    a folder's other days where there are three or more. What cannot be used is named on stderr.
    How to add an estimator: docs/how-to/wind-benchmark.md.

    Example: sim-bridge research windbench m100_flights my_flights --estimator mine:MyFilter
    """
    from sim_bridge.research.windbench.contest import score_estimators_on_flights

    requested = [
        (Path(path), own_airframe or airframe)
        for path, _, own_airframe in (words.partition("=") for words in folders)
    ]
    run = create_experiment_run("logs/windbench")
    run.print_and_write_report(
        score_estimators_on_flights(
            requested, tuple(estimator or ()), run, symmetric=symmetric, starts_s=starts_s
        )
    )
