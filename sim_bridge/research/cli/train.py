"""`sim-bridge train-avoid`: MADDPG from scratch, resumable; needs leeway[train]."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.campaign import INTERRUPTED
from sim_bridge.research.cli.experiments import finish

if TYPE_CHECKING:
    from sim_bridge.research.avoidance.train_avoid import CurvePoint

app = typer.Typer(add_completion=False)


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

    Example: OMP_NUM_THREADS=1 sim-bridge train-avoid --reward swift --filtered --seed 1
    """
    try:
        from sim_bridge.research.avoidance.maddpg import TrainParams
        from sim_bridge.research.avoidance.train_avoid import train
    except ImportError as error:
        raise LeewayError(f"train-avoid needs leeway[train]: {error}") from error
    from sim_bridge.research.avoidance.environment import REWARDS
    from sim_bridge.research.avoidance.flight_power import power_of

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
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    with Progress(*columns, TimeRemainingColumn(), console=console) as bar:
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
            console.print(f"stopped; {folder}/checkpoint.pt keeps the last check, run it again")
            raise typer.Exit(INTERRUPTED) from None
        except ValueError as error:
            raise LeewayError(str(error)) from error
    console.print(f"wrote {folder}/checkpoint.pt and curve.csv")


@app.command("train-compare")
def train_compare(
    steps: Annotated[int, typer.Option(min=100, help="of 32 worlds; one update each")] = 6000,
    seeds: Annotated[int, typer.Option(min=1, help="runs of each, seeds 1, 2, ...")] = 2,
    out: Annotated[
        Path, typer.Option(help="curves, table and picture; finished runs there are not repeated")
    ] = Path("logs/avoid/peer"),
) -> None:
    """Our MADDPG beside TorchRL's on a standard task, VMAS navigation: the same steps and updates.

    Example: OMP_NUM_THREADS=1 sim-bridge train-compare --steps 6000 --seeds 2
    """
    try:
        from sim_bridge.research.avoidance import maddpg_peer as experiment
    except ImportError as error:
        raise LeewayError(f"train-compare needs leeway[compare]: {error}") from error
    runs = [(who, seed) for seed in range(1, seeds + 1) for who in experiment.STUDENTS]
    points: list[experiment.Point] = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        shown = bar.add_task("learning", total=steps * len(runs))
        for number, (who, seed) in enumerate(runs):

            def progress(step: int, point: "experiment.Point | None", before: int = number) -> None:
                bar.update(shown, completed=before * steps + step)
                if point is not None:
                    bar.console.print(
                        f"{point.who}, seed {point.seed}, step {point.step}: reward"
                        f" {point.reward:.2f}, at the goal {point.at_goal_frac:.1%}",
                        highlight=False,
                    )

            try:
                points += experiment.kept_or_learned(out, who, seed, steps, progress)
            except KeyboardInterrupt:
                bar.console.print("stopped; the same command goes on with the run that was cut off")
                raise typer.Exit(INTERRUPTED) from None
    experiment.draw(points, out / "maddpg_peer.png")
    finish(experiment.sheet(points, steps), out, "maddpg_peer")
