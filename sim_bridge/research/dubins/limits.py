"""Turn and climb limits of an airframe that a path must respect."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.power import GRAVITY_MPS2


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """Airspeed of the path, its turn radius IN THE AIR, and its climb limits.

    `climb_rad` and `descent_rad` are the largest flight-path angles in the air frame, both
    positive. Raises LeewayError for a value out of range.
    """

    airspeed_mps: float
    turn_radius_m: float
    climb_rad: float = math.radians(15.0)
    descent_rad: float = math.radians(15.0)

    def __post_init__(self) -> None:
        for name in ("airspeed_mps", "turn_radius_m"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise LeewayError(f"{name} = {value!r}: expected more than 0")
        for name in ("climb_rad", "descent_rad"):
            value = getattr(self, name)
            if not 0.0 < value < math.pi / 2:
                raise LeewayError(f"{name} = {value!r}: expected between 0 and 90 degrees")

    @classmethod
    def from_bank(
        cls,
        airspeed_mps: float,
        bank_rad: float,
        climb_rad: float = math.radians(15.0),
        descent_rad: float = math.radians(15.0),
    ) -> "FlightLimits":
        """Limits from a bank limit: `R = V^2 / (g tan bank)`; raises LeewayError out of 0
        to 90 deg.
        """
        if not 0.0 < bank_rad < math.pi / 2:
            raise LeewayError(f"bank limit {bank_rad!r} rad: expected between 0 and 90 degrees")
        return cls(airspeed_mps, turn_radius_m(airspeed_mps, bank_rad), climb_rad, descent_rad)

    @property
    def turn_rate_rps(self) -> float:
        """Rate of change of the air heading in a level turn (rad/s)."""
        return self.airspeed_mps / self.turn_radius_m


def turn_radius_m(airspeed_mps: float, bank_rad: float) -> float:
    """Radius of a level, coordinated turn: `R = V^2 / (g tan bank)`."""
    return airspeed_mps**2 / (GRAVITY_MPS2 * math.tan(bank_rad))


def require_air_faster(airspeed_mps: float, wind_to_ne_mps: Floats) -> None:
    """Raise LeewayError for wind (..., 2) that is not below the airspeed, or not finite."""
    speed = np.hypot(wind_to_ne_mps[..., 0], wind_to_ne_mps[..., 1])
    worst = float(np.max(speed, initial=0.0)) if np.isfinite(speed).all() else math.nan
    if not worst < airspeed_mps:
        raise LeewayError(
            f"wind of {worst:.1f} m/s: expected less than the airspeed, {airspeed_mps:.1f} m/s,"
            " or goals upwind are out of reach"
        )
