"""Evaluation of a flight from truth: outcome, energy, margin and wind estimation error."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_bridge.app.world.truth_record import FlightOutcome, TruthRecord, is_within_home_radius
from sim_bridge.truth.terrain import Terrain

WIND_WINDOW_S = 10.0  # evaluation: the centred 10 s mean of the true wind at the vehicle
WIND_SETTLING_S = 30.0
VERTICAL_FLIGHT_RADIUS_M = 30.0
"""Radius around a landing site in which a vehicle climbs and descends: the pad, plus the room for
a take-off, a drop or a landing in wind."""


@dataclass(frozen=True, slots=True)
class FlightVerdict:
    """True outcome of one flight, in the units of docs/reference/flight-json.md."""

    outcome: FlightOutcome
    flight_time_s: float
    wind_rmse_mps: float | None
    wind_nees: float | None


def evaluate_flight(
    record: TruthRecord,
    *,
    landing_sites_ne_m: list[tuple[float, float]],
    customer_ne_m: tuple[float, float],
    drop_height_m: float,
    reserve_wh: float,
    wind_estimates: list[dict[str, Any]],
) -> FlightVerdict:
    """Evaluate an ended flight from truth."""
    truth = record.samples_by_column()
    final_ne_m = (float(truth["north_m"][-1]), float(truth["east_m"][-1]))
    outcome = record.evaluate_outcome(
        delivered=record.is_parcel_released_at(customer_ne_m, drop_height_m),
        landed_s=record.landed_s,
        at_home=any(is_within_home_radius(final_ne_m, site) for site in landing_sites_ne_m),
        reserve_wh=reserve_wh,
    )
    rmse, nees = wind_rmse_and_nees(truth, record.takeoff_s, record.landed_s, wind_estimates)
    end_s = record.landed_s if record.landed_s is not None else float(truth["t_s"][-1])
    return FlightVerdict(
        outcome=outcome,
        flight_time_s=end_s - record.takeoff_s if record.takeoff_s is not None else 0.0,
        wind_rmse_mps=rmse,
        wind_nees=nees,
    )


def centred_moving_mean(t_s: np.ndarray, values: np.ndarray, window_s: float) -> np.ndarray:
    """Return the mean of `values` over [t - window/2, t + window/2], shortened at the ends."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    half_s = window_s / 2 + 1e-6  # include samples on the edge despite rounding
    low = np.searchsorted(t_s, t_s - half_s, side="left")
    high = np.searchsorted(t_s, t_s + half_s, side="right")
    return (total[high] - total[low]) / (high - low)


def wind_rmse_and_nees(
    truth: dict[str, np.ndarray],
    takeoff_s: float | None,
    landed_s: float | None,
    wind_estimates: list[dict[str, Any]],
) -> tuple[float | None, float | None]:
    """Return wind vector RMSE (m/s) and mean normalised error squared (2 is ideal), or None.

    `wind_estimates`: rows with t_s, to_n_mps, to_e_mps (wind to-vector) and the covariance
    nn_m2ps2, ne_m2ps2, ee_m2ps2.
    """
    if takeoff_s is None or not wind_estimates:
        return None, None
    t = truth["t_s"]
    last = landed_s if landed_s is not None else float(t[-1])
    rows = [r for r in wind_estimates if takeoff_s + WIND_SETTLING_S <= r["t_s"] <= last]
    if not rows:
        return None, None
    at = np.array([r["t_s"] for r in rows])
    mean_n = np.interp(at, t, centred_moving_mean(t, truth["wind_to_n_mps"], WIND_WINDOW_S))
    mean_e = np.interp(at, t, centred_moving_mean(t, truth["wind_to_e_mps"], WIND_WINDOW_S))
    to_ne = np.array([(r["to_n_mps"], r["to_e_mps"]) for r in rows])
    err = to_ne - np.stack([mean_n, mean_e], 1)
    nn, ne, ee = np.array([(r["nn_m2ps2"], r["ne_m2ps2"], r["ee_m2ps2"]) for r in rows]).T
    cov = np.moveaxis(np.array([[nn, ne], [ne, ee]]), -1, 0)
    nees = np.einsum("ki,kij,kj->k", err, np.linalg.inv(cov), err)
    return float(np.sqrt(np.mean(np.sum(err**2, axis=1)))), float(np.mean(nees))


@dataclass(frozen=True, slots=True)
class NearestGround:
    """Minimum true height above ground and its position (m from the depot)."""

    clearance_m: float
    north_m: float
    east_m: float

    @property
    def rounded_position_for_json(self) -> dict[str, float]:
        """Position in the format of a flight's JSON."""
        return {"north_m": round(self.north_m, 1), "east_m": round(self.east_m, 1)}


def find_minimum_clearance_away_from_sites(
    record: TruthRecord, terrain: Terrain, excluded_sites_ne_m: list[tuple[float, float]]
) -> NearestGround | None:
    """Return the minimum clearance outside the sites for low flight; None without such a sample.

    The clearance is 0 for a vehicle on the ground outside these sites.
    """
    truth = record.samples_by_column()
    columns = (truth[name] for name in ("north_m", "east_m", "down_m", "airborne"))
    nearest: NearestGround | None = None
    has_launched = False
    for north_m, east_m, down_m, airborne in zip(*columns, strict=True):
        has_launched = has_launched or bool(airborne)
        if not has_launched or any(
            math.dist((north_m, east_m), low) <= VERTICAL_FLIGHT_RADIUS_M
            for low in excluded_sites_ne_m
        ):
            continue
        over_m = max(
            float(-down_m) - terrain.height_above_depot_m(float(north_m), float(east_m)), 0.0
        )
        if nearest is None or over_m < nearest.clearance_m:
            nearest = NearestGround(over_m, float(north_m), float(east_m))
    return nearest
