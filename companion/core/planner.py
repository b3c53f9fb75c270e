"""Row 6, first form: BER behind a small protocol. Route out, route back, checked by ReturnOK."""

from dataclasses import dataclass
from typing import Protocol

from companion.core.energy_ledger import EnergyBelief
from companion.core.geo import Ned
from companion.core.graph import SiteMap
from companion.core.wind_outlook import WindForecast


@dataclass(frozen=True, slots=True)
class RallyWay:
    """A rally point's ground point and where it can be flown to in a straight, clear line from:
    indices into `Plan.outbound_ned_m` and `Plan.return_ned_m`.
    """

    name: str
    ground_ned_m: Ned
    from_outbound: tuple[int, ...]
    from_return: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """Waypoints of the dead man's mission, all at cruise height (down = -cruise height).

    `outbound_ned_m[0]` is the first waypoint after the one over the depot; the last is over the
    customer. `return_ned_m` starts with the first waypoint after the customer and ends over the
    depot. From `outbound_ned_m[i]` the way home enters at `return_ned_m[entry[i]]`, in a straight
    clear line. `home_ground_speed_mps` is what the mission aboard flies on the way home when no
    further command arrives.
    """

    depot_ned_m: Ned
    customer_ned_m: Ned
    outbound_ned_m: tuple[Ned, ...]
    return_ned_m: tuple[Ned, ...]
    entry: tuple[int, ...]
    rally: tuple[RallyWay, ...]
    home_ground_speed_mps: float
    energy_wh: float
    time_s: float
    route_std_wh: float


@dataclass(frozen=True, slots=True)
class NoRoute:
    """No plan; `reason` in words for the operator."""

    reason: str


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """What a planner needs to know. `forecast` None: no wind known yet (before take-off)."""

    site: SiteMap
    cruise_height_m: float
    drop_height_m: float
    leg_length_m: float
    payload_kg: float
    wind_settle_s: float
    drop_s: float
    energy: EnergyBelief | None
    reserve_frac: float
    forecast: WindForecast | None = None


class Planner(Protocol):
    """Anything that finds a way out and back."""

    def plan(self, request: PlanRequest) -> Plan | NoRoute:
        """A plan that passes ReturnOK in the wind as believed, or why there is none."""
        ...
