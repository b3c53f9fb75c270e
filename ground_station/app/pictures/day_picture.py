"""A day plan on a map: the truck's route, the drones' sorties, obstacles and no-fly areas."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, location_to_ground_ned_m
from companion.core.mission.flight_plan import depot_frame
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.planning.day_problem import obstacle_map
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedStop, format_minutes_and_seconds
from ground_station.core.schema.orders import order_location

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
NO_FLY_MIN_HEIGHT_M = 120.0
"""An obstacle at least as high as the drones' ceiling is drawn as a no-fly area."""
LABEL_MARGIN_FRAC = 0.08
"""Margin for labels at the outermost positions."""

LAUNCH_PT, HOME_PT = 4.0, 7.5
"""Marker sizes: a pad used for both shows the launch dot inside the landing ring."""


def draw_day_plan(data: DayData, plan: DayPlan, png_file: Path) -> None:
    """Draw the plan into a PNG, metres east and north of the depot.

    Raises LeewayError if the picture cannot be written.
    """
    figure = Figure(figsize=(9.5, 9.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    frame = depot_frame(data.day.depot.location)
    _draw_obstacles(axes, frame, data)
    _draw_sorties(axes, frame, data, plan)
    _draw_truck(axes, frame, plan)
    _draw_unplanned(axes, frame, data, plan)
    by_truck = sum(len(stop.serves) for stop in plan.stops)
    axes.set_title(
        f"{plan.day}: {plan.makespan_s / 60.0:.1f} min, {len(plan.sorties)} orders by drone,"
        f" {by_truck} by truck, {len(plan.unplanned)} unplanned",
        fontsize=11,
    )
    axes.margins(LABEL_MARGIN_FRAC)
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    _draw_legend(axes)
    try:
        figure.savefig(png_file, bbox_inches="tight")
    except OSError as error:
        raise LeewayError(f"{png_file}: {error.strerror}") from error


def _draw_obstacles(axes: Axes, frame: LocalFrame, data: DayData) -> None:
    labelled: set[str] = set()
    for obstacle in data.obstacles_to_avoid(frame):
        is_no_fly = obstacle.height_m >= NO_FLY_MIN_HEIGHT_M
        label = "no-fly area" if is_no_fly else "obstacle"
        ring = np.array(obstacle.ring_ne_m)[:, ::-1]
        colour = NO_FLY if is_no_fly else OBSTACLE
        shown = None if label in labelled else label
        axes.add_patch(Polygon(ring, facecolor=colour, edgecolor="0.5", zorder=0, label=shown))
        label_text = (
            f"{obstacle.name}" if is_no_fly else f"{obstacle.name} {obstacle.height_m:.0f} m"
        )
        axes.annotate(
            label_text, ring.mean(axis=0), fontsize=6, ha="center", va="center", color="0.35"
        )
        labelled.add(label)


def _draw_sorties(axes: Axes, frame: LocalFrame, data: DayData, plan: DayPlan) -> None:
    orders = {order.id: order for order in data.orders}
    drones = sorted({sortie.vehicle for sortie in plan.sorties})
    obstacles = obstacle_map(data)
    labelled: set[str] = set()
    for sortie in plan.sorties:
        drone = sortie.vehicle
        colour = COLOURS[drones.index(drone) % len(COLOURS)]
        launch, home = (
            location_to_ground_ned_m(frame, plan.get_stop(id_).pads[drone])
            for id_ in (sortie.launch, sortie.home)
        )
        customer = location_to_ground_ned_m(frame, order_location(orders[sortie.order]))
        label = None if drone in labelled else drone
        labelled.add(drone)
        points = np.array([launch, customer, home])[:, :2]
        routes = ObstacleRoutes(obstacles, points, data.day.mission.cruise_height_m)
        for start, end, style in ((0, 1, "-"), (1, 2, "--")):
            route_ne_m = np.array(
                [points[start], *routes.waypoints_between(start, end), points[end]]
            )
            shown = label if style == "-" else None
            axes.plot(
                route_ne_m[:, 1],
                route_ne_m[:, 0],
                style,
                color=colour,
                linewidth=1.0,
                label=shown,
                zorder=2,
            )
        axes.plot(launch[1], launch[0], "o", color=colour, markersize=LAUNCH_PT, zorder=6)
        axes.plot(
            home[1], home[0], "o", color=colour, markersize=HOME_PT, fillstyle="none", zorder=6
        )
        axes.plot(customer[1], customer[0], "^", color=colour, markersize=6, zorder=4)
        label_text, at = format_minutes_and_seconds(sortie.launch_s), (customer[1], customer[0])
        axes.annotate(
            label_text, at, xytext=(5, -3), textcoords="offset points", fontsize=6, color=colour
        )


def _draw_truck(axes: Axes, frame: LocalFrame, plan: DayPlan) -> None:
    stops = np.array([location_to_ground_ned_m(frame, stop.location)[1::-1] for stop in plan.stops])
    axes.plot(*stops.T, "-", color="0.25", linewidth=2.2, label="truck", zorder=3)
    axes.plot(*stops[1:-1].T, "s", color="0.25", markersize=6, zorder=5)
    axes.plot(*stops[0], "D", color="black", markersize=9, label="depot", zorder=5)
    for stop, (x, y) in zip(plan.stops[:-1], stops[:-1], strict=True):
        label_text = _stop_label(plan, stop)
        drawn = axes.annotate(
            label_text, (x, y), xytext=(7, 7), textcoords="offset points", fontsize=8, zorder=7
        )
        drawn.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def _stop_label(plan: DayPlan, stop: PlannedStop) -> str:
    """Return number, arrival, and the numbers of launches and landings at a stop."""
    launch_count = sum(sortie.launch == stop.id for sortie in plan.sorties)
    home = sum(sortie.home == stop.id for sortie in plan.sorties)
    drones = (
        f" {launch_count}\N{UPWARDS ARROW} {home}\N{DOWNWARDS ARROW}"
        if launch_count or home
        else ""
    )
    return f"{stop.id.removeprefix('stop-')}: {format_minutes_and_seconds(stop.arrive_s)}{drones}"


def _draw_legend(axes: Axes) -> None:
    """Draw the legend: colours of drones and meaning of symbols."""
    ink = {"color": "0.25", "linewidth": 1.0}
    symbols = [
        Line2D([], [], marker="o", markersize=LAUNCH_PT, label="launch, outbound route", **ink),
        Line2D(
            [], [], marker="o", markersize=HOME_PT, linestyle="--", fillstyle="none",
            label="landing, return route", **ink
        ),
        Line2D([], [], marker="^", linestyle="", color="0.25", label="customer, start min:s"),
    ]  # fmt: skip
    known, names = axes.get_legend_handles_labels()
    axes.legend(
        [*known, *symbols],
        [*names, *(str(sign.get_label()) for sign in symbols)],
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        fontsize=8,
    )


def _draw_unplanned(axes: Axes, frame: LocalFrame, data: DayData, plan: DayPlan) -> None:
    unplanned_orders = {line.order for line in plan.unplanned}
    at = [
        location_to_ground_ned_m(frame, order_location(order))
        for order in data.orders
        if order.id in unplanned_orders
    ]
    if at:
        ne_m = np.array(at)[:, :2]
        axes.plot(ne_m[:, 1], ne_m[:, 0], "x", color="red", markersize=10, label="unplanned")
