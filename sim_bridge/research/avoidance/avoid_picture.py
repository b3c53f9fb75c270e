"""Pictures of avoidance: the tracks of an episode, and how a policy learned."""

import csv
from pathlib import Path

import matplotlib as mpl
import numpy as np

from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance.evaluation import fly
from sim_bridge.research.avoidance.scenes import HALF_SIDE_M
from sim_bridge.research.avoidance.world import GOAL_M, AvoidanceWorld
from sim_bridge.research.avoidance.yardsticks import Pilot

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

DOTS_S = 5.0


def draw_episode(
    world: AvoidanceWorld,
    pilot: Pilot,
    separation: SeparationFilter | None,
    seed: int,
    title: str,
    out: Path,
) -> None:
    """Tracks from above, a dot every 5 s; below them each drone's height."""
    track = []

    def watch(now: AvoidanceWorld) -> None:
        track.append(np.where(now.active[0][:, None], now.true_pos_m[0], np.nan))

    found = fly(world, pilot, separation, [seed], watch)
    path = np.stack(track)
    figure, (above, side) = plt.subplots(
        2, 1, figsize=(8, 10), height_ratios=[4, 1], layout="constrained"
    )
    _ground(above, world)
    time_s = 0.2 * (1 + np.arange(len(path)))
    step = round(DOTS_S / 0.2)
    for i in range(world.agents):
        colour = plt.cm.tab20(i % 20)  # pyright: ignore[reportAttributeAccessIssue]
        above.plot(path[:, i, 1], path[:, i, 0], color=colour, lw=1.5)
        above.plot(path[::step, i, 1], path[::step, i, 0], ".", color=colour, ms=5)
        above.plot(world.start_m[0, i, 1], world.start_m[0, i, 0], "s", color=colour, ms=6)
        goal = world.goal_ne_m[0, i]
        above.add_patch(Circle((goal[1], goal[0]), GOAL_M, fill=False, ec=colour, lw=1.0))
        side.plot(time_s, -path[:, i, 2], color=colour, lw=1.2)
    least = found.apart.min() * world.params.horizontal_m
    above.set_title(
        f"{title}: {found.arrived.sum()} of {world.agents} arrive, least separation {least:.1f} m"
    )
    side.set_xlabel("s")
    side.set_ylabel("m above flight height")
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=110)
    plt.close(figure)


def _ground(axes: Axes, world: AvoidanceWorld) -> None:
    scene = world.scenes[world.scene_of[0]]
    for south, west, north, east in scene.boxes_m:
        axes.add_patch(Rectangle((west, south), east - west, north - south, color="0.75"))
    truck = scene.truck_ne_m
    axes.plot(truck[1], truck[0], "k*", ms=14)
    north, east = world.wind_ne_mps[0]
    corner = -0.9 * HALF_SIDE_M
    axes.annotate(
        "",
        (corner + 8.0 * east, corner + 8.0 * north),
        (corner, corner),
        arrowprops={"arrowstyle": "->", "color": "tab:blue"},
    )
    axes.text(corner, corner - 22.0, f"wind {np.hypot(north, east):.1f} m/s", color="tab:blue")
    axes.set_xlim(-HALF_SIDE_M, HALF_SIDE_M)
    axes.set_ylim(-HALF_SIDE_M, HALF_SIDE_M)
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")


def draw_curves(paths: list[Path], out: Path) -> None:
    """Reward (each its own), goals and collisions of the checks, over agent steps."""
    columns = (
        ("reward_mean", "reward of a flight"),
        ("goals_frac", "goals reached"),
        ("drone_collision_frac", "met a drone"),
        ("building_collision_frac", "met a building"),
    )
    figure, axes = plt.subplots(2, 2, figsize=(10, 6), layout="constrained")
    for path in paths:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        flown = [float(row["agent_steps"]) for row in rows]
        for (name, words), ax in zip(columns, axes.flat, strict=True):
            ax.plot(flown, [float(row[name]) for row in rows], label=_label(path))
            ax.set_title(words)
            ax.set_xlabel("agent steps of 2 s")
    axes.flat[0].legend()
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=110)
    plt.close(figure)


def _label(path: Path) -> str:
    return path.parent.name if path.name == "curve.csv" else path.stem.removesuffix("_curve")
