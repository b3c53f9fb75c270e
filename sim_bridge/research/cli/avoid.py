"""`sim-bridge research avoid`, `train-avoid` and what goes with them: drones among drones."""

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.running import INTERRUPTED, OUT, finish, progress_bar

if TYPE_CHECKING:
    from rich.table import Table

    from sim_bridge.research.avoidance.train_avoid import CurvePoint
    from sim_bridge.research.avoidance.yardsticks import Pilot

app = typer.Typer()

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

    Example: sim-bridge research avoid --policy orca_filtered --agents 8 --episodes 100 --wind
    """
    from rich.console import Console

    from companion.core.separation.separation_filter import SeparationFilter
    from sim_bridge.adapters.wall_clock import cpu_s
    from sim_bridge.research.avoidance import evaluation
    from sim_bridge.research.avoidance.kept_flights import Evaluation, flights_of

    pilot, weights = _pilot(policy, card)
    separation = SeparationFilter() if policy in FILTERED else None
    world = evaluation.evaluation_world(agents, wind)
    asked = Evaluation(policy.value, agents, seed, wind, weights)
    seeds = asked.seeds(0, min(episodes, TIMED_EPISODES))
    found, timed, stopped = None, None, False
    console = Console(stderr=True)
    with progress_bar() as bar:
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
    from sim_bridge.research.avoidance.environment import ViewFrame

    actor, said = read_policy(card)
    return yardsticks.Learned(actor, ViewFrame(said.frame)), said.sha256


def _table(figures: dict[str, Any], wind: bool) -> "Table":
    from rich.table import Table

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
    folder: Annotated[Path, typer.Argument(help="of `sim-bridge research avoid --keep`")],
    out: Annotated[Path, typer.Option(help="folder for the tables")] = OUT,
) -> None:
    """Tables of all flights kept in a folder: each policy, and the learned one against the others.

    Example: sim-bridge research avoid-table logs/avoid/kept
    """
    from sim_bridge.research.avoidance import avoid_table as experiment

    rows = experiment.rows_of(folder)
    finish(experiment.results(rows), out, "avoid")
    finish(experiment.compared(rows), out, "avoid_against")


@app.command("avoid-curve")
def avoid_curve(
    curves: Annotated[list[Path], typer.Argument(help="curve.csv of one or more trainings")],
    out: Annotated[Path, typer.Option(help="PNG")] = Path("logs/avoid/curve.png"),
) -> None:
    """Draw learning curves: reward, goals and collisions over the steps that agents flew.

    Example: sim-bridge research avoid-curve logs/avoid/swift-1/curve.csv
    """
    from sim_bridge.research.avoidance.avoid_picture import draw_curves

    for path in curves:
        if not path.exists():
            raise LeewayError(f"{path}: no such curve; sim-bridge research train-avoid writes it")
    draw_curves(curves, out)
    typer.echo(f"wrote {out}", err=True)


@app.command("export-avoid")
def export_avoid(
    checkpoint: Annotated[Path, typer.Argument(help="checkpoint.pt of train-avoid")],
    out: Annotated[Path, typer.Option(help="folder of the policy and its card")],
    name: Annotated[str, typer.Option(help="of the policy")] = FLOWN_POLICY,
    commit: Annotated[str, typer.Option(help="of the code that trained it")] = "unknown",
) -> None:
    """Write a trained actor as plain weights with its card and curve; needs the extra `train`.

    Example: sim-bridge research export-avoid logs/avoid/swift-1/checkpoint.pt --out params/policies
    """
    try:
        from sim_bridge.research.avoidance.train_avoid import export
    except ImportError as error:
        raise LeewayError(f"export-avoid needs leeway-uas[train]: {error}") from error
    if not checkpoint.exists():
        raise LeewayError(
            f"{checkpoint}: no such checkpoint; sim-bridge research train-avoid writes it"
        )
    for path in export(checkpoint, out, name, commit):
        typer.echo(f"wrote {path}", err=True)


@app.command("train-avoid")
def train_avoid(
    reward: Annotated[str, typer.Option(help="paper, or ours: sharper, swift")] = "swift",
    seed: Annotated[int, typer.Option(min=0, help="of networks, noise and episodes")] = 1,
    steps: Annotated[int, typer.Option(min=1, help="decisions of each of 8 episodes")] = 2500,
    filtered: Annotated[
        bool, typer.Option("--filtered", help="learn behind the safety filter")
    ] = False,
    taught: Annotated[
        int, typer.Option(min=0, help="updates (2 a step) that imitate the shortest way first")
    ] = 0,
    begin_with: Annotated[
        Path | None, typer.Option(help="checkpoint.pt whose networks to start from")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="checkpoint.pt and curve.csv; default: by reward and seed")
    ] = None,
) -> None:
    """Learn to avoid (MADDPG); Ctrl-C keeps the checkpoint, the same command goes on from it.

    Example: OMP_NUM_THREADS=1 sim-bridge research train-avoid --reward swift --filtered --seed 1
    """
    try:
        from sim_bridge.research.avoidance.maddpg import TrainParams
        from sim_bridge.research.avoidance.train_avoid import train
    except ImportError as error:
        raise LeewayError(f"train-avoid needs leeway-uas[train]: {error}") from error
    from sim_bridge.research.avoidance.environment import REWARDS
    from sim_bridge.research.avoidance.evaluation import power_of

    if reward not in REWARDS:
        raise LeewayError(f"--reward {reward}: expected one of {', '.join(REWARDS)}")
    folder = (
        out
        or Path("logs")
        / "avoid"
        / f"{reward}-{seed}{'-filtered' * filtered}{'-taught' * (taught > 0)}"
    )
    if begin_with is not None and not begin_with.exists():
        raise LeewayError(f"--begin-with {begin_with}: no such checkpoint")
    params = TrainParams(
        reward=reward,
        seed=seed,
        filtered=filtered,
        taught=taught,
        begin_with=str(begin_with or ""),
        steps=steps,
    )
    with progress_bar(transient=False) as bar:
        shown = bar.add_task(f"{reward} reward", total=steps)

        def progress(step: int, point: "CurvePoint | None") -> None:
            bar.update(shown, completed=step)
            if point is not None:
                bar.console.print(
                    f"step {point.step}: reward {point.reward_mean:.2f}, goals"
                    f" {point.goals_frac:.1%}, flights that met a drone"
                    f" {point.drone_collision_frac:.1%}, a building"
                    f" {point.building_collision_frac:.1%}",
                    highlight=False,
                )

        try:
            train(params, folder, power_of("m100"), progress)
        except KeyboardInterrupt:
            bar.console.print(f"stopped; {folder}/checkpoint.pt keeps the last check, run it again")
            raise typer.Exit(INTERRUPTED) from None
        except ValueError as error:
            raise LeewayError(str(error)) from error
    typer.echo(f"wrote {folder}/checkpoint.pt and curve.csv", err=True)
