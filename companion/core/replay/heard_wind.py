"""What the wind estimator hears along a recorded flight, and what it believes there."""

import math
from collections.abc import Iterator

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.replay.recorded_flight import FlightSamples
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.estimator import WindEstimator
from companion.core.wind.observation import WindObservation

LEAST_HEIGHT_M = 2.0
"""Below, the gate's estimator takes nothing in either."""


def heard(
    samples: FlightSamples, mass_kg: float, density_kgpm3: float, *, with_airspeed: bool = False
) -> Iterator[WindObservation]:
    """Velocity and attitude at each row; the airspeed as a magnitude where it is asked for."""
    s = samples
    for i, t_s in enumerate(s.t_s.tolist()):
        airspeed = float(s.airspeed_mps[i])
        velocity = (float(s.vel_n_mps[i]), float(s.vel_e_mps[i]), float(s.vel_d_mps[i]))
        yield WindObservation(
            t_s=t_s,
            airborne=bool(s.airborne[i] and s.height_rel_m[i] > LEAST_HEIGHT_M),
            mass_kg=mass_kg,
            vel_ned_mps=velocity if all(map(math.isfinite, velocity)) else None,
            roll_rad=_known(s.roll_rad[i]),
            pitch_rad=_known(s.pitch_rad[i]),
            yaw_rad=_known(s.yaw_rad[i]),
            airspeed_mps=airspeed if with_airspeed and math.isfinite(airspeed) else None,
            airspeed_is_magnitude=True,
            height_m=_known(s.height_rel_m[i]),
            density_kgpm3=density_kgpm3,
        )


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def believed_wind(
    samples: FlightSamples, airframe: Airframe, mass_kg: float, density_kgpm3: float, at_s: Floats
) -> Floats:
    """Where the air moves to, north and east (n, 2), as believed at these times, which rise.

    Still air where nothing has been heard yet, as a flight begins with.
    """
    estimator = WindEstimator(airframe)
    found = np.zeros((len(at_s), 2))
    row, last = 0, np.zeros(2)
    for seen in heard(samples, mass_kg, density_kgpm3):
        while row < len(at_s) and at_s[row] < seen.t_s:
            found[row] = last
            row += 1
        estimator.update(seen)
        last = estimator.belief(seen.t_s).mean_to_ne_mps
    found[row:] = last
    return found
