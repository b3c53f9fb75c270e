"""`sim-bridge research avoid`, `train-avoid` and what goes with them: drones among drones."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import command_class_with_options
from sim_bridge.app.cli.options import run_options
from sim_bridge.research.cli.options import (
    EXPERIMENT_OPTIONS,
    create_experiment_run,
    seed_option_or,
)

if TYPE_CHECKING:
    from sim_bridge.research.avoidance.train_avoid import CurvePoint

app = typer.Typer()

DEFAULT_POLICY = "avoid"


class PolicyChoice(StrEnum):
    """`maddpg` and `_filtered` are behind the safety filter."""

    maddpg = "maddpg"
    maddpg_bare = "maddpg_bare"
    orca = "orca"
    orca_filtered = "orca_filtered"
    none = "none"
    none_filtered = "none_filtered"


@app.command(cls=command_class_with_options(*EXPERIMENT_OPTIONS, "seed"))
def avoid(
    policy: Annotated[list[PolicyChoice], typer.Option(help="Policy; repeatable.")],
    agents: Annotated[int, typer.Option(min=1, max=64, help="Drones per episode.")] = 8,
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 100,
    wind: Annotated[
        bool, typer.Option("--wind", help="Add a wind of up to 8 m/s, drawn per episode.")
    ] = False,
    card: Annotated[
        str, typer.Option(help="Card of maddpg: a name in params/policies, or a path.")
    ] = DEFAULT_POLICY,
) -> None:
    """Fly episodes among buildings and other drones, and count collisions by true state.

    Each policy meets the same seeds, starts, goals, towns and wind; neighbours' positions are
    200 ms late and 2 m off. Ctrl-C keeps what is done. The default --jobs 1 leaves decision times
    undisturbed.

    Example: sim-bridge research avoid --policy orca_filtered --agents 8 --episodes 100 --wind
    """
    from sim_bridge.research.avoidance import policies
    from sim_bridge.research.study.run import Experiment

    run = create_experiment_run(processes=1)
    cases = policies.build_episode_cases(policy, agents, episodes, seed_option_or(1), wind, card)
    experiment = Experiment("episodes", cases, policies.fly_episodes, policies.EpisodesFlown)
    run.print_and_write_report(
        policies.make_report(cases, run.run_cases_and_return_results(experiment))
    )


@app.command("train-avoid", cls=command_class_with_options("out", "seed"))
def fit_avoidance_policy(
    reward: Annotated[
        str, typer.Option(help="Reward: paper (arXiv 2604.13441) or swift.")
    ] = "swift",
    steps: Annotated[
        int, typer.Option(min=1, help="Decisions per episode, 8 episodes in parallel.")
    ] = 2500,
    filtered: Annotated[
        bool, typer.Option("--filtered", help="Train with the safety filter.")
    ] = False,
    taught: Annotated[
        int,
        typer.Option(min=0, help="Initial updates (2 per step) that imitate the shortest path."),
    ] = 0,
    export: Annotated[
        Path | None,
        typer.Option(
            metavar="CHECKPOINT",
            help="Train nothing: write the actor of this checkpoint.pt with its card into --out.",
        ),
    ] = None,
    name: Annotated[str, typer.Option(help="With --export: name of the policy.")] = DEFAULT_POLICY,
    commit: Annotated[
        str, typer.Option(help="With --export: commit of the code that trained it.")
    ] = "unknown",
) -> None:
    """Train the avoidance policy (MADDPG). Ctrl-C keeps the checkpoint; run again to continue.

    OMP_NUM_THREADS=1 sim-bridge research train-avoid --reward swift --filtered --seed 1

    sim-bridge research train-avoid --export logs/avoid/swift-1/checkpoint.pt --out params/policies
    """
    if export is not None:
        _export_policy(export, name, commit)
        return
    try:
        from sim_bridge.research.avoidance.maddpg import TrainingParams
        from sim_bridge.research.avoidance.train_avoid import train_or_resume_policy
    except ImportError as error:
        raise LeewayError(f"train-avoid needs leeway-uas[train]: {error}") from error
    from sim_bridge.research.avoidance.environment import REWARDS
    from sim_bridge.research.study.run import INTERRUPTED_EXIT_CODE, create_progress_bar

    if reward not in REWARDS:
        raise LeewayError(f"--reward {reward}: expected one of {', '.join(REWARDS)}")
    seed = seed_option_or(1)
    folder = (
        run_options().out
        or Path("logs")
        / "avoid"
        / f"{reward}-{seed}{'-filtered' * filtered}{'-taught' * (taught > 0)}"
    )
    params = TrainingParams(reward, seed, filtered, taught, steps=steps)
    with create_progress_bar(transient=False) as bar:
        progress_task = bar.add_task(f"{reward} reward", total=steps)

        def progress(step: int, point: "CurvePoint | None") -> None:
            bar.update(progress_task, completed=step)
            if point is not None:
                bar.console.print(
                    f"step {point.step}: reward {point.reward_mean:.2f}, goals"
                    f" {point.goals_frac:.1%}, flights that met a drone"
                    f" {point.drone_collision_frac:.1%}, a building"
                    f" {point.building_collision_frac:.1%}",
                    highlight=False,
                )

        try:
            train_or_resume_policy(params, folder, progress)
        except KeyboardInterrupt:
            bar.console.print(f"stopped; {folder}/checkpoint.pt keeps the last check, run it again")
            raise typer.Exit(INTERRUPTED_EXIT_CODE) from None
        except ValueError as error:
            raise LeewayError(str(error)) from error
    typer.echo(f"wrote {folder}/checkpoint.pt and curve.csv", err=True)


def _export_policy(checkpoint: Path, name: str, commit: str) -> None:
    try:
        from sim_bridge.research.avoidance.train_avoid import export_policy
    except ImportError as error:
        raise LeewayError(f"train-avoid needs leeway-uas[train]: {error}") from error
    if not checkpoint.exists():
        raise LeewayError(f"{checkpoint}: no such checkpoint; train-avoid writes it")
    out = run_options().out
    if out is None:
        raise LeewayError("--export: expected --out, the folder of the policy and its card")
    for path in export_policy(checkpoint, out, name, commit):
        typer.echo(f"wrote {path}", err=True)
