"""`sim-bridge avoid`: drones among drones and buildings, by one policy or another."""

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from companion.core.base.errors import LeewayError
from sim_bridge.adapters.wall_clock import cpu_s
from sim_bridge.research.cli.campaign import INTERRUPTED
from sim_bridge.research.cli.experiments import OUT, finish, progress_bar

if TYPE_CHECKING:
    from sim_bridge.research.avoidance.yardsticks import Pilot

app = typer.Typer(add_completion=False)

TIMED_EPISODES = 5
FLOWN_POLICY = "avoid"


class PolicyChoice(StrEnum):
    """Who decides; `_filtered`, and maddpg, are behind the safety filter."""

    maddpg = "maddpg"
    maddpg_bare = "maddpg_bare"
    orca = "orca"
    orca_filtered = "orca_filtered"
    none = "none"
    none_filtered = "none_filtered"


FILTERED = {PolicyChoice.maddpg, PolicyChoice.orca_filtered, PolicyChoice.none_filtered}


@app.command()
def avoid(
    policy: Annotated[PolicyChoice, typer.Option(help="who decides")],
    agents: Annotated[int, typer.Option(min=1, max=64, help="drones in each episode")] = 8,
    episodes: Annotated[int, typer.Option(min=1, help="episodes")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="of starts, goals, towns, wind, errors")] = 1,
    wind: Annotated[bool, typer.Option("--wind", help="up to 8 m/s, another each episode")] = False,
    card: Annotated[
        str, typer.Option(help="of maddpg: a name in params/policies, or a card's path")
    ] = FLOWN_POLICY,
    json_out: Annotated[Path | None, typer.Option("--json", help="write the figures here")] = None,
    keep: Annotated[
        Path | None,
        typer.Option(help="keep every 25 episodes in this folder; the same command goes on there"),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="draw the first episode's tracks here (PNG)")
    ] = None,
) -> None:
    """Fly episodes among buildings and other drones, and count collisions by truth.

    Each policy meets the same seeds, starts, goals, towns and wind; neighbours' positions are
    200 ms late and 2 m off. Ctrl-C shows what has been flown. A folder of --keep belongs to one
    state of the code: what it holds is not flown again.

    Example: sim-bridge avoid --policy orca_filtered --agents 8 --episodes 100 --wind
    """
    from companion.core.separation.separation_filter import SeparationFilter
    from sim_bridge.research.avoidance import evaluation
    from sim_bridge.research.avoidance.kept_flights import Evaluation, flights_of

    pilot, weights = _pilot(policy, card)
    separation = SeparationFilter() if policy in FILTERED else None
    world = evaluation.evaluation_world(agents, wind)
    asked = Evaluation(policy.value, agents, seed, wind, weights)
    seeds = asked.seeds(0, min(episodes, TIMED_EPISODES))
    found, timed, stopped = None, None, False
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        shown = bar.add_task(f"{policy}, {agents} drones", total=episodes)
        try:
            timed = evaluation.decision_us(world, pilot, separation, seeds, cpu_s)
            for part in flights_of(asked, episodes, world, pilot, separation, keep):
                found = part if found is None else found.joined(part)
                bar.update(shown, completed=len(found.arrived) // agents)
            if picture is not None:
                _draw(policy, agents, wind, seeds[0], card, picture)
        except KeyboardInterrupt:
            stopped = True
    if found is None or timed is None:
        console.print("stopped before the first episodes were down: nothing to show")
        raise typer.Exit(INTERRUPTED)
    flown = len(found.arrived) // agents
    figures = evaluation.summary(policy.value, agents, flown, found, timed)
    Console().print(_table(figures, wind))
    if json_out is not None:
        json_out.parent.mkdir(parents=True, exist_ok=True)
        json_out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    if stopped:
        console.print(f"stopped after {flown} of {episodes} episodes")
        raise typer.Exit(INTERRUPTED)


def _pilot(policy: PolicyChoice, card: str) -> tuple["Pilot", str]:
    """Who flies, and the hash of its weights."""
    from sim_bridge.research.avoidance import yardsticks

    if policy in (PolicyChoice.none, PolicyChoice.none_filtered):
        return yardsticks.StraightOn(), ""
    if policy in (PolicyChoice.orca, PolicyChoice.orca_filtered):
        try:
            import pyrvo  # noqa: F401 # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise LeewayError(
                f"--policy {policy} needs leeway-uas[train] (pyrvo): {error}"
            ) from error
        return yardsticks.Orca(), ""
    from companion.adapters.files.policy_file import read_policy
    from sim_bridge.research.avoidance.environment import Frame

    actor, said = read_policy(card)
    return yardsticks.Learned(actor, Frame(said.frame)), said.sha256


