"""Evaluation of an external vehicle's flight, from the companion's record.

The truth is unknown. Figures that need it (wind error, clairvoyant result) are None.
"""

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from companion.core.mission.actions import Decision
from sim_bridge.app.flight.judge import WIND_SETTLING_S, wind_rmse_and_nees

DECISION_KEYS = tuple(each.name for each in fields(Decision))


def flight_row_from_companion_result(
    companion_result: dict[str, Any],
    *,
    vehicle: str,
    autopilot: str,
    run: str,
    steady_wind_to_ne_mps: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Return a row of docs/reference/flight-json.md from a companion's `result.json` ({}: none).

    `steady_wind_to_ne_mps`: towards north and east (m/s), if a constant wind is known.

    Two keys exist only here: `energy_predicted_wh`, the first in-flight prediction of the return
    budget for the whole flight, and `mean_wind_axis_std_mps`, the standard deviation of the wind
    estimate.
    """
    decisions = companion_result.get("decisions", [])
    takeoff_s = _last_decision_time_s(decisions, "take_off")
    landed_s = _last_decision_time_s(decisions, "landed")
    energy = companion_result.get("energy", [])
    wind = companion_result.get("wind", [])
    rmse_mps, nees = _wind_rmse_and_nees_for_steady_wind(
        steady_wind_to_ne_mps, takeoff_s, landed_s, wind
    )
    return {
        "vehicle": vehicle,
        "autopilot": autopilot,
        "judged_by": "companion",
        "charge_frac": None,
        "outcome": companion_result.get("outcome"),
        "delivered": companion_result.get("delivered"),
        "home": companion_result.get("home"),
        "energy_used_wh": round_or_none(_energy_used_wh_at(energy, landed_s)),
        "energy_predicted_wh": round_or_none(
            _first_predicted_total_energy_wh(energy, _assessments_with_p_home(companion_result))
        ),
        "margin_wh": round_or_none(companion_result.get("margin_wh")),
        "flight_time_s": _flight_time_s(takeoff_s, landed_s),
        "least_clearance_m": None,
        "least_clearance_at": None,
        "wind_rmse_mps": round_or_none(rmse_mps),
        "wind_nees": round_or_none(nees),
        "wind_std_mps": _rms_wind_estimate_std_mps(wind, takeoff_s, landed_s),
        "clairvoyant": None,
        "clairvoyant_margin_wh": None,
        "findings": companion_result.get("findings", []),
        "reason": companion_result.get("reason"),
        "settings": companion_result.get("settings", []),
        "run": run,
        **decisions_and_least_p_home(companion_result),
    }


def decisions_and_least_p_home(companion_result: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a flight's row that follows from the companion's decisions."""
    assessments = _assessments_with_p_home(companion_result)
    decisions = companion_result.get("decisions", [])
    return {
        "p_home_min": min((a["p_home"] for a in assessments), default=None),
        "p_home_stated_min": min(
            (a.get("p_home_stated", a["p_home"]) for a in assessments), default=None
        ),
        "decisions": [{key: d.get(key) for key in DECISION_KEYS} for d in decisions],
    }


def _assessments_with_p_home(companion_result: dict[str, Any]) -> list[dict[str, Any]]:
    assessments = companion_result.get("assessments", [])
    return [a for a in assessments if a.get("p_home") is not None]


def _last_decision_time_s(decisions: Sequence[dict[str, Any]], kind: str) -> float | None:
    times = [d["t_s"] for d in decisions if d["kind"] == kind]
    return times[-1] if times else None


def _energy_used_wh_at(energy_rows: Sequence[dict[str, Any]], t_s: float | None) -> float | None:
    """Return the energy used since power-up, from the last report up to `t_s`."""
    if t_s is None:
        return None
    return next((row["used_wh"] for row in reversed(energy_rows) if row["t_s"] <= t_s), None)


def _first_predicted_total_energy_wh(
    energy_rows: Sequence[dict[str, Any]], assessments: Sequence[dict[str, Any]]
) -> float | None:
    """Return the energy need of the first assessment plus the energy used before it."""
    if not assessments:
        return None
    first = assessments[0]
    used_wh = _energy_used_wh_at(energy_rows, first["t_s"])
    return None if used_wh is None else first["energy_need_wh"] + used_wh


def _flight_time_s(takeoff_s: float | None, landed_s: float | None) -> float | None:
    if takeoff_s is None:
        return 0.0
    return None if landed_s is None else round(landed_s - takeoff_s, 2)


def _wind_rmse_and_nees_for_steady_wind(
    steady_wind_to_ne_mps: tuple[float, float] | None,
    takeoff_s: float | None,
    landed_s: float | None,
    wind_estimate_rows: list[dict[str, Any]],
) -> tuple[float | None, float | None]:
    """Return RMSE (m/s) and NEES of the wind estimate; None if the wind is unknown."""
    if steady_wind_to_ne_mps is None or not wind_estimate_rows:
        return None, None
    t_s = np.array([wind_estimate_rows[0]["t_s"], wind_estimate_rows[-1]["t_s"]])
    north, east = steady_wind_to_ne_mps
    truth = {
        "t_s": t_s,
        "wind_to_n_mps": np.full(2, north),
        "wind_to_e_mps": np.full(2, east),
    }
    return wind_rmse_and_nees(truth, takeoff_s, landed_s, wind_estimate_rows)


def _rms_wind_estimate_std_mps(
    wind_estimate_rows: Sequence[dict[str, Any]], takeoff_s: float | None, landed_s: float | None
) -> float | None:
    """Return the RMS of the estimated wind std over both axes and the samples of the RMSE."""
    if takeoff_s is None:
        return None
    last_s = math.inf if landed_s is None else landed_s
    rows = [
        row for row in wind_estimate_rows if takeoff_s + WIND_SETTLING_S <= row["t_s"] <= last_s
    ]
    if not rows:
        return None
    return round(math.sqrt(sum(row["nn_m2ps2"] + row["ee_m2ps2"] for row in rows) / len(rows)), 4)


def round_or_none(value: float | None, digits: int = 3) -> float | None:
    """Return the rounded value, or None if it is unknown."""
    return None if value is None else round(value, digits)
