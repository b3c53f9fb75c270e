"""Turn limit of an airframe that a level path must respect."""

import math
from dataclasses import dataclass

from companion.core.vehicle.power import GRAVITY_MPS2


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """Airspeed of the path, which exceeds the wind speed, and its turn radius IN THE AIR."""

    airspeed_mps: float
    turn_radius_m: float

    @classmethod
    def from_bank(cls, airspeed_mps: float, bank_rad: float) -> "FlightLimits":
        """Limits from a bank limit, `R = V^2 / (g tan bank)`."""
        return cls(airspeed_mps, airspeed_mps**2 / (GRAVITY_MPS2 * math.tan(bank_rad)))

    @property
    def turn_rate_rps(self) -> float:
        """Rate of change of the air heading in a level turn (rad/s)."""
        return self.airspeed_mps / self.turn_radius_m
