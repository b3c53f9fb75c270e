"""The paper's experiments: campaigns on scenario files, its tables and its figures."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import command_class_with_options
from sim_bridge.research.cli.options import (
    EXPERIMENT_OPTIONS,
    create_experiment_run,
    run_experiment,
    seed_option_or,
)

app = typer.Typer()


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS, "seed"))
def campaign(
    scenarios: Annotated[list[Path], typer.Argument(help="Scenario files (delivery-scenario/1).")],
    planner: Annotated[
        list[str],
        typer.Option(
            help="Repeatable: ser, rer, ger, ber-paper, ber, clairvoyant, or a planner of another"
            " package: entry point or MODULE:CLASS (docs/reference/api.md)."
        ),
    ],
    missions: Annotated[int, typer.Option(help="Missions per scenario.")] = 2000,
    wind_classes: Annotated[
        int | None, typer.Option(help="Observed wind directions: 4 or 8.")
    ] = None,
    max_loss: Annotated[float, typer.Option(help="Accepted loss per mission (ber).")] = 0.01,
    risk_weight: Annotated[float, typer.Option(help="Risk weight lambda of the paper.")] = 1.0,
    levels: Annotated[int, typer.Option(min=2, help="Energy levels of the tables (ber).")] = 500,
) -> None:
    """Fly missions on scenarios with several planners in the same winds.

    Ctrl-C keeps what is done: the same command goes on.
    """
    from sim_bridge.research.campaign.campaign import build_campaign, build_campaign_report
    from sim_bridge.research.campaign.workbench import CampaignParams

    params = CampaignParams(
        missions=missions,
        seed=seed_option_or(1),
        wind_classes=wind_classes,
        max_loss=max_loss,
        risk_weight=risk_weight,
        levels=levels,
    )
    batch = build_campaign(scenarios, planner, params)
    run_experiment(batch, lambda found: build_campaign_report(batch.cases, found))


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS, "seed"))
def table1(
    rounds: Annotated[int, typer.Option(help="Number of rounds.")] = 10,
    graphs: Annotated[int, typer.Option(help="Graphs per round.")] = 10,
    gusty: Annotated[bool, typer.Option(help="Use the set of gusty winds.")] = False,
    wind_log: Annotated[
        Path | None, typer.Option(help="Recording in place of the drawn wind.")
    ] = None,
    readings: Annotated[
        bool, typer.Option(help="Fly readings of the published BER in place of the planners.")
    ] = False,
) -> None:
    """Table 1: SER, RER, GER and BER on random graphs, 4 and 8 wind classes. Default seed: 13."""
    from dataclasses import replace

    from sim_bridge.research.study.run import Experiment
    from sim_bridge.research.tables import table1 as experiment

    params = experiment.GUSTY_PARAMS if gusty else experiment.Table1Params()
    if readings and wind_log is not None:
        raise LeewayError("--readings: expected without --wind-log")
    params = replace(
        params, rounds=rounds, graphs=graphs, readings=readings, seed=seed_option_or(13)
    )
    work, kind = experiment.build_jobs(params, wind_log), list[experiment.CellShares]
    run_experiment(
        Experiment("Table 1", work, experiment.fly_all_cells_on_scenario, kind),
        lambda found: experiment.build_table1_report(found, params, gusty, wind_log),
    )


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS, "seed"))
def table2(
    trials: Annotated[int, typer.Option(help="Number of trials.", min=1)] = 10,
    llm_url: Annotated[
        str | None, typer.Option(help="OpenAI-compatible server: add a row clustered by its LLM.")
    ] = None,
    llm_model: Annotated[str | None, typer.Option(help="Name of the model.")] = None,
    llm_key: Annotated[Path | None, typer.Option(help="File with the API key.")] = None,
) -> None:
    """Table 2: ablation of the parts, over days of 20 customers, 4 drones and one truck.

    Default seed: 2611. Example: sim-bridge research table2 --trials 2 --jobs 2
    """
    from ground_station.adapters.llm import LlmParams
    from sim_bridge.research.study.run import Experiment
    from sim_bridge.research.tables import table2 as experiment

    if (llm_url is None) != (llm_model is None):
        raise LeewayError("--llm-url and --llm-model: expected both or neither")
    llm = None
    if llm_url is not None and llm_model is not None:
        try:
            key = None if llm_key is None else llm_key.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise LeewayError(f"--llm-key {llm_key}: {error}") from None
        llm = LlmParams(llm_url, llm_model, key)
    seed = seed_option_or(2611)
    work = experiment.build_trials(trials, seed, llm)
    run_experiment(
        Experiment("Table 2", work, experiment.fly_trial, experiment.TrialResult),
        lambda found: experiment.build_table2_report(work, found, seed),
    )


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS))
def lambda_sweep(
    graphs: Annotated[int, typer.Option(help="Number of graphs.")] = 100,
) -> None:
    """Outcomes against the risk weight lambda and the battery."""
    from sim_bridge.research.study.run import Experiment
    from sim_bridge.research.tables import lambda_sweep as experiment

    work, kind = experiment.build_jobs(graphs), list[tuple[experiment.Cell, list[float]]]
    run_experiment(
        Experiment("lambda sweep", work, experiment.fly_all_planners_on_graph, kind),
        experiment.build_lambda_sweep_report,
    )


@app.command(cls=command_class_with_options("out"))
def energy_speed(
    airframe: Annotated[str, typer.Option(help="Airframe: name or file.")] = "octo8",
) -> None:
    """Energy per kilometre against speed by wind and payload, with both power models."""
    from companion.adapters.files.params import read_airframe
    from sim_bridge.research.tables.energy_speed import build_energy_speed_report

    create_experiment_run().print_and_write_report(
        build_energy_speed_report(read_airframe(airframe))
    )


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS))
def towns(
    rounds: Annotated[int, typer.Option(help="Number of rounds.")] = 10,
    max_loss: Annotated[float, typer.Option(help="Accepted loss per mission (ber).")] = 0.01,
) -> None:
    """Outcomes over generated towns (B = 50 Wh) whose wind differs from edge to edge."""
    from sim_bridge.research.study.run import Experiment
    from sim_bridge.research.tables import urban_table as experiment

    work = [experiment.TownJob(t, 50.0, max_loss) for t in range(10 * rounds)]
    kind = list[tuple[str, list[float]]]
    run_experiment(
        Experiment("towns", work, experiment.fly_town_with_each_planner, kind),
        lambda found: experiment.build_towns_report(found, rounds, work[0]),
    )


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS, "seed"))
def frontier(
    graphs: Annotated[
        int, typer.Option(help="Number of graphs, each with B = 100 and 50 Wh.")
    ] = 20,
) -> None:
    """Distance of BER below the frontier on random chains. Default seed: 404."""
    from sim_bridge.research.campaign import frontier_check as check
    from sim_bridge.research.study.run import Experiment

    seed = seed_option_or(404)
    work, kind = check.build_cases(graphs, seed), list[check.FrontierDistance]
    run_experiment(
        Experiment("frontier", work, check.measure_frontier_distances, kind),
        lambda found: check.build_frontier_report(found, seed),
    )
