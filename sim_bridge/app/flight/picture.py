"""Picture of a simulated flight: map with wind, energy, loss probability and wind estimate.

The plots show the truth together with the companion's estimates.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim_bridge.app.flight.judge import WIND_WINDOW_S, centred_moving_mean
from sim_bridge.app.world.truth_record import TruthRecord
from sim_bridge.truth.terrain import Terrain

INK, OUT, BACK, WIND, WARN = "#22313f", "#1f77b4", "#d62728", "#2a9d8f", "#e76f51"
EARTH = "#b7a58a"
FILE_NAME = "flight.png"
MIN_LOSS = 1e-5
"""Lower bound of plotted loss probabilities: the tables behind them resolve no less."""

TIME_MARGIN_S = 10.0
BARB_COUNT = 14
WIND_AXES = (("to_n_mps", "nn_m2ps2", OUT, "north"), ("to_e_mps", "ee_m2ps2", BACK, "east"))
"""Keys of the wind and of its variance in the record, colour and label of each axis."""


@dataclass(frozen=True, slots=True)
class FlightTrack:
    """Trajectory of the vehicle, (n,) each; times are seconds since take-off.

    `up_m` and `ground_up_m` are heights above the depot: the vehicle and the ground below it. None:
    not drawn.
    `takeoff_s` and `landed_s` are on the clock of the companion's record.
    """

    t_s: np.ndarray
    east_m: np.ndarray
    north_m: np.ndarray
    airborne: np.ndarray
    takeoff_s: float
    landed_s: float | None
    above_reserve_wh: np.ndarray
    wind_to_ne_mps: tuple[np.ndarray, np.ndarray]
    released_s: float | None = None
    up_m: np.ndarray | None = None
    ground_up_m: np.ndarray | None = None

    @property
    def last_airborne_s(self) -> float:
        """Time of the last airborne sample, in seconds since take-off."""
        airborne_indices = np.flatnonzero(self.airborne)
        return float(self.t_s[airborne_indices[-1]]) if airborne_indices.size else 1.0


def build_true_flight_track(
    record: TruthRecord, reserve_wh: float, terrain: Terrain | None = None
) -> FlightTrack:
    """Return the trajectory of a simulated vehicle, with heights if `terrain` is given."""
    truth = record.samples_by_column()
    takeoff_s = record.takeoff_s if record.takeoff_s is not None else float(truth["t_s"][0])
    return FlightTrack(
        t_s=truth["t_s"] - takeoff_s,
        east_m=truth["east_m"],
        north_m=truth["north_m"],
        airborne=truth["airborne"] > 0,
        takeoff_s=takeoff_s,
        landed_s=record.landed_s,
        above_reserve_wh=truth["usable_wh"] - reserve_wh,
        wind_to_ne_mps=(truth["wind_to_n_mps"], truth["wind_to_e_mps"]),
        released_s=None if record.released_s is None else record.released_s - takeoff_s,
        up_m=None if terrain is None else -truth["down_m"],
        ground_up_m=None if terrain is None else _ground_height_along_track_m(terrain, truth),
    )


def _ground_height_along_track_m(terrain: Terrain, truth: dict[str, np.ndarray]) -> np.ndarray:
    locations = zip(truth["north_m"], truth["east_m"], strict=True)
    return np.array(
        [terrain.height_above_depot_m(float(north), float(east)) for north, east in locations]
    )


def _first_decision_time_s(companion_result: dict[str, Any], *decision_kinds: str) -> float | None:
    return next(
        (d["t_s"] for d in companion_result.get("decisions", []) if d["kind"] in decision_kinds),
        None,
    )


def write_flight_picture(
    png_path: Path,
    *,
    title: str,
    track: FlightTrack,
    companion_result: dict[str, Any],
    locations_en_m: dict[str, tuple[float, float]],
    polygons_en_m: list[np.ndarray],
    max_loss: float,
    clearance_m: float = 0.0,
) -> None:
    """Write the PNG of the companion's record `companion_result`; positions: east, north, m."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 7.6), layout="constrained")
    rows = 3 if track.ground_up_m is None else 4
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.15, 1.0))
    _draw_map(
        figure.add_subplot(grid[:, 0]), track, companion_result, locations_en_m, polygons_en_m
    )
    axes = [figure.add_subplot(grid[0, 1])]
    axes += [figure.add_subplot(grid[k, 1], sharex=axes[0]) for k in range(1, rows)]
    _draw_energy_margins(axes[0], track, companion_result)
    _draw_loss_probabilities(axes[1], track, companion_result, max_loss)
    if track.ground_up_m is not None:
        _draw_height_profile(axes[2], track, clearance_m)
    _draw_wind_estimates(axes[-1], track, companion_result)
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        _draw_event_lines(axis, track, companion_result)
    axes[-1].set_xlim(0.0, track.last_airborne_s + TIME_MARGIN_S)
    figure.suptitle(title, color=INK, fontsize=13)
    figure.savefig(png_path, dpi=110)


