"""Operational volumes of planned sorties, for the planner and the desk's launch check."""

from collections.abc import Iterable, Mapping

import numpy as np

from companion.core.base.geo import Ned, location_to_ground_ned_m
from companion.core.mission.flight_plan import depot_frame
from ground_station.core.deconfliction.separation import OperationalVolume, launch_conflict_reason
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.planning.day_problem import obstacle_map
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop
from ground_station.core.schema.orders import order_location


class Airspace:
    """The airspace of one day. Obstacle routes are the same as in the planner."""

    def __init__(self, data: DayData) -> None:
        self.frame = depot_frame(data.day.depot.location)
        self._orders = {order.id: order for order in data.orders}
        self._obstacles = obstacle_map(data)
        self._cruise_m = data.day.mission.cruise_height_m

    def operational_volume(
        self, sortie: PlannedSortie, stop_by_id: Mapping[str, PlannedStop]
    ) -> OperationalVolume:
        """Return the operational volume of a sortie: all routes between pads and customer."""
        here, home = (
            location_to_ground_ned_m(self.frame, stop_by_id[id_].pads[sortie.vehicle])
            for id_ in (sortie.launch, sortie.home)
        )
        customer = location_to_ground_ned_m(self.frame, order_location(self._orders[sortie.order]))
        points = [here, customer, home]
        routes = ObstacleRoutes(self._obstacles, np.array(points)[:, :2], self._cruise_m)
        ground = [
            *map(_north_east_m, points),
            *routes.waypoints_between(0, 1),
            *routes.waypoints_between(1, 2),
        ]
        heights_m = [-here[2] + h for h in (sortie.outbound_height_m, sortie.return_height_m)]
        return OperationalVolume(
            sortie.vehicle,
            sortie.order,
            tuple(ground),
            tuple(_north_east_m(point) for point in dict.fromkeys(points)),
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


def _north_east_m(point: Ned) -> tuple[float, float]:
    return point[0], point[1]
