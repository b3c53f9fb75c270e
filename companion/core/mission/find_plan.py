"""Planning as background work: the pilot requests a plan and receives it as an event.

Duration depends on the site: milliseconds in the open, seconds among many towers.
"""

from dataclasses import dataclass
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.mission.actions import Action
from companion.core.mission.events import Event
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan, build_site_map, make_plan
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief


@dataclass(frozen=True, slots=True)
class FindPlan(Action):
    """Plan this flight; a `PlanFound` with the same number returns the result.

    It shares no mutable state with the pilot, so any thread may run it. `energy` None: no energy
    limit. `centre_on_vehicle` and `include_setpoint_items`: see `build_site_map` and `make_plan`.
    """

    request_number: int
    flight: Flight
    airframe: Airframe
    frame: LocalFrame
    obstacles: dict[str, Any] | None
    density_kgpm3: float
    energy: EnergyBelief | None
    reserve_frac: float
    centre_on_vehicle: bool
    include_setpoint_items: bool

    def compute_plan(self) -> FlightPlan | NoRoute:
        """Return the plan or the reason for having none, such as an error in the site file."""
        mission = self.flight.mission
        planner = BerPlanner(RouteEnergy.for_mission(self.airframe, mission, self.density_kgpm3))
        try:
            site = build_site_map(
                self.flight, self.frame, self.obstacles, centre_on_vehicle=self.centre_on_vehicle
            )
            return make_plan(
                self.flight,
                site,
                planner,
                self.energy,
                self.reserve_frac,
                include_setpoint_items=self.include_setpoint_items,
            )
        except LeewayError as error:
            return NoRoute(str(error))


@dataclass(frozen=True, slots=True)
class PlanFound(Event):
    """Result of the `FindPlan` with this number."""

    request_number: int
    plan: FlightPlan | NoRoute
