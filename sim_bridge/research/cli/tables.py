"""The paper's tables and figures as commands: each prints, and writes Markdown, CSV, a picture."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.running import (
    OUT,
    Cluster,
    Jobs,
    Out,
    finish,
    progress_bar,
    run_journaled,
    workers_of,
)

app = typer.Typer()


@app.command()
def table1(
    out: Out = OUT,
    jobs: Jobs = 0,
    cluster: Cluster = None,
    rounds: Annotated[int, typer.Option(help="rounds")] = 10,
    graphs: Annotated[int, typer.Option(help="graphs a round")] = 10,
    seed: Annotated[int, typer.Option(help="of graphs and winds")] = 13,
    gusty: Annotated[bool, typer.Option(help="the gusty set, which is ours")] = False,
    wind_log: Annotated[Path | None, typer.Option(help="replay a recording instead")] = None,
) -> None:
    """Table 1: SER, RER, GER and BER on random graphs, 4 and 8 wind classes."""
    from dataclasses import replace

    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.tables.table1 import (
        GUSTY_PARAMS,
        NOTE,
        Table1Cell,
        Table1Params,
        cells_of,
        draw,
        fly,
        jobs_of,
        recorded_wind,
        sheet,
    )

    params = GUSTY_PARAMS if gusty else Table1Params()
    params = replace(params, rounds=rounds, graphs=graphs, seed=seed)
    wind = recorded_wind(wind_log, longest_mission_s=300.0) if wind_log else None
    title = "Table 1" + (", gusty set (ours)" if gusty else "")
    title += f", recording {wind_log.stem}" if wind_log else ""
    stem = "table1" + ("_gusty" if gusty else "") + (f"_{wind_log.stem}" if wind_log else "")
    work = jobs_of(params, wind)
    kept = Journal(out / f"{stem}.partial", digest_of(work), list[Table1Cell])
    cells = cells_of(run_journaled(title, work, fly, workers_of(jobs, cluster), kept), params)
    finish(
        sheet(title, cells, NOTE.format(graphs=graphs, share=params.paper_share), params), out, stem
    )
    draw(cells, title, out / f"{stem}.png")
    kept.remove()


@app.command()
def table2(
    out: Out = OUT,
    jobs: Jobs = 0,
    cluster: Cluster = None,
    trials: Annotated[int, typer.Option(help="trials", min=1)] = 10,
    seed: Annotated[int, typer.Option(help="of towns, customers and winds", min=0)] = 2611,
    llm_url: Annotated[
        str | None, typer.Option(help="an OpenAI-compatible server: a row clustered by its LLM")
    ] = None,
    llm_model: Annotated[str | None, typer.Option(help="the model's name there")] = None,
    llm_key: Annotated[Path | None, typer.Option(help="a file with the key, if any")] = None,
) -> None:
    """Table 2: what each part is worth, over days of 20 customers, 4 drones and one truck.

    Example: sim-bridge research table2 --trials 2 --jobs 2
    """
    from ground_station.adapters.llm import LlmParams
    from sim_bridge.adapters.journal import Journal, digest_of
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
    work = experiment.trials_of(trials, seed, llm)
    kept = Journal(out / "table2.partial", digest_of(work), experiment.TrialFigures)
    measured = run_journaled("Table 2", work, experiment.fly_trial, workers_of(jobs, cluster), kept)
    found = experiment.by_variant(work, measured)
    finish(experiment.sheet(found, seed), out, "table2")
    experiment.draw(found, out / "table2.png")
    kept.remove()


@app.command()
def lambda_sweep(
    out: Out = OUT,
    jobs: Jobs = 0,
    cluster: Cluster = None,
    graphs: Annotated[int, typer.Option(help="graphs")] = 100,
) -> None:
    """Outcomes against the risk weight lambda and the battery."""
    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.tables import lambda_sweep as experiment

    work = experiment.jobs_of(graphs)
    kept = Journal(out / "lambda_sweep.partial", digest_of(work), list[experiment.SweepCell])
    points = experiment.points_of(
        run_journaled("lambda sweep", work, experiment.fly, workers_of(jobs, cluster), kept)
    )
    finish(experiment.sheet(points), out, "lambda_sweep")
    experiment.draw(points, out / "lambda_sweep.png")
    kept.remove()


@app.command()
def energy_speed(
    out: Out = OUT, airframe: Annotated[str, typer.Option(help="name or file")] = "octo8"
) -> None:
    """Energy per kilometre against speed by wind and payload, with both power models."""
    from companion.adapters.files.params import read_airframe
    from sim_bridge.research.tables import energy_speed as experiment

    believed = read_airframe(airframe)
    found = experiment.curves(believed)
    finish(experiment.sheet(found, believed), out, "energy_speed")
    experiment.draw(found, out / "energy_speed.png")


@app.command()
def speed_to_fly(
    out: Out = OUT,
    airframe: Annotated[
        list[str] | None, typer.Option(help="in params/airframes and params/truth; default: m100")
    ] = None,
) -> None:
    """The speed to fly against the least true Wh/km by brute force, and the saving over cruise.

    Example: sim-bridge research speed-to-fly --airframe m100 --airframe octo8
    """
    from companion.adapters.files.params import params_dir, read_airframe
    from sim_bridge.research.tables import speed_to_fly as experiment
    from sim_bridge.truth.params import load_airframe

    for name in airframe or ["m100"]:
        believed = read_airframe(name)
        truth = load_airframe(params_dir() / "truth" / f"{believed.name}.toml")
        with progress_bar() as bar:
            shown = bar.add_task(name, total=len(experiment.LOADS_FRAC))
            cells = experiment.envelope(believed, truth, lambda b=bar, t=shown: b.advance(t))
        stem = f"speed_to_fly_{believed.name}"
        finish(experiment.sheet(cells, believed), out, stem)
        experiment.write_cells(cells, out / f"{stem}_all.csv")
        experiment.draw(believed, truth, out / f"{stem}.png")


@app.command()
def towns(
    out: Out = OUT,
    jobs: Jobs = 0,
    cluster: Cluster = None,
    rounds: Annotated[int, typer.Option(help="rounds")] = 10,
    towns: Annotated[int, typer.Option(help="towns a round")] = 10,
    budget_wh: Annotated[float, typer.Option(help="B")] = 50.0,
    max_loss: Annotated[float, typer.Option(help="BER's bound in every town")] = 0.01,
) -> None:
    """Outcomes over generated towns whose wind differs from edge to edge."""
    import numpy as np

    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.tables import urban_table
    from sim_bridge.research.tables.urban_scene import TownParams, generate_town

    work = [urban_table.TownJob(t, budget_wh, max_loss) for t in range(rounds * towns)]
    kept = Journal(out / "towns.partial", digest_of(work), dict[str, list[float]])
    flown = run_journaled("towns", work, urban_table.fly_town, workers_of(jobs, cluster), kept)
    found = urban_table.by_planner(flown, rounds)
    finish(urban_table.sheet(found, budget_wh, max_loss), out, "towns")
    town = generate_town("town-0", TownParams(), np.random.default_rng([urban_table.TOWN_SEED, 0]))
    urban_table.draw_town(town, out / "towns.png")
    kept.remove()


@app.command()
def frontier(
    out: Out = OUT,
    graphs: Annotated[int, typer.Option(help="graphs, each with B = 100 and 50")] = 20,
    seed: Annotated[int, typer.Option(help="of graphs and winds")] = 404,
    jobs: Jobs = 0,
    cluster: Cluster = None,
) -> None:
    """How far BER is below the frontier on random chains; goes on where it was stopped."""
    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.campaign import frontier_check as check

    cases = check.cases(graphs, seed)
    kept = Journal(out / "frontier.partial", digest_of(cases), list[check.Distance])
    found = run_journaled("frontier", cases, check.check, workers_of(jobs, cluster), kept)
    finish(check.sheet([d for part in found for d in part], seed), out, "frontier")
    kept.remove()


@app.command()
def paths(
    out: Out = OUT,
    airspeed: Annotated[float, typer.Option(help="m/s")] = 15.0,
    bank: Annotated[float, typer.Option(help="bank limit, degrees")] = 25.0,
    wind: Annotated[float, typer.Option(help="m/s")] = 7.0,
    wind_from: Annotated[float, typer.Option(help="degrees, where it blows from")] = 270.0,
) -> None:
    """Draw a path between two poses in calm air and in wind, around buildings, and as items.

    Example: sim-bridge research paths --wind 10 --wind-from 180
    """
    from sim_bridge.research.dubins.picture import draw

    typer.echo(f"wrote {draw(out / 'paths.png', airspeed, bank, wind, wind_from)}")
