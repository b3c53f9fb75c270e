"""A benchmark plan on a map: the truck's route, its stops, and the drones' sorties."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ground_station.adapters.files.mfstsp_files import read_problem
from ground_station.core.benchmark.mfstsp import EARTH_RADIUS_M

DRONE_COLOURS = ("tab:orange", "tab:green", "tab:purple", "tab:red", "tab:brown", "tab:pink")


def draw_row(folder: Path, row: dict[str, Any], out: Path) -> None:
    """Draw a benchmark row, in kilometres from the depot."""
    data = read_problem(folder / row["problem"])
    km = (EARTH_RADIUS_M / 1000.0) * np.radians(
        np.column_stack(
            [
                (data.lon_deg - data.lon_deg[0]) * np.cos(np.radians(data.lat_deg[0])),
                data.lat_deg - data.lat_deg[0],
            ]
        )
    )
    km = np.vstack([km, km[:1]])
    title = (
        f"{row['problem']}, vehicles {row['vehicles']}, {row['drones']} drones: "
        f"{row['makespan_s']:.0f} s"
    )
    draw_plan(km, row["truck_route"], row["sorties"], title, out)


def draw_plan(
    east_north_km: np.ndarray,
    truck_route: list[int],
    sorties: list[dict[str, Any]],
    title: str,
    out: Path,
) -> None:
    """Draw nodes' places (n x 2), route and sorties into a PNG."""
    figure = Figure(figsize=(8.0, 8.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    road = east_north_km[truck_route]
    axes.plot(road[:, 0], road[:, 1], "-", color="0.35", linewidth=1.6, label="truck")
    axes.plot(road[:, 0], road[:, 1], "o", color="0.35", markersize=4)
    named: set[int] = set()
    for sortie in sorties:
        drone = sortie["drone"]
        flight = east_north_km[[sortie["launch"], sortie["customer"], sortie["rendezvous"]]]
        colour = DRONE_COLOURS[drone % len(DRONE_COLOURS)]
        label = None if drone in named else f"drone {drone}"
        named.add(drone)
        axes.plot(flight[:2, 0], flight[:2, 1], "-", color=colour, linewidth=1.0, label=label)
        axes.plot(flight[1:, 0], flight[1:, 1], "--", color=colour, linewidth=1.0)
        axes.plot(flight[1, 0], flight[1, 1], "^", color=colour, markersize=6)
    axes.plot(road[0, 0], road[0, 1], "s", color="black", markersize=9, label="depot")
    axes.set_aspect("equal")
    axes.set_xlabel("east, km")
    axes.set_ylabel("north, km")
    axes.set_title(title, fontsize=10)
    axes.legend(loc="best", fontsize=8)
    figure.savefig(out)