def _rows_with_value_until_landing(
    track: FlightTrack, result: dict[str, Any], table_name: str, required_key: str
) -> list[dict[str, Any]]:
    """Return rows with a value up to the landing; later rows are not part of the flight."""
    end_s = track.takeoff_s + track.last_airborne_s
    found = result.get(table_name, [])
    return [row for row in found if row.get(required_key) is not None and row["t_s"] <= end_s]


def _times_since_takeoff_s(track: FlightTrack, rows: list[dict[str, Any]]) -> np.ndarray:
    return np.array([row["t_s"] for row in rows]) - track.takeoff_s


def _draw_map(axis, track: FlightTrack, result, locations_en_m, polygons_en_m) -> None:
    turn_back_s, diverted_s = (
        _first_decision_time_s(result, "turn_back"),
        _first_decision_time_s(result, "divert"),
    )
    closed_s = diverted_s if turn_back_s is None else turn_back_s
    turn_s = None if closed_s is None else closed_s - track.takeoff_s
    back_s = min(t for t in (turn_s, track.released_s, np.inf) if t is not None)
    back = track.t_s >= back_s
    for polygon in polygons_en_m:
        axis.fill(polygon[:, 0], polygon[:, 1], color="#999999", alpha=0.5, lw=0)
    axis.plot(track.east_m[~back], track.north_m[~back], color=OUT, lw=2, label="out")
    axis.plot(track.east_m[back], track.north_m[back], color=BACK, lw=2, label="home")
    _draw_wind_barbs(axis, track)
    for name, (east, north) in locations_en_m.items():
        axis.plot(east, north, "o", color=INK, ms=6)
        axis.annotate(name, (east, north), textcoords="offset points", xytext=(6, 8), color=INK)
    if turn_s is not None:
        k = min(int(np.searchsorted(track.t_s, turn_s)), track.t_s.size - 1)
        here = track.east_m[k], track.north_m[k]
        label = "diverted" if turn_back_s is None else "turned back"
        axis.plot(*here, "X", color=WARN, ms=12, label=label)
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.12)  # names and barbs stay inside
    axis.set_xlabel("east of the depot, m")
    axis.set_ylabel("north, m")
    axis.grid(alpha=0.25)
    axis.legend(loc="best", fontsize=8, frameon=False)


def _draw_wind_barbs(axis, track: FlightTrack) -> None:
    """Draw the true wind along the route."""
    airborne_indices = np.flatnonzero(track.airborne)
    if not airborne_indices.size:
        return
    barb_indices = airborne_indices[
        np.linspace(0, airborne_indices.size - 1, BARB_COUNT).astype(int)
    ]
    north, east = (axis_mps[barb_indices] for axis_mps in track.wind_to_ne_mps)
    axis.barbs(
        track.east_m[barb_indices],
        track.north_m[barb_indices],
        east,
        north,
        length=6,
        barb_increments={"half": 1, "full": 2, "flag": 10},
        color=WIND,
        linewidth=0.8,
    )
    axis.plot([], [], color=WIND, label="wind, barbs (full feather 2 m/s)")


