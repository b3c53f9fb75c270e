"""Picture of a simulated day: a map of drives and flights, and a timeline."""

from pathlib import Path
from typing import Any

import numpy as np

from sim_bridge.app.day.judge import DayTruth, DayVerdict
from sim_bridge.app.day.world import DayWorld

INK, WARN, ROAD, STATIONARY = "#22313f", "#d62728", "#555555", "#c9ced3"
TO_TRUCK = "#8c6d31"


def write_day_picture(
    png_path: Path, title: str, world: DayWorld, truth: DayTruth, verdict: DayVerdict
) -> None:
    """Write the PNG of a day; positions NED metres about the depot, times of the day."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    vehicles = sorted({track.vehicle for track in truth.tracks}, key=_natural_sort_key)
    shades = matplotlib.colormaps["tab10"]
    colour = {name: shades(k % 10) for k, name in enumerate(vehicles)}
    rows = len(vehicles) + 1
    figure = Figure(figsize=(12.5, 9.0 + 0.32 * rows), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(9.0, 1.2 + 0.42 * rows))
    _draw_map(figure.add_subplot(grid[0]), world, truth, verdict, colour)
    _draw_timeline(figure.add_subplot(grid[1]), world, truth, verdict, vehicles, colour)
    figure.suptitle(title, color=INK, fontsize=13)
    figure.savefig(png_path, dpi=110)


def _natural_sort_key(name: str) -> tuple[int, str]:
    digits = "".join(c for c in name if c.isdigit())
    return (int(digits) if digits else 0, name)


def _draw_map(
    axis: Any,
    world: DayWorld,
    truth: DayTruth,
    verdict: DayVerdict,
    colour_by_vehicle: dict[str, Any],
) -> None:
    for obstacle in world.data.obstacles_to_avoid(world.frame):
        ring = np.array(obstacle.ring_ne_m)
        axis.fill(ring[:, 1], ring[:, 0], color="#999999", alpha=0.4, lw=0)
    for track in truth.tracks:
        airborne_ned_m = np.where(track.airborne[:, None] > 0.0, track.ned_m, np.nan)
        axis.plot(
            airborne_ned_m[:, 1],
            airborne_ned_m[:, 0],
            color=colour_by_vehicle[track.vehicle],
            lw=1.1,
            alpha=0.85,
        )
    for drive in world.ground_handling.drives:
        (n0, e0), (n1, e1) = drive.from_ne_m, drive.to_ne_m
        axis.annotate(
            "",
            (e1, n1),
            (e0, n0),
            arrowprops={"arrowstyle": "-|>", "color": ROAD, "lw": 2.2, "shrinkA": 4, "shrinkB": 4},
        )
    for stop, ne_m in {one.stop: one.ne_m for one in truth.parked_intervals}.items():
        axis.plot(ne_m[1], ne_m[0], "s", color=INK, ms=9)
        if not stop.endswith("depot-end"):
            axis.annotate(
                stop, (ne_m[1], ne_m[0]), textcoords="offset points", xytext=(9, 7), color=INK
            )
    for order, (north, east, _) in truth.customers.items():
        carrier = verdict.delivered.get(order)
        shown = (
            WARN
            if carrier is None
            else TO_TRUCK
            if carrier == "truck"
            else colour_by_vehicle.get(carrier, INK)
        )
        axis.plot(
            east, north, "X" if carrier is None else "o", color=shown, ms=7, mec="white", mew=0.7
        )
        axis.annotate(
            order, (east, north), textcoords="offset points", xytext=(4, -9), fontsize=6.5
        )
    axis.plot([], [], color=ROAD, lw=2.2, label="truck")
    axis.plot([], [], "o", color=TO_TRUCK, label="delivered by truck")
    for name, shade in colour_by_vehicle.items():
        axis.plot([], [], color=shade, label=name)
    axis.plot([], [], "X", color=WARN, label="not delivered")
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("east of the depot, m")
    axis.set_ylabel("north, m")
    axis.grid(alpha=0.25)
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)


def _draw_timeline(
    axis: Any,
    world: DayWorld,
    truth: DayTruth,
    verdict: DayVerdict,
    vehicles: list[str],
    colour_by_vehicle: dict[str, Any],
) -> None:
    ended_s, faults = world.clock.t_s, world.faults.log
    names = ["truck", *vehicles]
    row = {name: len(names) - 1 - k for k, name in enumerate(names)}
    for drive in world.ground_handling.drives:
        _draw_timeline_bar(axis, row["truck"], drive.left_s, drive.arrive_s, ROAD)
    for interval in truth.parked_intervals:
        _draw_timeline_bar(
            axis, row["truck"], interval.arrived_s, min(interval.left_s, ended_s), STATIONARY
        )
    for task in world.ground_handling.finished_tasks:
        if task.kind == "serve":
            _draw_timeline_bar(axis, row["truck"], task.begun_s, task.ended_s, TO_TRUCK)
        elif task.vehicle in row and task.kind in ("put out", "recover"):
            _draw_timeline_bar(
                axis, row[task.vehicle], task.begun_s, task.ended_s, STATIONARY, height=0.35
            )
    for flight in verdict.flights:
        if flight.vehicle not in row:
            continue
        end_s = flight.land_s if flight.land_s is not None else ended_s
        shade = colour_by_vehicle[flight.vehicle] if flight.home else WARN
        _draw_timeline_bar(axis, row[flight.vehicle], flight.launch_s, end_s, shade)
        middle_s = (flight.launch_s + end_s) / 2.0 / 60.0
        axis.text(
            middle_s,
            row[flight.vehicle],
            flight.order or "",
            ha="center",
            va="center",
            fontsize=6,
            color="white" if flight.delivered else "black",
        )
    for t_s, words in faults:
        axis.axvline(t_s / 60.0, color=WARN, lw=0.9, ls=":")
        axis.text(t_s / 60.0, len(names) - 0.4, words, fontsize=6, color=WARN, rotation=20)
    axis.set_yticks([row[name] for name in names], names)
    axis.set_ylim(-0.6, len(names) + (0.4 if faults else -0.3))
    axis.set_xlim(0.0, ended_s / 60.0)
    axis.set_xlabel(
        "minutes of the day (truck: dark on the road, light at a stop, brown at a door;"
        " drones: grey while handled by the driver)"
    )
    axis.grid(axis="x", alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)


def _draw_timeline_bar(
    axis: Any, row_index: int, begin_s: float, end_s: float, colour: Any, *, height: float = 0.7
) -> None:
    axis.barh(
        row_index, (end_s - begin_s) / 60.0, left=begin_s / 60.0, height=height, color=colour, lw=0
    )
