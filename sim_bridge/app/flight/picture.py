"""The picture of a flight: map with wind, energy, chance of loss, and the wind estimate.

Of a simulated flight it shows the truth beside what the companion believed; of any other vehicle
what the companion heard and believed.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.logs.tlog_log import read_tlog
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.replay.recorded_flight import sampled
from sim_bridge.app.flight.judge import WIND_WINDOW_S, centred_mean
from sim_bridge.app.flight.record import TruthRecord
from sim_bridge.truth.terrain import Terrain

INK, OUT, BACK, WIND, WARN = "#22313f", "#1f77b4", "#d62728", "#2a9d8f", "#e76f51"
EARTH = "#b7a58a"
NAME = "flight.png"
LEAST_LOSS = 1e-5
"""Smaller chances of loss are drawn here: the tables behind them know no better."""

AFTER_S = 10.0
BARBS = 14
AXES = (("to_n_mps", "nn_m2ps2", OUT, "north"), ("to_e_mps", "ee_m2ps2", BACK, "east"))
"""Keys of the wind and of its variance in the record, colour and word of each axis."""


@dataclass(frozen=True, slots=True)
class Course:
    """Where the vehicle went, (n,) each; times are seconds since take-off.

    `above_reserve_wh` and `wind_to_ne_mps` are truth; None: nobody knows it. So are `up_m` and
    `ground_up_m` (above the depot: the vehicle, and the ground below it); None: not to be drawn.
    `took_off_s` and `landed_s` are on the clock of the companion's record.
    """

    t_s: np.ndarray
    east_m: np.ndarray
    north_m: np.ndarray
    airborne: np.ndarray
    took_off_s: float
    landed_s: float | None
    above_reserve_wh: np.ndarray | None = None
    wind_to_ne_mps: tuple[np.ndarray, np.ndarray] | None = None
    released_s: float | None = None
    up_m: np.ndarray | None = None
    ground_up_m: np.ndarray | None = None

    @property
    def end_s(self) -> float:
        """The last second in the air, since take-off."""
        flying = np.flatnonzero(self.airborne)
        return float(self.t_s[flying[-1]]) if flying.size else 1.0


def true_course(record: TruthRecord, reserve_wh: float, terrain: Terrain | None = None) -> Course:
    """Of a simulated vehicle; with its heights where a `terrain` is to be shown."""
    truth = record.arrays()
    took_off_s = record.took_off_s if record.took_off_s is not None else float(truth["t_s"][0])
    released = np.flatnonzero(np.diff(truth["parcel_aboard"]) < 0)
    return Course(
        t_s=truth["t_s"] - took_off_s,
        east_m=truth["east_m"],
        north_m=truth["north_m"],
        airborne=truth["airborne"] > 0,
        took_off_s=took_off_s,
        landed_s=record.landed_s,
        above_reserve_wh=truth["usable_wh"] - reserve_wh,
        wind_to_ne_mps=(truth["wind_to_n_mps"], truth["wind_to_e_mps"]),
        released_s=float(truth["t_s"][released[0]]) - took_off_s if released.size else None,
        up_m=None if terrain is None else -truth["down_m"],
        ground_up_m=None if terrain is None else _ground_up_m(terrain, truth),
    )


def _ground_up_m(terrain: Terrain, truth: dict[str, np.ndarray]) -> np.ndarray:
    places = zip(truth["north_m"], truth["east_m"], strict=True)
    return np.array([terrain.up_m(float(north), float(east)) for north, east in places])


def heard_course(stream: Path, result: dict[str, Any], frame: LocalFrame | None) -> Course | None:
    """Of any vehicle, by the stream that its companion heard; None: it never took off.

    `frame`: about the depot; None: about where the stream begins. Raises LeewayError for a stream
    without positions in flight.
    """
    took_off_s = _decided_s(result, "take_off")
    if took_off_s is None:
        return None
    samples = sampled(read_tlog(stream))
    known = np.isfinite(samples.lat_deg)
    airborne, t_s = samples.airborne[known], samples.t_s[known]
    if not airborne.any():
        raise LeewayError(f"{stream}: no position in flight")
    lat_rad, lon_rad = np.radians(samples.lat_deg[known]), np.radians(samples.lon_deg[known])
    frame = frame or LocalFrame(float(lat_rad[0]), float(lon_rad[0]), 0.0)
    ne_m = [
        frame.to_ned(float(lat), float(lon), 0.0)[:2]
        for lat, lon in zip(lat_rad, lon_rad, strict=True)
    ]
    north_m, east_m = np.array(ne_m).T
    released_s = _decided_s(result, "delivered")
    return Course(
        t_s=t_s - t_s[np.argmax(airborne)],
        east_m=east_m,
        north_m=north_m,
        airborne=airborne,
        took_off_s=took_off_s,
        landed_s=_decided_s(result, "landed"),
        released_s=None if released_s is None else released_s - took_off_s,
    )


def _decided_s(result: dict[str, Any], *kinds: str) -> float | None:
    return next((d["t_s"] for d in result.get("decisions", []) if d["kind"] in kinds), None)


def draw_flight(
    path: Path,
    *,
    title: str,
    course: Course,
    result: dict[str, Any],
    places_en_m: dict[str, tuple[float, float]],
    polygons_en_m: list[np.ndarray],
    max_loss: float,
    clearance_m: float = 0.0,
) -> None:
    """Write the PNG. `result` is the companion's own record; positions are east, north metres."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 7.6), layout="constrained")
    rows = 3 if course.ground_up_m is None else 4
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.15, 1.0))
    _draw_map(figure.add_subplot(grid[:, 0]), course, result, places_en_m, polygons_en_m)
    axes = [figure.add_subplot(grid[0, 1])]
    axes += [figure.add_subplot(grid[k, 1], sharex=axes[0]) for k in range(1, rows)]
    _draw_energy(axes[0], course, result)
    _draw_loss(axes[1], course, result, max_loss)
    if course.ground_up_m is not None:
        _draw_profile(axes[2], course, clearance_m)
    _draw_wind(axes[-1], course, result)
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        _mark_events(axis, course, result)
    axes[-1].set_xlim(0.0, course.end_s + AFTER_S)
    figure.suptitle(title, color=INK, fontsize=13)
    figure.savefig(path, dpi=110)


