"""A day plan on a map: the truck's route, the drones' sorties, obstacles and no-fly areas; under
them the streets of the user's base map, where one is given.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from companion.core.base.errors import LeewayError
from companion.core.base.geo import (
    LocalFrame,
    moved_deg,
    offsets_m,
    place_ned,
)
from companion.core.mission.flight_plan import frame_at
from ground_station.adapters.files.basemap import Ground, read_ground
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.planning.day_problem import obstacle_map
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedStop, since_start
from ground_station.core.schema.orders import place_of

COLOURS = (
    "tab:blue",
    "tab:orange",
    "tab:green",
    "tab:red",
    "tab:purple",
    "tab:brown",
    "tab:pink",
    "tab:olive",
    "tab:cyan",
    "navy",
)
OBSTACLE, NO_FLY = "0.75", "#f4b6b6"
NO_FLY_FROM_M = 120.0
"""An obstacle as high as drones may fly is drawn as a no-fly area."""
GROUND = {"green": "#e4ecd9", "water": "#cfe1ee", "house": "#e7e1d8", "road": "#d8d2c7"}
"""Pale: what is drawn over it is what is read."""

ROAD_WIDTH_PT = 1.4
MARGIN_FRAC = 0.08
"""Room for the words beside the outermost places."""

LAUNCH_PT, HOME_PT = 4.0, 7.5
"""A pad that both use shows the dot in its ring."""


def draw_day_plan(data: DayData, plan: DayPlan, out: Path, basemap: Path | None = None) -> None:
    """Draw the plan into a PNG, metres east and north of the depot.

    `basemap`: a PMTiles extract whose streets are drawn beneath. Raises LeewayError where the
    picture cannot be written or the base map not be read.
    """
    figure = Figure(figsize=(9.5, 9.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    frame = frame_at(data.day.depot.place)
    _draw_obstacles(axes, frame, data)
    _draw_sorties(axes, frame, data, plan)
    _draw_truck(axes, frame, plan)
    _draw_unplanned(axes, frame, data, plan)
    by_truck = sum(len(stop.serves) for stop in plan.stops)
    axes.set_title(
        f"{plan.day}: {plan.makespan_s / 60.0:.1f} min, {len(plan.sorties)} orders by drone,"
        f" {by_truck} by truck, {len(plan.unplanned)} by nobody",
        fontsize=11,
    )
    axes.margins(MARGIN_FRAC)
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    if basemap is not None:
        _draw_ground(axes, data, basemap)
    _legend(axes)
    try:
        figure.savefig(out, bbox_inches="tight")
    except OSError as error:
        raise LeewayError(f"{out}: {error.strerror}") from error


def _draw_obstacles(axes: Axes, frame: LocalFrame, data: DayData) -> None:
    named: set[str] = set()
    for obstacle in data.obstacles(frame):
        never = obstacle.height_m >= NO_FLY_FROM_M
        label = "no-fly area" if never else "obstacle"
        ring = np.array(obstacle.ring_ne_m)[:, ::-1]
        colour = NO_FLY if never else OBSTACLE
        shown = None if label in named else label
        axes.add_patch(Polygon(ring, facecolor=colour, edgecolor="0.5", zorder=0, label=shown))
        words = f"{obstacle.name}" if never else f"{obstacle.name} {obstacle.height_m:.0f} m"
        axes.annotate(words, ring.mean(axis=0), fontsize=6, ha="center", va="center", color="0.35")
        named.add(label)


def _draw_ground(axes: Axes, data: DayData, basemap: Path) -> None:
    """Streets, houses, water and green of what the picture shows; its limits stay."""
    depot = data.day.depot
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    axes.autoscale(enable=False)
    here = (depot.lat_deg, depot.lon_deg)
    low, high = (moved_deg(*here, *to) for to in ((south, west), (north, east)))
    ground = read_ground(basemap, low, high)
    for kind, colour in GROUND.items():
        _draw_kind(axes, ground, kind, colour, here)
    words = ground.attribution or "base map without attribution"
    axes.text(1.0, 0.0, words, transform=axes.transAxes, ha="right", va="bottom", fontsize=6)


def _draw_kind(
    axes: Axes, ground: Ground, kind: str, colour: str, here: tuple[float, float]
) -> None:
    areas: list[np.ndarray] = []
    lines: list[np.ndarray] = []
    for shape in ground.shapes:
        if shape.kind == kind:
            north_m, east_m = offsets_m(*here, shape.lat_lon_deg[:, 0], shape.lat_lon_deg[:, 1])
            (areas if shape.is_area else lines).append(np.column_stack([east_m, north_m]))
    below = -1  # of all that is the plan's
    axes.add_collection(PolyCollection(areas, facecolors=colour, zorder=below))
    drawn = LineCollection(lines, colors=colour, linewidths=ROAD_WIDTH_PT, zorder=below)
    axes.add_collection(drawn)


def _draw_sorties(axes: Axes, frame: LocalFrame, data: DayData, plan: DayPlan) -> None:
    orders = {order.id: order for order in data.orders}
    drones = sorted({sortie.vehicle for sortie in plan.sorties})
    obstacles = obstacle_map(data)
    named: set[str] = set()
    for sortie in plan.sorties:
        drone = sortie.vehicle
        colour = COLOURS[drones.index(drone) % len(COLOURS)]
        launch, home = (
            place_ned(frame, plan.stop(id_).pads[drone]) for id_ in (sortie.launch, sortie.home)
        )
        customer = place_ned(frame, place_of(orders[sortie.order]))
        label = None if drone in named else drone
        named.add(drone)
        points = np.array([launch, customer, home])[:, :2]
        ways = ObstacleRoutes(obstacles, points, data.day.mission.cruise_height_m)
        for start, end, style in ((0, 1, "-"), (1, 2, "--")):
            way = np.array([points[start], *ways.via(start, end), points[end]])
            shown = label if style == "-" else None
            axes.plot(
                way[:, 1], way[:, 0], style, color=colour, linewidth=1.0, label=shown, zorder=2
            )
        axes.plot(launch[1], launch[0], "o", color=colour, markersize=LAUNCH_PT, zorder=6)
        axes.plot(
            home[1], home[0], "o", color=colour, markersize=HOME_PT, fillstyle="none", zorder=6
        )
        axes.plot(customer[1], customer[0], "^", color=colour, markersize=6, zorder=4)
        words, at = since_start(sortie.launch_s), (customer[1], customer[0])
        axes.annotate(
            words, at, xytext=(5, -3), textcoords="offset points", fontsize=6, color=colour
        )


def _draw_truck(axes: Axes, frame: LocalFrame, plan: DayPlan) -> None:
    stops = np.array([place_ned(frame, stop.place)[1::-1] for stop in plan.stops])
    axes.plot(*stops.T, "-", color="0.25", linewidth=2.2, label="truck", zorder=3)
    axes.plot(*stops[1:-1].T, "s", color="0.25", markersize=6, zorder=5)
    axes.plot(*stops[0], "D", color="black", markersize=9, label="depot", zorder=5)
    for stop, (x, y) in zip(plan.stops[:-1], stops[:-1], strict=True):
        words = _stop_words(plan, stop)
        drawn = axes.annotate(
            words, (x, y), xytext=(7, 7), textcoords="offset points", fontsize=8, zorder=7
        )
        drawn.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def _stop_words(plan: DayPlan, stop: PlannedStop) -> str:
    """Number, arrival, and how many drones launch and land there."""
    off = sum(sortie.launch == stop.id for sortie in plan.sorties)
    home = sum(sortie.home == stop.id for sortie in plan.sorties)
    drones = f" {off}\N{UPWARDS ARROW} {home}\N{DOWNWARDS ARROW}" if off or home else ""
    return f"{stop.id.removeprefix('stop-')}: {since_start(stop.arrive_s)}{drones}"


def _legend(axes: Axes) -> None:
    """Who is drawn in which colour, and what each sign is."""
    ink = {"color": "0.25", "linewidth": 1.0}
    signs = [
        Line2D([], [], marker="o", markersize=LAUNCH_PT, label="launch, way out", **ink),
        Line2D(
            [], [], marker="o", markersize=HOME_PT, linestyle="--", fillstyle="none",
            label="landing, way home", **ink
        ),
        Line2D([], [], marker="^", linestyle="", color="0.25", label="customer, start min:s"),
    ]  # fmt: skip
    known, names = axes.get_legend_handles_labels()
    axes.legend(
        [*known, *signs],
        [*names, *(str(sign.get_label()) for sign in signs)],
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        fontsize=8,
    )


def _draw_unplanned(axes: Axes, frame: LocalFrame, data: DayData, plan: DayPlan) -> None:
    lost = {line.order for line in plan.unplanned}
    at = [place_ned(frame, place_of(order)) for order in data.orders if order.id in lost]
    if at:
        ne_m = np.array(at)[:, :2]
        axes.plot(ne_m[:, 1], ne_m[:, 0], "x", color="red", markersize=10, label="by nobody")
