"""Operational volumes of planned sorties, for the planner and the desk's launch check."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from companion.core.base.geo import location_to_ground_ned_m
from companion.core.base.location import Location
from companion.core.mission.flight_plan import depot_frame
from ground_station.core.deconfliction.separation import OperationalVolume, launch_conflict_reason
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.feasibility.reach import SortieGeometry
from ground_station.core.planning.day_problem import obstacle_map
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop
from ground_station.core.schema.orders import Order, order_location


class Airspace:
    """The airspace of one day. Obstacle routes are the same as in the planner."""

    def __init__(self, data: DayData) -> None:
        self.frame = depot_frame(data.day.depot.location)
        self._orders = {order.id: order for order in data.orders}
        self._obstacles = obstacle_map(data)
        self._cruise_m = data.day.mission.cruise_height_m

    def sortie_geometry(
        self, order: Order, sortie: PlannedSortie, launch_and_landing_pads: Sequence[Location]
    ) -> SortieGeometry:
        """Return a planned sortie's route: launch pad, customer, landing pad."""
        start, end = (location_to_ground_ned_m(self.frame, pad) for pad in launch_and_landing_pads)
        customer = location_to_ground_ned_m(self.frame, order_location(order))
        points_ne_m = np.array([start, customer, end])[:, :2]
        routes = ObstacleRoutes(self._obstacles, points_ne_m, self._cruise_m)
        return SortieGeometry(
            order.mass_kg,
            start,
            customer,
            end,
            sortie.outbound_height_m - start[2],
            routes.waypoints_between(0, 1),
            routes.waypoints_between(1, 2),
        )

    def operational_volume(
        self, sortie: PlannedSortie, stop_by_id: Mapping[str, PlannedStop]
    ) -> OperationalVolume:
        """Return the operational volume of a sortie: all routes between pads and customer."""
        pads = [stop_by_id[id_].pads[sortie.vehicle] for id_ in (sortie.launch, sortie.home)]
        geometry = self.sortie_geometry(self._orders[sortie.order], sortie, pads)
        heights_m = [
            h - geometry.start[2] for h in (sortie.outbound_height_m, sortie.return_height_m)
        ]
        return OperationalVolume(
            sortie.vehicle,
            sortie.order,
            geometry.ground_ne_m,
            geometry.columns_ne_m,
            min(heights_m),
            max(heights_m),
            sortie.launch_s,
            sortie.land_s,
        )

    def launch_conflict(
        self,
        sortie: PlannedSortie,
        airborne_sorties: Iterable[PlannedSortie],
        stop_by_id: Mapping[str, PlannedStop],
    ) -> str | None:
        """Return the reason that this sortie must wait; None if it may launch.

        `airborne_sorties`: each airborne sortie with its promised home. A sortie with an unanswered
        request to move its home is listed twice, once per home. The desk also calls this with the
        new home, against all other airborne sorties, before it moves a home.
        """
        own_volume = self.operational_volume(sortie, stop_by_id)
        return launch_conflict_reason(
            own_volume, [self.operational_volume(other, stop_by_id) for other in airborne_sorties]
        )
