"""Turn and climb limits of an airframe, as a path has to keep them."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.power import GRAVITY_MPS2


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """Airspeed of the path, the radius of its turns IN THE AIR, and how steep it may be there.

    `climb_rad` and `descent_rad` are the largest flight-path angles in the air frame, both
    positive.
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
        """The coordinated turn at a bank limit: `R = V^2 / (g tan bank)`."""
        if not 0.0 < bank_rad < math.pi / 2:
            raise LeewayError(f"bank limit {bank_rad!r} rad: expected between 0 and 90 degrees")
        return cls(airspeed_mps, turn_radius_m(airspeed_mps, bank_rad), climb_rad, descent_rad)

    @property
    def turn_rate_rps(self) -> float:
        """How fast the air heading changes in a level turn."""
        return self.airspeed_mps / self.turn_radius_m


def turn_radius_m(airspeed_mps: float, bank_rad: float) -> float:
    """`R = V^2 / (g tan bank)`: a level, coordinated turn."""
    return airspeed_mps**2 / (GRAVITY_MPS2 * math.tan(bank_rad))


def require_air_faster(airspeed_mps: float, wind_to_ne_mps: Floats) -> None:
    """Refuse wind that blows as fast as the vehicle flies, or that is not a number."""
    speed = np.hypot(wind_to_ne_mps[..., 0], wind_to_ne_mps[..., 1])
    worst = float(np.max(speed, initial=0.0)) if np.isfinite(speed).all() else math.nan
    if not worst < airspeed_mps:
        raise LeewayError(
            f"wind of {worst:.1f} m/s: expected less than the airspeed, {airspeed_mps:.1f} m/s,"
            " or goals upwind are out of reach"
        )
