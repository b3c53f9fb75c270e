"""The picture of a simulated day: a map of what was driven and flown, and the day as a strip."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sim_bridge.app.day.judge import DayVerdict, Stand, VehicleTrack
from sim_bridge.app.day.truck import Drive, DriverTask

INK, WARN, ROAD, BUSY = "#22313f", "#d62728", "#555555", "#c9ced3"
TO_TRUCK = "#8c6d31"


@dataclass(frozen=True, slots=True)
class DayScene:
    """What a day's picture shows; positions NED metres about the depot, times of the day."""

    title: str
    customers: dict[str, tuple[float, float, float]]
    tracks: list[VehicleTrack]
    drives: list[Drive]
    stands: list[Stand]
    tasks: list[DriverTask]
    verdict: DayVerdict
    ended_s: float
    faults: list[tuple[float, str]] = field(default_factory=list)
    no_fly_ne_m: list[np.ndarray] = field(default_factory=list)


def draw_day(path: Path, day: DayScene) -> None:
    """Write the PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    vehicles = sorted({track.vehicle for track in day.tracks}, key=_natural)
    shades = matplotlib.colormaps["tab10"]
    colour = {name: shades(k % 10) for k, name in enumerate(vehicles)}
    rows = len(vehicles) + 1
    figure = Figure(figsize=(12.5, 9.0 + 0.32 * rows), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(9.0, 1.2 + 0.42 * rows))
    _draw_map(figure.add_subplot(grid[0]), day, colour)
    _draw_strip(figure.add_subplot(grid[1]), day, vehicles, colour)
    figure.suptitle(day.title, color=INK, fontsize=13)
    figure.savefig(path, dpi=110)


def _natural(name: str) -> tuple[int, str]:
    digits = "".join(c for c in name if c.isdigit())
    return (int(digits) if digits else 0, name)


def _draw_map(axis: Any, day: DayScene, colour: dict[str, Any]) -> None:
    for ring in day.no_fly_ne_m:
        axis.fill(ring[:, 1], ring[:, 0], color="#999999", alpha=0.4, lw=0)
    for track in day.tracks:
        flying = np.where(track.airborne[:, None] > 0.0, track.ned_m, np.nan)
        axis.plot(flying[:, 1], flying[:, 0], color=colour[track.vehicle], lw=1.1, alpha=0.85)
    for drive in day.drives:
        (n0, e0), (n1, e1) = drive.from_ne_m, drive.to_ne_m
        axis.annotate(
            "",
            (e1, n1),
            (e0, n0),
            arrowprops={"arrowstyle": "-|>", "color": ROAD, "lw": 2.2, "shrinkA": 4, "shrinkB": 4},
        )
    for stop, ne_m in {stand.stop: stand.ne_m for stand in day.stands}.items():
        axis.plot(ne_m[1], ne_m[0], "s", color=INK, ms=9)
        if not stop.endswith("depot-end"):
            axis.annotate(
                stop, (ne_m[1], ne_m[0]), textcoords="offset points", xytext=(9, 7), color=INK
            )
    by = day.verdict.delivered
    for order, (north, east, _) in day.customers.items():
        who = by.get(order)
        shown = WARN if who is None else TO_TRUCK if who == "truck" else colour.get(who, INK)
        axis.plot(east, north, "X" if who is None else "o", color=shown, ms=7, mec="white", mew=0.7)
        axis.annotate(
            order, (east, north), textcoords="offset points", xytext=(4, -9), fontsize=6.5
        )
    axis.plot([], [], color=ROAD, lw=2.2, label="truck")
    axis.plot([], [], "o", color=TO_TRUCK, label="brought by truck")
    for name, shade in colour.items():
        axis.plot([], [], color=shade, label=name)
    axis.plot([], [], "X", color=WARN, label="not delivered")
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("east of the depot, m")
    axis.set_ylabel("north, m")
    axis.grid(alpha=0.25)
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)


def _draw_strip(axis: Any, day: DayScene, vehicles: list[str], colour: dict[str, Any]) -> None:
    names = ["truck", *vehicles]
    row = {name: len(names) - 1 - k for k, name in enumerate(names)}
    for drive in day.drives:
        _bar(axis, row["truck"], drive.left_s, drive.arrive_s, ROAD)
    for stand in day.stands:
        _bar(axis, row["truck"], stand.arrived_s, min(stand.left_s, day.ended_s), BUSY)
    for task in day.tasks:
        if task.kind == "serve":
            _bar(axis, row["truck"], task.begun_s, task.ended_s, TO_TRUCK)
        elif task.vehicle in row and task.kind in ("put out", "recover"):
            _bar(axis, row[task.vehicle], task.begun_s, task.ended_s, BUSY, height=0.35)
    for flight in day.verdict.flights:
        if flight.vehicle not in row:
            continue
        end_s = flight.land_s if flight.land_s is not None else day.ended_s
        shade = colour[flight.vehicle] if flight.home else WARN
        _bar(axis, row[flight.vehicle], flight.launch_s, end_s, shade)
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
    for t_s, words in day.faults:
        axis.axvline(t_s / 60.0, color=WARN, lw=0.9, ls=":")
        axis.text(t_s / 60.0, len(names) - 0.4, words, fontsize=6, color=WARN, rotation=20)
    axis.set_yticks([row[name] for name in names], names)
    axis.set_ylim(-0.6, len(names) + (0.4 if day.faults else -0.3))
    axis.set_xlim(0.0, day.ended_s / 60.0)
    axis.set_xlabel(
        "minutes of the day (truck: dark on the road, light at a stop, brown at a door;"
        " drones: grey under the driver's hands)"
    )
    axis.grid(axis="x", alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)


def _bar(
    axis: Any, row: int, begin_s: float, end_s: float, colour: Any, *, height: float = 0.7
) -> None:
    axis.barh(row, (end_s - begin_s) / 60.0, left=begin_s / 60.0, height=height, color=colour, lw=0)
