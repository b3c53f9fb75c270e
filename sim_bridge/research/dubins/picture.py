"""The picture of `sim-bridge research paths`: the same two poses in calm, in wind, in a town."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Obstacle, ObstacleMap
from sim_bridge.research.dubins.clear import ClearPath, clear_path
from sim_bridge.research.dubins.limits import FlightLimits
from sim_bridge.research.dubins.sampling import mission_points

START = np.array([0.0, 0.0, -40.0, math.radians(40.0)])
GOAL = np.array([60.0, 420.0, -40.0, math.radians(200.0)])
CLEARANCE_M, CLEARANCE_UP_M = 15.0, 8.0
PX4_ACCEPT_M = 10.0


def _box(name: str, north: float, east: float, size: tuple[float, float], height_m: float):
    corners = [(0.0, 0.0), (size[0], 0.0), size, (0.0, size[1])]
    ring = tuple((north + n, east + e) for n, e in corners)
    return Obstacle(name, ring, height_m)


TOWN = (
    _box("hall 25 m", 10.0, 95.0, (50.0, 50.0), 25.0),
    _box("tower 90 m", 60.0, 200.0, (70.0, 60.0), 90.0),
    _box("no-fly", -90.0, 300.0, (80.0, 90.0), math.inf),
)


def draw(
    path: Path, airspeed_mps: float, bank_deg: float, wind_mps: float, wind_from_deg: float
) -> Path:
    """Write the picture; raises LeewayError for limits and winds that cannot be flown."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    limits = FlightLimits.from_bank(airspeed_mps, math.radians(bank_deg))
    to_rad = math.radians(wind_from_deg + 180.0)
    wind = wind_mps * np.array([math.cos(to_rad), math.sin(to_rad)])
    worlds = [
        ("calm", np.zeros(2), ()),
        (f"{wind_mps:g} m/s from {wind_from_deg:g}°", wind, ()),
        ("the same wind, a town", wind, TOWN),
    ]
    figure, axes = plt.subplots(1, 3, figsize=(13.5, 4.6), sharex=True, sharey=True)
    for axis, (title, blows, town) in zip(axes, worlds, strict=True):
        obstacles = ObstacleMap(town, CLEARANCE_M, CLEARANCE_UP_M)
        found = clear_path(START, GOAL, limits, blows, obstacles, ceiling_m=120.0)
        _draw_world(axis, title, blows, town, found)
    axes[0].set_ylabel("north, m")
    axes[0].legend(fontsize=7, loc="upper left")
    figure.suptitle(
        f"{airspeed_mps:g} m/s, bank limit {bank_deg:g}°: turns of {limits.turn_radius_m:.0f} m"
        " in the air; arrows: air headings"
    )
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)
    return path


def _draw_world(
    axis: Any, title: str, wind: Floats, town: tuple[Obstacle, ...], found: object
) -> None:
    for building in town:
        ring = np.array([*building.ring_ne_m, building.ring_ne_m[0]])
        colour = "tab:red" if math.isinf(building.height_m) else "grey"
        axis.fill(ring[:, 1], ring[:, 0], color=colour, alpha=0.5)
        middle = ring[:-1].mean(axis=0)
        axis.text(middle[1], middle[0], building.name, ha="center", va="center", fontsize=7)
    if isinstance(found, ClearPath):
        track = found.points(2.0)
        axis.plot(track[:, 1], track[:, 0], color="tab:blue", label="path over the ground")
        items = np.array(mission_points(found.legs, PX4_ACCEPT_M))
        axis.plot(items[:, 1], items[:, 0], "k.", ms=5, label="mission items (PX4)")
        remedy = f"\n{found.remedy}" if found.remedy else ""
        axis.set_title(f"{title}: {'+'.join(found.legs.word)}, {found.time_s:.0f} s{remedy}")
    else:
        axis.set_title(f"{title}: {found}", wrap=True, fontsize=8)
    for pose, colour in ((START, "tab:green"), (GOAL, "tab:orange")):
        axis.annotate(
            "",
            (pose[1] + 45.0 * math.sin(pose[3]), pose[0] + 45.0 * math.cos(pose[3])),
            (pose[1], pose[0]),
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2},
        )
    if wind.any():
        tip = (150.0 + 8.0 * wind[1], -60.0 + 8.0 * wind[0])
        axis.annotate(
            "", tip, (150.0, -60.0), arrowprops={"arrowstyle": "-|>", "color": "tab:cyan", "lw": 3}
        )
        axis.text(150.0, -85.0, "wind", fontsize=8, color="tab:cyan")
    axis.set_aspect("equal")
    axis.set_xlabel("east, m")
    axis.grid(alpha=0.3)
