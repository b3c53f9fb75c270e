"""Planning as work that is handed out: the pilot asks, goes on hearing, and is told what was found.

How long it takes depends on the site: milliseconds in the open, seconds among many towers.
"""

from dataclasses import dataclass
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.mission.actions import Action
from companion.core.mission.events import Event
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan, make_plan, site_map
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief


@dataclass(frozen=True, slots=True)
class FindPlan(Action):
    """Plan this flight; a `PlanFound` with its number brings what came of it.

    It shares nothing with the pilot that anybody changes, so that any thread may work on it.
    `energy` None: whatever it costs. `here` and `asides`: as `site_map` and `make_plan` have them.
    """

    number: int
    flight: Flight
    airframe: Airframe
    frame: LocalFrame
    obstacles: dict[str, Any] | None
    density_kgpm3: float
    energy: EnergyBelief | None
    reserve_frac: float
    here: bool
    asides: bool

    def work(self) -> FlightPlan | NoRoute:
        """The plan, or why there is none; what the site's file has wrong counts as that."""
        mission = self.flight.mission
        planner = BerPlanner(RouteEnergy.for_mission(self.airframe, mission, self.density_kgpm3))
        try:
            site = site_map(self.flight, self.frame, self.obstacles, here=self.here)
            return make_plan(
                self.flight, site, planner, self.energy, self.reserve_frac, asides=self.asides
            )
        except LeewayError as error:
            return NoRoute(str(error))


@dataclass(frozen=True, slots=True)
class PlanFound(Event):
    """What came of the `FindPlan` of this number."""

    number: int
    plan: FlightPlan | NoRoute
