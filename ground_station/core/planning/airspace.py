"""The operational volumes of planned sorties: for the planner, and for the desk's last check."""

from collections.abc import Iterable, Mapping

import numpy as np

from companion.core.base.geo import Ned, place_ned
from companion.core.mission.flight_plan import frame_at
from ground_station.core.deconfliction.separation import OperationalVolume, launch_conflict
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.planning.day_problem import obstacle_map
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop
from ground_station.core.schema.orders import place_of


class Airspace:
    """The airspace of one day. Routes around obstacles are laid as the planner lays them."""

    def __init__(self, data: DayData) -> None:
        self.frame = frame_at(data.day.depot.place)
        self._orders = {order.id: order for order in data.orders}
        self._obstacles = obstacle_map(data)
        self._cruise_m = data.day.mission.cruise_height_m

    def volume(self, sortie: PlannedSortie, stops: Mapping[str, PlannedStop]) -> OperationalVolume:
        """The operational volume of a sortie: all ways between its pads and its customer."""
        here, home = (
            place_ned(self.frame, stops[id_].pads[sortie.vehicle])
            for id_ in (sortie.launch, sortie.home)
        )
        customer = place_ned(self.frame, place_of(self._orders[sortie.order]))
        points = [here, customer, home]
        ways = ObstacleRoutes(self._obstacles, np.array(points)[:, :2], self._cruise_m)
        ground = [*map(_ne, points), *ways.via(0, 1), *ways.via(1, 2)]
        heights_m = [-here[2] + h for h in (sortie.outbound_height_m, sortie.return_height_m)]
        return OperationalVolume(
            sortie.vehicle,
            sortie.order,
            tuple(ground),
            tuple(_ne(point) for point in dict.fromkeys(points)),
            min(heights_m),
            max(heights_m),
            sortie.launch_s,
            sortie.land_s,
        )

    def launch_conflict(
        self,
        sortie: PlannedSortie,
        in_air_now: Iterable[PlannedSortie],
        stops: Mapping[str, PlannedStop],
    ) -> str | None:
        """The desk's last check: why this sortie must wait; None: it may go.

        `in_air_now`: each sortie with its promised home. One that was asked to move and has not
        answered is in it twice, once for each home. Before a home is moved the same is asked of
        the sortie with its new home, beside all others in the air.
        """
        mine = self.volume(sortie, stops)
        return launch_conflict(mine, [self.volume(other, stops) for other in in_air_now])


def _ne(point: Ned) -> tuple[float, float]:
    return point[0], point[1]
