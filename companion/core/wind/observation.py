"""Input and output of the wind estimator: observations and estimates."""

import math
from dataclasses import dataclass, replace
from typing import Protocol

from companion.core.base.arrays import Floats
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3


@dataclass(frozen=True, slots=True)
class WindObservation:
    """Telemetry at one instant; unknown values are None and do not enter the filter.

    `airspeed_mps` only from a real pitot on the forward axis (or `airspeed_is_magnitude`);
    `airspeed_fr_mps` from a sensor with two axes: the vehicle's horizontal velocity through the
    air, along heading and right of it; `autopilot_wind_to_ne_mps` only if the autopilot's adapter
    identifies it as an estimate, with its variances and covariance (nn, ne, ee) if reported;
    `height_m` above the ground, for the size of the eddies; `density_kgpm3` of the air, which
    scales the drag; `attitude_t_s` of the attitude, if not `t_s`; `yaw_rate_rps` and
    `tilt_rates_rps` (roll, pitch) as reported; `armed`: watched for steps, also near the ground.
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
    tilt_rates_rps: tuple[float | None, float | None] = (None, None)
    armed: bool = False

    def raise_if_invalid(self) -> None:
        """Raise ValueError on NaN, infinity, no mass, no air, or an invalid covariance."""
        numbers = [self.t_s, self.mass_kg, self.density_kgpm3, *(self.vel_ned_mps or ())]
        numbers += [*(self.autopilot_wind_to_ne_mps or ()), *(self.airspeed_fr_mps or ())]
        numbers += [*(self.autopilot_wind_cov_m2ps2 or ())]
        optional = (self.roll_rad, self.pitch_rad, self.yaw_rad, self.airspeed_mps, self.height_m)
        numbers += [v for v in optional if v is not None]
        if not all(map(math.isfinite, numbers)) or min(self.mass_kg, self.density_kgpm3) <= 0.0:
            raise ValueError(
                f"wind observation: expected finite values, mass and density above 0: {self}"
            )
        if self.autopilot_wind_cov_m2ps2 is not None:
            nn, ne, ee = self.autopilot_wind_cov_m2ps2
            if nn < 0.0 or ee < 0.0 or ne * ne > nn * ee:
                raise ValueError(
                    f"wind observation: expected a positive definite covariance: {self}"
                )

    def with_attitude_corrected_by_trims(
        self, forward_rad: float, right_rad: float
    ) -> "WindObservation":
        """Return the observation with the attitude corrected by these trims, forward and right."""
        if self.roll_rad is None or self.pitch_rad is None:
            return self
        roll, pitch = self.roll_rad + right_rad, self.pitch_rad - forward_rad
        return replace(self, roll_rad=roll, pitch_rad=pitch)


@dataclass(frozen=True, slots=True)
class WindBelief:
    """Estimate of the horizontal wind (10 s mean at the vehicle), where it moves to.

    `sources` names the recent measurements, of "tilt", "pitot", "autopilot". `valid` is False until
    enough measurements have entered, and again after a long time without any.
    """

    t_s: float
    mean_to_ne_mps: Floats
    cov_ne_m2ps2: Floats
    sources: tuple[str, ...]
    valid: bool


class StepMessage(str):
    """Message about a step of the reports for the operator."""

    __slots__ = ()


class WindFilter(Protocol):
    """A wind estimator, constructed with an `Airframe`."""

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Process one observation; returns a message for each rejected measurement."""
        ...

    def belief(self, t_s: float) -> WindBelief:
        """Return the wind at `t_s` >= the last update."""
        ...


class CheckpointedWindFilter(WindFilter, Protocol):
    """A wind estimator of a flight, which a restarted companion continues."""

    def snapshot(self) -> dict[str, object]:
        """Return the contents of a checkpoint."""
        ...

    def restore(self, snapshot: dict[str, object]) -> None:
        """Restore a checkpoint; raises LeewayError if it is invalid."""
        ...
