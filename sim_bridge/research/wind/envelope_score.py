"""The companion's wind estimator over the envelope, beside the bound."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.estimator import WindEstimator, WindObservation
from companion.core.wind.observation import WindFilter
from sim_bridge.research.wind.envelope_flight import SAMPLE_S, EnvelopeFlight

WARM_UP_S = 30.0
HALF_WINDOW_S = 5.0


@dataclass(frozen=True)
class Errors:
    """Of one flight, at the judged samples: times, error (n, 2), covariance (n, 2, 2)."""

    t_s: Floats
    error_ne_mps: Floats
    cov_ne_m2ps2: Floats

    @property
    def nees(self) -> Floats:
        """Normalised error squared at each sample."""
        inverse = np.linalg.inv(self.cov_ne_m2ps2)
        return np.einsum("ki,kij,kj->k", self.error_ne_mps, inverse, self.error_ne_mps)


def observations(flight: EnvelopeFlight, mass_kg: float) -> list[WindObservation]:
    """What a companion would hear on this flight.

    An autopilot's telemetry is a fused state: velocity and attitude of one instant. Here the
    velocity is the receiver's own, 0.12 s old, so it comes with the attitude of the sample before.
    """
    return [
        WindObservation(
            t_s=s.readings.t_s,
            airborne=-s.truth.pos_ned_m[2] > 2.0,
            mass_kg=mass_kg,
            vel_ned_mps=s.readings.vel_ned_mps,
            roll_rad=before.readings.roll_rad,
            pitch_rad=before.readings.pitch_rad,
            yaw_rad=before.readings.yaw_rad,
            airspeed_mps=s.readings.airspeed_mps,
            height_m=-s.readings.pos_ned_m[2],
        )
        for before, s in itertools.pairwise([flight.samples[0], *flight.samples])
    ]


def judged(
    flight: EnvelopeFlight,
    airframe: Airframe,
    make: Callable[[Airframe], WindFilter] = WindEstimator,
) -> Errors:
    """Fly an estimator along; errors against the centred 10 s mean, after the first 30 s of flight
    and up to 5 s before the end."""
    half = round(HALF_WINDOW_S / SAMPLE_S)
    total = np.vstack([np.zeros(2), np.cumsum(flight.wind_true_ne_mps, axis=0)])
    estimator = make(airframe)
    times, errors, covs = [], [], []
    took_off_s = flight.samples[0].truth.t_s
    for k, seen in enumerate(observations(flight, airframe.mass_kg(0.0))):
        estimator.update(seen)
        if seen.t_s < took_off_s + WARM_UP_S or k + half >= len(flight.samples):
            continue
        belief = estimator.belief(seen.t_s)
        mean = (total[k + half + 1] - total[k - half + 1]) / (2 * half)
        times.append(seen.t_s)
        errors.append(belief.mean_to_ne_mps - mean)
        covs.append(belief.cov_ne_m2ps2)
    return Errors(np.array(times), np.array(errors), np.array(covs))


def rmse_mps(flights: Sequence[Errors]) -> float:
    """Of the vector, over all flights."""
    return math.sqrt(float(np.mean([np.mean(np.sum(e.error_ne_mps**2, axis=1)) for e in flights])))


def nees_band95(flights: int) -> tuple[float, float]:
    """Where the mean over `flights` of a consistent 2-D filter's NEES lies at any one time, 95 %
    (chi-square of 2 degrees a flight; Bar-Shalom, Li, Kirubarajan 2001, 5.4.2)."""
    low, high = stats.chi2.ppf([0.025, 0.975], 2 * flights) / flights
    return float(low), float(high)