def _rows(course: Course, result: dict[str, Any], topic: str, key: str) -> list[dict[str, Any]]:
    """Rows that have a value, up to the landing: what follows is no part of the flight."""
    end_s = course.took_off_s + course.end_s
    found = result.get(topic, [])
    return [row for row in found if row.get(key) is not None and row["t_s"] <= end_s]


def _times(course: Course, rows: list[dict[str, Any]]) -> np.ndarray:
    return np.array([row["t_s"] for row in rows]) - course.took_off_s


def _draw_map(axis, course: Course, result, places, polygons) -> None:
    turned_s, diverted_s = _decided_s(result, "turn_back"), _decided_s(result, "divert")
    closed_s = diverted_s if turned_s is None else turned_s
    turn_s = None if closed_s is None else closed_s - course.took_off_s
    back_s = min(t for t in (turn_s, course.released_s, np.inf) if t is not None)
    back = course.t_s >= back_s
    for polygon in polygons:
        axis.fill(polygon[:, 0], polygon[:, 1], color="#999999", alpha=0.5, lw=0)
    axis.plot(course.east_m[~back], course.north_m[~back], color=OUT, lw=2, label="out")
    axis.plot(course.east_m[back], course.north_m[back], color=BACK, lw=2, label="home")
    _draw_barbs(axis, course, result)
    for name, (east, north) in places.items():
        axis.plot(east, north, "o", color=INK, ms=6)
        axis.annotate(name, (east, north), textcoords="offset points", xytext=(6, 8), color=INK)
    if turn_s is not None:
        k = min(int(np.searchsorted(course.t_s, turn_s)), course.t_s.size - 1)
        here = course.east_m[k], course.north_m[k]
        label = "diverted" if turned_s is None else "turned back"
        axis.plot(*here, "X", color=WARN, ms=12, label=label)
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.12)  # names and barbs stay inside
    axis.set_xlabel("east of the depot, m")
    axis.set_ylabel("north, m")
    axis.grid(alpha=0.25)
    axis.legend(loc="best", fontsize=8, frameon=False)


def _draw_barbs(axis, course: Course, result) -> None:
    """The true wind, or where nobody knows it the estimate."""
    flying = np.flatnonzero(course.airborne)
    rows = _rows(course, result, "wind", "to_n_mps")
    if not flying.size or (course.wind_to_ne_mps is None and not rows):
        return
    chosen = flying[np.linspace(0, flying.size - 1, BARBS).astype(int)]
    if course.wind_to_ne_mps is not None:
        north, east = (axis_mps[chosen] for axis_mps in course.wind_to_ne_mps)
    else:
        times = _times(course, rows)
        north, east = (
            np.interp(course.t_s[chosen], times, [row[key] for row in rows]) for key, *_ in AXES
        )
    axis.barbs(
        course.east_m[chosen],
        course.north_m[chosen],
        east,
        north,
        length=6,
        barb_increments={"half": 1, "full": 2, "flag": 10},
        color=WIND,
        linewidth=0.8,
    )
    which = "wind" if course.wind_to_ne_mps is not None else "wind estimate"
    axis.plot([], [], color=WIND, label=f"{which}, barbs (full feather 2 m/s)")


