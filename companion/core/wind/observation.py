"""Input and output of the wind estimator: observations and the belief."""

import math
from dataclasses import dataclass, replace
from typing import Protocol

from companion.core.base.arrays import Floats
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3


@dataclass(frozen=True, slots=True)
class WindObservation:
    """What telemetry says at one instant; None is unknown and never enters the filter.

    `airspeed_mps` only from a real pitot on the forward axis (or `airspeed_is_magnitude`);
    `airspeed_fr_mps` from a sensor with two axes: the vehicle's horizontal velocity through the
    air, along heading and right of it; `autopilot_wind_to_ne_mps` only when the autopilot's adapter
    knows it to be a real estimate, with its variances and covariance (nn, ne, ee) where it says;
    `height_m` above the ground, for the size of the eddies; `density_kgpm3` of the air, which drag
    goes with; `attitude_t_s` of the attitude, where it is not `t_s`; `yaw_rate_rps` as reported.
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
    autopilot_wind_cov_m2ps2: tuple[float, float, float] | None = None
    airspeed_fr_mps: tuple[float, float] | None = None
    height_m: float | None = None
    density_kgpm3: float = REFERENCE_DENSITY_KGPM3
    attitude_t_s: float | None = None
    yaw_rate_rps: float | None = None

    def refuse_nan(self) -> None:
        """Raise ValueError on NaN, infinity, no mass, no air, or a covariance that is none."""
        numbers = [self.t_s, self.mass_kg, self.density_kgpm3, *(self.vel_ned_mps or ())]
        numbers += [*(self.autopilot_wind_to_ne_mps or ()), *(self.airspeed_fr_mps or ())]
        numbers += [*(self.autopilot_wind_cov_m2ps2 or ())]
        optional = (self.roll_rad, self.pitch_rad, self.yaw_rad, self.airspeed_mps, self.height_m)
        numbers += [v for v in optional if v is not None]
        if not all(map(math.isfinite, numbers)) or min(self.mass_kg, self.density_kgpm3) <= 0.0:
            raise ValueError(f"wind observation with a number that is none: {self}")
        if self.autopilot_wind_cov_m2ps2 is not None:
            nn, ne, ee = self.autopilot_wind_cov_m2ps2
            if nn < 0.0 or ee < 0.0 or ne * ne > nn * ee:
                raise ValueError(f"wind observation with a covariance that is none: {self}")

    def levelled(self, forward_rad: float, right_rad: float) -> "WindObservation":
        """The same with the attitude leaned forward and right by these trims."""
        if self.roll_rad is None or self.pitch_rad is None:
            return self
        roll, pitch = self.roll_rad + right_rad, self.pitch_rad - forward_rad
        return replace(self, roll_rad=roll, pitch_rad=pitch)


@dataclass(frozen=True, slots=True)
class WindBelief:
    """Mean and covariance of the horizontal wind (10 s mean at the vehicle), where it moves to.

    `sources` names what entered lately, of "tilt", "pitot", "autopilot". `valid` is False until
    enough has entered, and again when nothing entered for long.
    """

    t_s: float
    mean_to_ne_mps: Floats
    cov_ne_m2ps2: Floats
    sources: tuple[str, ...]
    valid: bool


class WindFilter(Protocol):
    """A wind estimator: ours (`WindEstimator`), or another that a replay compares it with."""

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Take one observation; returns what was left out and why, in words."""
        ...

    def belief(self, t_s: float) -> WindBelief:
        """The wind at `t_s` >= the last update."""
        ...

    def snapshot(self) -> dict[str, object]:
        """What a checkpoint keeps."""
        ...

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint; raises LeewayError when it is not one."""
        ...
