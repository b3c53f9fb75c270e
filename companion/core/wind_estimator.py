"""Row 5: a Kalman filter for the horizontal wind where the vehicle is.

State: wind to N, E; tilt trim along body forward and right; the common drag gain. (Details are
with the class.) `belief()` carries an honest floor for what the drag model does not know.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.airframe import Airframe

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WindObservation:
    """What telemetry says at one instant; None is unknown and never enters the filter.

    `airspeed_mps` only from a real pitot on the forward axis (or `airspeed_is_magnitude`), and
    `autopilot_wind_to_ne_mps` only when the flavour's adapter knows it to be a real estimate.
    """

    t_s: float
    airborne: bool
    mass_kg: float
    vel_ned_mps: tuple[float, float, float] | None = None
    roll_rad: float | None = None
    pitch_rad: float | None = None
    yaw_rad: float | None = None
    airspeed_mps: float | None = None
    airspeed_is_magnitude: bool = False
    autopilot_wind_to_ne_mps: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class WindBelief:
    """Mean and covariance of the horizontal wind (10 s mean at the vehicle), where it moves to.

    `sources` names what entered lately, of "tilt", "pitot", "autopilot". `valid` is False until
    enough has entered, and again when nothing entered for long.
    """

    t_s: float
    mean_to_ne_mps: FloatArray
    cov_ne_m2ps2: FloatArray
    sources: tuple[str, ...]
    valid: bool


class WindEstimator:
    """Holds the filter's state; one per vehicle."""

    def __init__(self, airframe: Airframe) -> None:
        raise NotImplementedError

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Take one observation (10 Hz or so); returns what was left out and why, in words.

        Late or repeated times are ignored. Raises ValueError on NaN or infinity.
        """
        raise NotImplementedError

    def belief(self, t_s: float) -> WindBelief:
        """The wind at `t_s` >= the last update; waiting only makes it less certain."""
        raise NotImplementedError
