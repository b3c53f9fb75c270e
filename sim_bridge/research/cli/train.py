"""`sim-bridge train-avoid`: MADDPG from scratch, resumable; needs leeway-uas[train]."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.campaign import INTERRUPTED

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