def _draw_energy(axis, course: Course, result) -> None:
    if course.above_reserve_wh is not None:
        label = "true energy above the reserve"
        axis.plot(course.t_s, course.above_reserve_wh, color=INK, lw=1.2, label=label)
    rows = _rows(course, result, "assessments", "margin_wh")
    if rows:
        margins = [row["margin_wh"] for row in rows]
        axis.plot(_times(course, rows), margins, color=OUT, lw=1.8, label="margin of the promise")
    axis.axhline(0.0, color=WARN, lw=1)
    axis.set_ylabel("Wh")
    _legend(axis)


def _draw_loss(axis, course: Course, result, max_loss: float) -> None:
    """1 - P: what the promise bounds, of which a plain axis of P shows nothing."""
    for key, colour, dashes, label in (
        ("p_home", OUT, "-", "not home, policy in force"),
        ("p_home_now", BACK, "--", "not home, turning back now"),
        ("p_success", WIND, ":", "no success"),
    ):
        rows = _rows(course, result, "assessments", key)
        if rows:
            loss = np.clip([1.0 - row[key] for row in rows], LEAST_LOSS, 1.0)
            axis.plot(_times(course, rows), loss, color=colour, ls=dashes, lw=1.5, label=label)
    axis.axhline(max_loss, color=WARN, lw=1, ls="--", label=f"allowed: {max_loss:g}")
    axis.set_yscale("log")
    axis.set_ylim(LEAST_LOSS / 1.5, 1.6)
    axis.set_ylabel("chance of loss")
    _legend(axis)


def _draw_profile(axis, course: Course, clearance_m: float) -> None:
    """The vehicle over the true ground below it, and the clearance that was asked."""
    if course.up_m is None or course.ground_up_m is None:
        return
    least_m = course.ground_up_m + clearance_m
    axis.plot(course.t_s, course.up_m, color=OUT, lw=1.6, label="vehicle")
    axis.plot(course.t_s, least_m, color=WARN, lw=1, ls="--", label=f"{clearance_m:g} m over it")
    bottom_m = float(course.ground_up_m.min()) - 5.0
    axis.fill_between(course.t_s, course.ground_up_m, bottom_m, color=EARTH, label="ground")
    axis.set_ylabel("above the depot, m")
    _legend(axis)


def _draw_wind(axis, course: Course, result) -> None:
    rows = _rows(course, result, "wind", "to_n_mps")
    for number, (key, variance, colour, name) in enumerate(AXES):
        if course.wind_to_ne_mps is not None:
            mean = centred_mean(course.t_s, course.wind_to_ne_mps[number], WIND_WINDOW_S)
            axis.plot(course.t_s, mean, color=colour, lw=1, alpha=0.55)
        if rows:
            times = _times(course, rows)
            values = np.array([row[key] for row in rows])
            spread = np.sqrt(np.array([row[variance] for row in rows]))
            axis.plot(times, values, color=colour, lw=1.6, label=f"to the {name}")
            axis.fill_between(times, values - spread, values + spread, color=colour, alpha=0.15)
    thin = "" if course.wind_to_ne_mps is None else "thin: truth, 10 s mean; "
    axis.set_ylabel("wind, m/s")
    axis.set_xlabel(f"seconds since take-off ({thin}band: one sigma)")
    _legend(axis)


def _legend(axis) -> None:
    """Of what there is: a companion that looked at nothing has no lines."""
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=8, frameon=False, loc="best")


def _mark_events(axis, course: Course, result) -> None:
    for decision in result.get("decisions", []):
        if decision["kind"] in ("turn_back", "divert", "delivered"):
            colour = INK if decision["kind"] == "delivered" else WARN
            axis.axvline(decision["t_s"] - course.took_off_s, color=colour, lw=0.8, ls=":")
    if course.landed_s is not None:
        axis.axvline(course.landed_s - course.took_off_s, color="#888888", lw=0.8, ls=":")
