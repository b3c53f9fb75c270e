"""The verdict on a flight, from truth: outcome, energy, margin, and the wind estimate's error."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_bridge.app.flight.record import TruthRecord
from sim_bridge.truth.terrain import Terrain

HOME_RADIUS_M = 12.0  # a pad with room for GNSS error (2.5 m CEP) and landing drift
DROP_RADIUS_M = 12.0
DROP_HEIGHT_SLACK_M = 4.0  # barometer and GNSS height error at the drop
WIND_WINDOW_S = 10.0  # evaluation: the centred 10 s mean of the true wind at the vehicle
WIND_WARM_UP_S = 30.0
STRAIGHT_M = 30.0
"""So near to a place where it may come down, a vehicle climbs and sinks: a pad, with the room that
a take-off, a drop or a landing in wind takes."""


@dataclass(frozen=True, slots=True)
class FlightVerdict:
    """Outcome of one flight by truth, in the units of docs/reference/flight-json.md."""

    outcome: str
    delivered: bool
    home: bool
    energy_used_wh: float
    margin_wh: float
    flight_time_s: float
    wind_rmse_mps: float | None
    wind_nees: float | None


def outcome_of(*, delivered: bool, home: bool, landed_by_person: bool = False) -> str:
    """SUC, DEL, FAIL, ABRT or TAKEN (docs/reference/outcomes.md).

    `landed_by_person`: whole, where that person chose. At home that changes nothing.
    """
    if home:
        return "SUC" if delivered else "ABRT"
    if landed_by_person:
        return "TAKEN"
    return "DEL" if delivered else "FAIL"


def judge(
    record: TruthRecord,
    *,
    homes_ne_m: list[tuple[float, float]],
    customer_ne_m: tuple[float, float],
    drop_height_m: float,
    reserve_wh: float,
    wind_estimates: list[dict[str, Any]],
) -> FlightVerdict:
    """Judge a finished (or stopped) flight by truth; home means landed there with the reserve."""
    truth = record.arrays()
    margin_wh = float(truth["usable_wh"][-1]) - reserve_wh
    on_ground = record.landed_s is not None
    here = (float(truth["north_m"][-1]), float(truth["east_m"][-1]))
    at_home = any(math.dist(here, home) <= HOME_RADIUS_M for home in homes_ne_m)
    never_left = record.took_off_s is None
    whole = on_ground and not record.crashed
    home = never_left or (whole and at_home and margin_wh >= 0.0)
    delivered = (
        record.released_ned_m is not None
        and record.release_height_m is not None
        and math.dist(record.released_ned_m[:2], customer_ne_m) <= DROP_RADIUS_M
        and record.release_height_m <= drop_height_m + DROP_HEIGHT_SLACK_M
    )
    rmse, nees = wind_errors(truth, record.took_off_s, record.landed_s, wind_estimates)
    end_s = record.landed_s if record.landed_s is not None else float(truth["t_s"][-1])
    return FlightVerdict(
        outcome=outcome_of(
            delivered=delivered, home=home, landed_by_person=whole and record.landed_by_person
        ),
        delivered=delivered,
        home=home,
        energy_used_wh=float(truth["energy_used_wh"][-1]),
        margin_wh=margin_wh,
        flight_time_s=end_s - record.took_off_s if record.took_off_s is not None else 0.0,
        wind_rmse_mps=rmse,
        wind_nees=nees,
    )


def centred_mean(t_s: np.ndarray, values: np.ndarray, window_s: float) -> np.ndarray:
    """Mean of `values` over [t - window/2, t + window/2] at every t, shortened at the ends."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    half_s = window_s / 2 + 1e-6  # samples on the edge count, whatever their last bit
    low = np.searchsorted(t_s, t_s - half_s, side="left")
    high = np.searchsorted(t_s, t_s + half_s, side="right")
    return (total[high] - total[low]) / (high - low)


def wind_errors(
    truth: dict[str, np.ndarray],
    took_off_s: float | None,
    landed_s: float | None,
    estimates: list[dict[str, Any]],
) -> tuple[float | None, float | None]:
    """RMSE of the wind vector (m/s) and mean normalised error squared (2 is ideal), or None.

    `estimates`: rows with t_s, to_n_mps, to_e_mps (where the air moves to) and the covariance
    nn_m2ps2, ne_m2ps2, ee_m2ps2.
    """
    if took_off_s is None or not estimates:
        return None, None
    t = truth["t_s"]
    last = landed_s if landed_s is not None else float(t[-1])
    rows = [r for r in estimates if took_off_s + WIND_WARM_UP_S <= r["t_s"] <= last]
    if not rows:
        return None, None
    at = np.array([r["t_s"] for r in rows])
    mean_n = np.interp(at, t, centred_mean(t, truth["wind_to_n_mps"], WIND_WINDOW_S))
    mean_e = np.interp(at, t, centred_mean(t, truth["wind_to_e_mps"], WIND_WINDOW_S))
    to_ne = np.array([(r["to_n_mps"], r["to_e_mps"]) for r in rows])
    err = to_ne - np.stack([mean_n, mean_e], 1)
    nn, ne, ee = np.array([(r["nn_m2ps2"], r["ne_m2ps2"], r["ee_m2ps2"]) for r in rows]).T
    cov = np.moveaxis(np.array([[nn, ne], [ne, ee]]), -1, 0)
    nees = np.einsum("ki,kij,kj->k", err, np.linalg.inv(cov), err)
    return float(np.sqrt(np.mean(np.sum(err**2, axis=1)))), float(np.mean(nees))


@dataclass(frozen=True, slots=True)
class NearestGround:
    """The least true height over the ground, and where (m about the depot)."""

    clearance_m: float
    north_m: float
    east_m: float

    @property
    def place(self) -> dict[str, float]:
        """Where, as a flight's JSON has it."""
        return {"north_m": round(self.north_m, 1), "east_m": round(self.east_m, 1)}


def nearest_ground(
    record: TruthRecord, terrain: Terrain, low_ne_m: list[tuple[float, float]]
) -> NearestGround | None:
    """Away from the places where the vehicle may be low; None where it never was in the air there.

    A vehicle that came down elsewhere has met the ground: it is 0 there.
    """
    truth = record.arrays()
    columns = (truth[name] for name in ("north_m", "east_m", "down_m", "airborne"))
    nearest: NearestGround | None = None
    flown = False
    for north_m, east_m, down_m, airborne in zip(*columns, strict=True):
        flown = flown or bool(airborne)
        if not flown or any(math.dist((north_m, east_m), low) <= STRAIGHT_M for low in low_ne_m):
            continue
        over_m = max(float(-down_m) - terrain.up_m(float(north_m), float(east_m)), 0.0)
        if nearest is None or over_m < nearest.clearance_m:
            nearest = NearestGround(over_m, float(north_m), float(east_m))
    return nearest
