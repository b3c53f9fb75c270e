"""Wind estimator input along a recorded flight, and the estimate of any filter."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from companion.analysis.replay.recorded_flight import FlightSamples
from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.observation import WindFilter, WindObservation

MIN_HEIGHT_M = 2.0
"""Below this height the wind estimator accepts no observations, as in flight."""


def wind_observations_from_samples(
    samples: FlightSamples, mass_kg: float, density_kgpm3: float, *, with_airspeed: bool = False
) -> Iterator[WindObservation]:
    """Yield velocity and attitude at each row; on request the airspeed as a magnitude."""
    s = samples
    for i, t_s in enumerate(s.t_s.tolist()):
        airspeed = float(s.airspeed_mps[i])
        velocity = (float(s.vel_n_mps[i]), float(s.vel_e_mps[i]), float(s.vel_d_mps[i]))
        yield WindObservation(
            t_s=t_s,
            airborne=bool(s.airborne[i] and s.height_rel_m[i] > MIN_HEIGHT_M),
            armed=bool(s.armed[i]),
            mass_kg=mass_kg,
            vel_ned_mps=velocity if all(map(math.isfinite, velocity)) else None,
            roll_rad=_finite_or_none(s.roll_rad[i]),
            pitch_rad=_finite_or_none(s.pitch_rad[i]),
            yaw_rad=_finite_or_none(s.yaw_rad[i]),
            airspeed_mps=airspeed if with_airspeed and math.isfinite(airspeed) else None,
            airspeed_is_magnitude=True,
            height_m=_finite_or_none(s.height_rel_m[i]),
            density_kgpm3=density_kgpm3,
        )


def _finite_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class FilteredWind:
    """Wind (n, 2) in the direction of air motion, and its covariance (n, 2, 2) if known."""

    mean_ne_mps: Floats
    cov_ne_m2ps2: Floats | None


def replay_filter(
    filter_factory: Callable[[Airframe], WindFilter],
    airframe: Airframe,
    observations: Iterable[WindObservation],
) -> FilteredWind:
    """Return the estimate of a filter constructed with this airframe, after each observation."""
    filter_ = filter_factory(airframe)
    means: list[Floats] = []
    covs: list[Floats] = []
    for seen in observations:
        filter_.update(seen)
        belief = filter_.belief(seen.t_s)
        means.append(belief.mean_to_ne_mps)
        covs.append(belief.cov_ne_m2ps2)
    return FilteredWind(np.array(means), np.array(covs))
