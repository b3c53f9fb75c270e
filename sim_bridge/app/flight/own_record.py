"""The verdict on a flight of a vehicle that we do not simulate, from the companion's own record.

The truth is unknown there. Figures that need it (wind error, the clairvoyant's result) are None.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sim_bridge.app.flight.judge import WIND_WARM_UP_S, wind_errors

DECISION_KEYS = ("t_s", "kind", "p_home", "p_home_now", "p_success", "margin_wh", "reason")


def own_row(
    result: dict[str, Any],
    *,
    vehicle: str,
    autopilot: str,
    run: str,
    steady_wind: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """A row of docs/reference/flight-json.md, from a companion's `result.json` ({}: none).

    `steady_wind`: towards north and east (m/s), where it is known that it blew all the time.

    Two keys are its own: `energy_predicted_wh`, the energy of the whole flight as the return budget
    first predicted it in the air, and `wind_std_mps`, the estimate's own standard deviation.
    """
    decisions = result.get("decisions", [])
    took_off_s = _when(decisions, "take_off")
    landed_s = _when(decisions, "landed")
    energy = result.get("energy", [])
    wind = result.get("wind", [])
    rmse_mps, nees = _wind_errors(steady_wind, took_off_s, landed_s, wind)
    assessments = [a for a in result.get("assessments", []) if a.get("p_home") is not None]
    return {
        "vehicle": vehicle,
        "autopilot": autopilot,
        "judged_by": "companion",
        "charge_frac": None,
        "outcome": result.get("outcome"),
        "delivered": result.get("delivered"),
        "home": result.get("home"),
        "energy_used_wh": _rounded(_used_wh(energy, landed_s)),
        "energy_predicted_wh": _rounded(_predicted_wh(energy, assessments)),
        "margin_wh": _rounded(result.get("margin_wh")),
        "flight_time_s": _flight_time_s(took_off_s, landed_s),
        "least_clearance_m": None,
        "least_clearance_at": None,
        "wind_rmse_mps": _rounded(rmse_mps),
        "wind_nees": _rounded(nees),
        "wind_std_mps": _wind_std_mps(wind, took_off_s, landed_s),
        "p_home_min": min((a["p_home"] for a in assessments), default=None),
        "clairvoyant": None,
        "clairvoyant_margin_wh": None,
        "findings": result.get("findings", []),
        "reason": result.get("reason"),
        "settings": result.get("settings", []),
        "decisions": [{key: d.get(key) for key in DECISION_KEYS} for d in decisions],
        "run": run,
    }


def _when(decisions: Sequence[dict[str, Any]], kind: str) -> float | None:
    times = [d["t_s"] for d in decisions if d["kind"] == kind]
    return times[-1] if times else None


def _used_wh(energy: Sequence[dict[str, Any]], t_s: float | None) -> float | None:
    """Energy used since power-up, by the last report up to `t_s`."""
    if t_s is None:
        return None
    return next((row["used_wh"] for row in reversed(energy) if row["t_s"] <= t_s), None)


def _predicted_wh(
    energy: Sequence[dict[str, Any]], assessments: Sequence[dict[str, Any]]
) -> float | None:
    """What the first look in the air said is needed, and what had been used by then."""
    if not assessments:
        return None
    first = assessments[0]
    used_wh = _used_wh(energy, first["t_s"])
    return None if used_wh is None else first["energy_need_wh"] + used_wh


def _flight_time_s(took_off_s: float | None, landed_s: float | None) -> float | None:
    if took_off_s is None:
        return 0.0
    return None if landed_s is None else round(landed_s - took_off_s, 2)


def _wind_errors(
    steady_wind: tuple[float, float] | None,
    took_off_s: float | None,
    landed_s: float | None,
    wind: list[dict[str, Any]],
) -> tuple[float | None, float | None]:
    """RMSE (m/s) and NEES of the estimate, as of simulated flights; None where nobody knows."""
    if steady_wind is None or not wind:
        return None, None
    t_s = np.array([wind[0]["t_s"], wind[-1]["t_s"]])
    north, east = steady_wind
    truth = {
        "t_s": t_s,
        "wind_to_n_mps": np.full(2, north),
        "wind_to_e_mps": np.full(2, east),
    }
    return wind_errors(truth, took_off_s, landed_s, wind)


def _wind_std_mps(
    wind: Sequence[dict[str, Any]], took_off_s: float | None, landed_s: float | None
) -> float | None:
    """Root mean square of the estimate's stated error (both axes), as the wind error is taken."""
    if took_off_s is None:
        return None
    last_s = math.inf if landed_s is None else landed_s
    rows = [row for row in wind if took_off_s + WIND_WARM_UP_S <= row["t_s"] <= last_s]
    if not rows:
        return None
    return round(math.sqrt(sum(row["nn_m2ps2"] + row["ee_m2ps2"] for row in rows) / len(rows)), 4)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