def _draw_energy_margins(axis, track: FlightTrack, result) -> None:
    label = "true energy above the reserve"
    axis.plot(track.t_s, track.above_reserve_wh, color=INK, lw=1.2, label=label)
    rows = _rows_with_value_until_landing(track, result, "assessments", "margin_wh")
    if rows:
        margins = [row["margin_wh"] for row in rows]
        axis.plot(
            _times_since_takeoff_s(track, rows),
            margins,
            color=OUT,
            lw=1.8,
            label="margin to the next decision, best site",
        )
        home = next((s["landing"] for row in rows for s in row.get("sites", ())), "")
        now = [(row, s) for row in rows for s in row.get("sites", ()) if s["landing"] == home]
        axis.plot(
            _times_since_takeoff_s(track, [row for row, _ in now]),
            [site["margin_now_wh"] for _, site in now],
            color=BACK,
            label=f"margin now, {home}: below 0 it diverts",
        )
    axis.axhline(0.0, color=WARN, lw=1)
    axis.set_ylabel("Wh")
    _add_legend_if_labelled(axis)


def _draw_loss_probabilities(axis, track: FlightTrack, result, max_loss: float) -> None:
    """Draw 1 - P on a logarithmic axis, because a linear axis of P does not resolve it."""
    for key, colour, dashes, label in (
        ("p_home", OUT, "-", "not home, policy in force"),
        ("p_home_now", BACK, "--", "not home, turning back now"),
        ("p_success", WIND, ":", "no success"),
    ):
        rows = _rows_with_value_until_landing(track, result, "assessments", key)
        if rows:
            loss = np.clip([1.0 - row[key] for row in rows], MIN_LOSS, 1.0)
            axis.plot(
                _times_since_takeoff_s(track, rows),
                loss,
                color=colour,
                ls=dashes,
                lw=1.5,
                label=label,
            )
    axis.axhline(max_loss, color=WARN, lw=1, ls="--", label=f"allowed: {max_loss:g}")
    axis.set_yscale("log")
    axis.set_ylim(MIN_LOSS / 1.5, 1.6)
    axis.set_ylabel("chance of loss (model)")
    _add_legend_if_labelled(axis)


def _draw_height_profile(axis, track: FlightTrack, clearance_m: float) -> None:
    """Draw the vehicle above the true ground, and the required clearance."""
    if track.up_m is None or track.ground_up_m is None:
        return
    least_m = track.ground_up_m + clearance_m
    axis.plot(track.t_s, track.up_m, color=OUT, lw=1.6, label="vehicle")
    axis.plot(track.t_s, least_m, color=WARN, lw=1, ls="--", label=f"{clearance_m:g} m over it")
    bottom_m = float(track.ground_up_m.min()) - 5.0
    axis.fill_between(track.t_s, track.ground_up_m, bottom_m, color=EARTH, label="ground")
    axis.set_ylabel("above the depot, m")
    _add_legend_if_labelled(axis)


def _draw_wind_estimates(axis, track: FlightTrack, result) -> None:
    rows = _rows_with_value_until_landing(track, result, "wind", "to_n_mps")
    for number, (key, variance, colour, name) in enumerate(WIND_AXES):
        mean = centred_moving_mean(track.t_s, track.wind_to_ne_mps[number], WIND_WINDOW_S)
        axis.plot(track.t_s, mean, color=colour, lw=1, alpha=0.55)
        if rows:
            times = _times_since_takeoff_s(track, rows)
            values = np.array([row[key] for row in rows])
            spread = np.sqrt(np.array([row[variance] for row in rows]))
            axis.plot(times, values, color=colour, lw=1.6, label=f"to the {name}")
            axis.fill_between(times, values - spread, values + spread, color=colour, alpha=0.15)
    axis.set_ylabel("wind, m/s")
    axis.set_xlabel("seconds since take-off (thin: truth, 10 s mean; band: one sigma)")
    _add_legend_if_labelled(axis)


def _add_legend_if_labelled(axis) -> None:
    """Add a legend if the axis has labelled lines; a short record can have none."""
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=8, frameon=False, loc="best")


def _draw_event_lines(axis, track: FlightTrack, result) -> None:
    for decision in result.get("decisions", []):
        if decision["kind"] in ("turn_back", "divert", "delivered"):
            colour = INK if decision["kind"] == "delivered" else WARN
            axis.axvline(decision["t_s"] - track.takeoff_s, color=colour, lw=0.8, ls=":")
    if track.landed_s is not None:
        axis.axvline(track.landed_s - track.takeoff_s, color="#888888", lw=0.8, ls=":")
