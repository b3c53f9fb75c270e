"""Safety rules 4 and 6: what the legs that are left cost, to the ground, as the autopilot flies.

A leg is what one mission item makes the autopilot do. Winds are (K, 2) or (K, legs, 2), north and
east, where the air moves to. Energies in Wh (see energy_ledger).
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from companion.core.airframe import Airframe
from companion.core.geo import Ned

FloatArray = NDArray[np.float64]


class LegKind(Enum):
    """What the vehicle does on a leg."""

    CLIMB = "climb"  # straight up over a point (take-off too)
    CRUISE = "cruise"  # along a straight line; climbs or sinks on it where heights differ
    DESCEND = "descend"  # straight down, still flying
    HOVER = "hover"  # waits `duration_s`: settle, drop, loiter
    LAND = "land"  # descends and touches down; ends with motors off


@dataclass(frozen=True, slots=True)
class Leg:
    """One leg. `ground_speed_mps` None: the companion commands the wind triangle's speed for
    `airspeed_mps` (None: the airframe's speed to fly); a number: that ground speed, no further
    command arrives.
    """

    kind: LegKind
    from_ned_m: Ned
    to_ned_m: Ned
    payload_kg: float
    duration_s: float = 0.0
    airspeed_mps: float | None = None
    ground_speed_mps: float | None = None


@dataclass(frozen=True, slots=True)
class LegCosts:
    """Energy (Wh) and time (s) of legs under K winds, each (K, legs); `feasible` likewise.

    An infeasible leg (no way made over the ground) has the cost of `STALL_TIME_S` of flight.
    """

    energy_wh: FloatArray
    time_s: FloatArray
    feasible: NDArray[np.bool_]


class RouteEnergy:
    """The airframe's leg costs from tables built once per payload; the one model that planner,
    gate and dispatcher share.
    """

    def __init__(
        self,
        airframe: Airframe,
        air_density_kgpm3: float = 1.225,
        cruise_airspeed_mps: float | None = None,
    ) -> None:
        raise NotImplementedError

    def costs(self, legs: tuple[Leg, ...], wind_to_ne_mps: FloatArray) -> LegCosts:
        """Cost of each leg under each wind."""
        raise NotImplementedError

    def gradient_wh_per_mps(self, legs: tuple[Leg, ...], wind_to_ne_mps: FloatArray) -> FloatArray:
        """dE/dw of each leg, (legs, 2), about one wind (2,)."""
        raise NotImplementedError

    def route_std_wh(
        self, legs: tuple[Leg, ...], wind_to_ne_mps: FloatArray, cov_ne_m2ps2: FloatArray
    ) -> float:
        """`|sum_e dE_e/dw|_Sigma`: one wind error moves every leg, so gradients add."""
        raise NotImplementedError

    def ground_speed_mps(self, leg: Leg, wind_to_ne_mps: FloatArray) -> float:
        """What to command on a cruise leg (DO_CHANGE_SPEED): the wind triangle's ground speed."""
        raise NotImplementedError

    def power_w(self, payload_kg: float, airspeed_mps: float, climb_mps: float = 0.0) -> float:
        """Electrical power in steady flight (the ledger's modelled power)."""
        raise NotImplementedError

    def hover_power_w(self, payload_kg: float) -> float:
        """Electrical power in still-air hover: tells a drop (safety rule 5)."""
        raise NotImplementedError
