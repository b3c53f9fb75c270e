"""The picture of a flight: map with wind, margin, P(home), and the wind estimate against truth."""

from pathlib import Path
from typing import Any

import numpy as np

from sim_bridge.app.flight.judge import WIND_WINDOW_S, FlightVerdict, centred_mean
from sim_bridge.app.flight.record import TruthRecord

INK, OUT, BACK, WIND, WARN = "#22313f", "#1f77b4", "#d62728", "#2a9d8f", "#e76f51"


def draw_flight(
    path: Path,
    *,
    title: str,
    record: TruthRecord,
    verdict: FlightVerdict,
    result: dict[str, Any],
    places_en_m: dict[str, tuple[float, float]],
    polygons_en_m: list[np.ndarray],
    reserve_wh: float,
    max_loss: float,
) -> None:
    """Write the PNG. `result` is the companion's own record; positions are east, north metres."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    truth = record.arrays()
    start_s = record.took_off_s if record.took_off_s is not None else float(truth["t_s"][0])
    figure = Figure(figsize=(13.0, 7.6), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1.0))
    _draw_map(figure.add_subplot(grid[:, 0]), truth, result, places_en_m, polygons_en_m, start_s)
    axes = [figure.add_subplot(grid[0, 1])]
    axes += [figure.add_subplot(grid[k, 1], sharex=axes[0]) for k in (1, 2)]
    _draw_energy(axes[0], truth, result, reserve_wh, start_s)
    _draw_promise(axes[1], result, max_loss, start_s)
    _draw_wind(axes[2], truth, result, start_s)
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        _mark_events(axis, result, record, start_s)
    figure.suptitle(
        f"{title}: {verdict.outcome} in {verdict.flight_time_s:.0f} s,"
        f" {verdict.margin_wh:+.1f} Wh above the reserve at the end",
        color=INK,
        fontsize=13,
    )
    figure.savefig(path, dpi=110)


def _draw_map(axis, truth, result, places, polygons, start_s) -> None:
    decisions = result.get("decisions", [])
    turn_s = next((d["t_s"] for d in decisions if d["kind"] in ("turn_back", "divert")), None)
    released = np.flatnonzero(np.diff(truth["parcel_aboard"]) < 0)
    back_s = turn_s if turn_s is not None else np.inf
    if released.size:
        back_s = min(back_s, float(truth["t_s"][released[0]]))
    back = truth["t_s"] >= back_s
    for polygon in polygons:
        axis.fill(polygon[:, 0], polygon[:, 1], color="#999999", alpha=0.5, lw=0)
    axis.plot(truth["east_m"][~back], truth["north_m"][~back], color=OUT, lw=2, label="out")
    axis.plot(truth["east_m"][back], truth["north_m"][back], color=BACK, lw=2, label="home")
    flying = np.flatnonzero(truth["airborne"] > 0)
    if flying.size:
        chosen = flying[np.linspace(0, flying.size - 1, 14).astype(int)]
        axis.barbs(
            truth["east_m"][chosen],
            truth["north_m"][chosen],
            truth["wind_to_e_mps"][chosen],
            truth["wind_to_n_mps"][chosen],
            length=6,
            barb_increments={"half": 1, "full": 2, "flag": 10},
            color=WIND,
            linewidth=0.8,
        )
        axis.plot([], [], color=WIND, label="wind barbs (full feather 2 m/s)")
    for name, (east, north) in places.items():
        axis.plot(east, north, "o", color=INK, ms=6)
        axis.annotate(name, (east, north), textcoords="offset points", xytext=(6, 8), color=INK)
    if turn_s is not None:
        k = int(np.searchsorted(truth["t_s"], turn_s))
        k = min(k, truth["t_s"].size - 1)
        axis.plot(
            truth["east_m"][k], truth["north_m"][k], "X", color=WARN, ms=12, label="gate closed"
        )
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("east of the depot, m")
    axis.set_ylabel("north, m")
    axis.grid(alpha=0.25)
    axis.legend(loc="best", fontsize=8, frameon=False)


def _draw_energy(axis, truth, result, reserve_wh, start_s) -> None:
    axis.plot(truth["t_s"] - start_s, truth["usable_wh"] - reserve_wh, color=INK, lw=1.2)
    axis.plot([], [], color=INK, label="true energy above the reserve")
    rows = [d for d in result.get("assessments", []) if d.get("margin_wh") is not None]
    if rows:
        times = np.array([d["t_s"] for d in rows]) - start_s
        axis.plot(
            times, [d["margin_wh"] for d in rows], color=OUT, lw=1.8, label="margin of the promise"
        )
    axis.axhline(0.0, color=WARN, lw=1)
    axis.set_ylabel("Wh")
    axis.legend(fontsize=8, frameon=False)


def _draw_promise(axis, result, max_loss, start_s) -> None:
    rows = [d for d in result.get("assessments", []) if d.get("p_home") is not None]
    if rows:
        times = np.array([d["t_s"] for d in rows]) - start_s
        for key, colour, label in (
            ("p_home", OUT, "P(home), policy in force"),
            ("p_home_now", BACK, "P(home), turning back now"),
            ("p_success", WIND, "P(success)"),
        ):
            values = [np.nan if d.get(key) is None else d[key] for d in rows]
            axis.plot(times, values, color=colour, lw=1.5, label=label)
    axis.axhline(1.0 - max_loss, color=WARN, lw=1, ls="--", label="asked for")
    axis.set_ylim(-0.03, 1.05)
    axis.set_ylabel("probability")
    axis.legend(fontsize=8, frameon=False, loc="lower left")


def _draw_wind(axis, truth, result, start_s) -> None:
    rows = result.get("wind", [])
    for key, colour, name in (("n", OUT, "north"), ("e", BACK, "east")):
        mean = centred_mean(truth["t_s"], truth[f"wind_to_{key}_mps"], WIND_WINDOW_S)
        axis.plot(truth["t_s"] - start_s, mean, color=colour, lw=1, alpha=0.55)
        if rows:
            times = np.array([r["t_s"] for r in rows]) - start_s
            values = np.array([r[key] for r in rows])
            spread = np.sqrt(np.array([r[key * 2] for r in rows]))
            axis.plot(times, values, color=colour, lw=1.6, label=f"to the {name}")
            axis.fill_between(times, values - spread, values + spread, color=colour, alpha=0.15)
    axis.set_ylabel("wind, m/s")
    axis.set_xlabel("seconds since take-off (thin: truth, 10 s mean; band: one sigma)")
    flying = np.flatnonzero(truth["airborne"] > 0)
    end_s = float(truth["t_s"][flying[-1]]) - start_s if flying.size else 1.0
    axis.set_xlim(0.0, end_s + 10.0)
    axis.legend(fontsize=8, frameon=False)


def _mark_events(axis, result, record, start_s) -> None:
    for decision in result.get("decisions", []):
        if decision["kind"] in ("turn_back", "divert", "delivered"):
            colour = INK if decision["kind"] == "delivered" else WARN
            axis.axvline(decision["t_s"] - start_s, color=colour, lw=0.8, ls=":")
    if record.landed_s is not None:
        axis.axvline(record.landed_s - start_s, color="#888888", lw=0.8, ls=":")
