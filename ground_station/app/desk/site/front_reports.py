"""Reports of wind fronts to the dispatcher, with the flights in the path of each."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from companion.core.wind_field.fronts import FrontUpdate, FrontWithdrawn, WindFront
from ground_station.app.desk.site.launch_routes import LaunchRoutes
from ground_station.core.dispatch.wind_holds import may_be_hit_by_front
from ground_station.core.feasibility.flight_in_front import AirborneFlight, energy_margins_in_wind
from ground_station.core.feasibility.reach import DayFeasibility
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import AssignmentRow, AssignmentState
from ground_station.core.site_wind.wind_texts import format_front, format_withdrawal

POST_FRONT_WIND_STD_MPS = 2.0
"""Error of the wind behind a front on each axis, away from its observers: as a day's forecast."""


@dataclass(slots=True)
class FrontReports:
    """Reports each front once and re-evaluates the flights in its path."""

    data: DayData
    routes: LaunchRoutes
    log: Callable[[str], None]
    queue: list[FrontUpdate] = field(default_factory=list)
    _feasibility: DayFeasibility = field(init=False)

    def __post_init__(self) -> None:
        self._feasibility = DayFeasibility(self.data.day, self.data.airframes)

    def report_queued_fronts(
        self, rows: Iterable[AssignmentRow], status: FleetStatus, now_s: float
    ) -> None:
        """Report the waiting fronts; `rows`: the assignments in force."""
        while self.queue:
            front_event = self.queue[0]
            if isinstance(front_event, FrontWithdrawn):
                self.log(format_withdrawal(front_event))
            else:
                self._report_front(front_event, rows, status, now_s)
            self.queue.pop(0)

    def _report_front(
        self, front: WindFront, rows: Iterable[AssignmentRow], status: FleetStatus, now_s: float
    ) -> None:
        observers = {one.member for one in front.detections}
        positions_by_name = [
            (name, self.routes.position_ne_m(name, status)) for name in sorted(status.vehicles)
        ]
        positions = [("the depot", (0.0, 0.0))]
        positions += [
            (name, at) for name, at in positions_by_name if at is not None and name not in observers
        ]
        self.log(format_front(front, now_s, positions))
        post_front_wind = _post_front_wind(front)
        for row in rows:
            is_in_flight = row.state is AssignmentState.IN_FLIGHT
            if is_in_flight and may_be_hit_by_front(
                front, self.routes.planned_launch_of(row, status), now_s
            ):
                self._evaluate_and_log_flight(row, status, post_front_wind)

    def _evaluate_and_log_flight(
        self, row: AssignmentRow, status: FleetStatus, post_front_wind: Forecast
    ) -> None:
        state = status.status_of(row.vehicle).state
        drone = self.data.day.find_drone(row.vehicle)
        position = None if state is None else self.routes.position_ned_m(state)
        if state is None or drone is None or position is None or state.energy_left_wh is None:
            text = "in the front's path; energy or position unknown: consider a recall"
            self.log(f"WARNING: {row.vehicle}: {text}")
            return
        order = None if state.delivered else self.routes.orders.get(row.order_id)
        flight = AirborneFlight(
            position=position,
            home=self.routes.home_ned_m(row),
            customer=None if order is None else self.routes.customer_ned_m(row),
            payload_kg=0.0 if order is None else order.mass_kg,
            remaining_wh=state.energy_left_wh,
        )
        feasibility = self._feasibility.of_drone(drone)
        found = energy_margins_in_wind(feasibility, flight, post_front_wind)
        if found.operator_recommendation:
            self.log(
                f"WARNING: {row.vehicle}: in the front's path: {found.operator_recommendation}"
            )
        else:
            self.log(
                f"{row.vehicle}: in the front's path: {found.mission_margin_wh:.0f} Wh above"
                " the reserve in the wind behind it"
            )


def _post_front_wind(front: WindFront) -> Forecast:
    """Return the wind behind a front, as measured by the members that it has passed."""
    north, east = (
        sum(one.wind_ne_mps[k] for one in front.detections) / len(front.detections) for k in (0, 1)
    )
    from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
    speed_mps = min(math.hypot(north, east), 40.0)
    return Forecast(speed_mps=speed_mps, from_deg=from_deg, std_mps=POST_FRONT_WIND_STD_MPS)