def _table(figures: dict[str, Any], wind: bool) -> Table:
    title = f"{figures['policy']}, {figures['agents']} drones, {figures['episodes']} episodes"
    table = Table("", "", title=title + (", wind" if wind else ", no wind"), show_header=False)
    flights = figures["flights"]

    def share(count: int) -> str:
        return f"{count} of {flights} ({count / flights:.2%})"

    bound = figures["drone_collision_rate_upper95"]
    table.add_row("goals reached", share(figures["goals"]))
    table.add_row(
        "flights that met a drone", f"{share(figures['drone_collisions'])}, < {bound:.2%} at 95 %"
    )
    table.add_row("flights that met a building", share(figures["building_collisions"]))
    for name, words in (("time", "time over the straight line's"), ("energy", "energy")):
        mean, half = figures[f"{name}_ratio_mean"], figures[f"{name}_ratio_ci95"]
        table.add_row(words, "-" if mean is None else f"{mean:.3f} +- {half or 0.0:.3f}")
    least = figures["separation_min_m"]
    table.add_row(
        "least separation (of 5 m, or as much of 4 m high)",
        "-" if least is None else f"{least:.1f} m",
    )
    cost = f"{figures['decision_us_median']:.0f} us, p99 {figures['decision_us_p99']:.0f}"
    table.add_row("a decision, CPU", cost)
    return table


def _draw(
    policy: PolicyChoice, agents: int, wind: bool, seed: int, card: str, picture: Path
) -> None:
    from companion.core.separation.separation_filter import SeparationFilter
    from sim_bridge.research.avoidance.avoid_picture import draw_episode
    from sim_bridge.research.avoidance.evaluation import evaluation_world

    separation = SeparationFilter() if policy in FILTERED else None
    pilot, _ = _pilot(policy, card)
    draw_episode(evaluation_world(agents, wind), pilot, separation, seed, policy.value, picture)


@app.command("avoid-table")
def avoid_table(
    folder: Annotated[Path, typer.Argument(help="of `sim-bridge avoid --keep`")],
    out: Annotated[Path, typer.Option(help="folder for the tables")] = OUT,
) -> None:
    """Tables of all flights kept in a folder: each policy, and the learned one against the others.

    Example: sim-bridge avoid-table logs/avoid/kept
    """
    from sim_bridge.research.avoidance import avoid_table as experiment

    rows = experiment.rows_of(folder)
    finish(experiment.results(rows), out, "avoid")
    finish(experiment.compared(rows), out, "avoid_against")


@app.command("avoid-bench")
def avoid_bench(
    scenes: Annotated[int, typer.Option(min=1, help="decisions of each kind")] = 400,
    neighbours: Annotated[int, typer.Option(min=0, max=200, help="about the drone")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="of the scenes")] = 1,
    card: Annotated[
        str, typer.Option(help="the actor: a name in params/policies, or a card's path")
    ] = FLOWN_POLICY,
    out: Annotated[Path, typer.Option(help="folder for the table")] = OUT,
) -> None:
    """Time one decision on board: the safety filter among neighbours, and the actor with its view.

    CPU time, so that other work on the machine matters less; the least is what a quiet one takes.

    Example: OMP_NUM_THREADS=1 sim-bridge avoid-bench --neighbours 20
    """
    from companion.adapters.files.policy_file import read_policy
    from sim_bridge.research.benchmarks import avoid_bench as experiment

    policy, _ = read_policy(card)
    with progress_bar() as bar:
        shown = bar.add_task("decisions", total=2 * scenes)
        costs = experiment.measured(policy, scenes, neighbours, seed, lambda: bar.advance(shown))
    finish(experiment.sheet(costs, neighbours), out, "avoid_bench")


@app.command("avoid-curve")
def avoid_curve(
    curves: Annotated[list[Path], typer.Argument(help="curve.csv of one or more trainings")],
    out: Annotated[Path, typer.Option(help="PNG")] = Path("logs/avoid/curve.png"),
) -> None:
    """Draw learning curves: reward, goals and collisions over the steps that agents flew.

    Example: sim-bridge avoid-curve logs/avoid/swift-1/curve.csv logs/avoid/paper-1/curve.csv
    """
    from sim_bridge.research.avoidance.avoid_picture import draw_curves

    for path in curves:
        if not path.exists():
            raise LeewayError(f"{path}: no such curve; sim-bridge train-avoid writes it")
    draw_curves(curves, out)
    typer.echo(f"wrote {out}", err=True)


@app.command("export-avoid")
def export_avoid(
    checkpoint: Annotated[Path, typer.Argument(help="checkpoint.pt of train-avoid")],
    out: Annotated[Path, typer.Option(help="folder of the policy and its card")],
    name: Annotated[str, typer.Option(help="of the policy")] = FLOWN_POLICY,
    commit: Annotated[str, typer.Option(help="of the code that trained it")] = "unknown",
) -> None:
    """Write a trained actor as plain weights with its card and curve; needs leeway-uas[train].

    Example: sim-bridge export-avoid logs/avoid/swift-1/checkpoint.pt --out params/policies
    """
    try:
        from sim_bridge.research.avoidance.train_avoid import export
    except ImportError as error:
        raise LeewayError(f"export-avoid needs leeway-uas[train]: {error}") from error
    if not checkpoint.exists():
        raise LeewayError(f"{checkpoint}: no such checkpoint; sim-bridge train-avoid writes it")
    for path in export(checkpoint, out, name, commit):
        typer.echo(f"wrote {path}", err=True)
