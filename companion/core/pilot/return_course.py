"""Monitors of the position in flight: its loss, and the return route that the vehicle reports.

At a lost position no order is sent. Both autopilots descend on their own at their position once
their estimator gives up (ArduCopter's EKF failsafe, PX4's descend), and a companion without a
position cannot improve on that: it reports the search area to the operator.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.geo import Ned, horizontal_distance_m
from companion.core.mission.alerts import Alert
from companion.core.mission.events import Mode, Position
from companion.core.mission.jump_watch import CourseMonitor, LegMonitor
from companion.core.pilot.context import FlightContext, LatestAssessment
from companion.core.pilot.flight_state import CurrentItem
from companion.core.pilot.telemetry_state import PROGRESS_MAX_AGE_S
from companion.core.vehicle.wind_triangle import airspeeds_along_path_mps

MIN_LOSS_S = 1.5
"""A shorter loss is one late message."""

MIN_COURSE_DISTANCE_M = 10.0
"""Minimum distance to the target at which the course is evaluated."""

STATIONARY_MPS, STATIONARY_S = 1.0, 20.0
"""Slower for this long on the return route excludes turns and braking. The vehicle is idle:
ArduCopter does not restart a completed mission, although it accepts the jump and reports the item.
"""

MIN_HEADROOM_MPS = 6.0
"""With a smaller remaining speed against the wind at full tilt the vehicle may hover or drift and
still follow its route: the limit includes gusts and an autopilot's lower tilt. A vehicle that moves
away faster than this is not drifting."""


@dataclass(slots=True)
class PositionLossMonitor:
    """Start of the doubt, start of the loss, and the last good position."""

    _assessment: LatestAssessment
    doubtful_since_s: float | None = None
    lost_since_s: float | None = None
    last_good_position: Position | None = None

    @property
    def is_position_lost(self) -> bool:
        """Whether the doubt has lasted longer than one late message."""
        return self.lost_since_s is not None

    def last_good_position_text(self) -> str:
        """Return the last good position as text."""
        good = self.last_good_position
        return "never seen" if good is None else f"last at {good.lat_deg:.5f} {good.lon_deg:.5f}"

    def tick(self, context: FlightContext) -> None:
        """Monitor the position in flight, also during a pilot's control."""
        t_s = context.t_s
        troubles = context.telemetry.position_faults()
        if not troubles:
            self._record_good_position(context)
            return
        if self.doubtful_since_s is None:
            self.doubtful_since_s = t_s
        if self.lost_since_s is None and t_s - self.doubtful_since_s >= MIN_LOSS_S:
            self.lost_since_s = self.doubtful_since_s
            self._assessment.discard()  # from there it is no longer valid
            context.report_alert(Alert.POSITION_LOST, reason=troubles[0])
            context.record_decision(
                "position_lost", f"{'; '.join(troubles)}; {self.last_good_position_text()}"
            )
        state = context.telemetry.state
        if self.lost_since_s is not None and state is not None and state.mode is Mode.LAND:
            context.report_alert_once(
                Alert.DESCENDING_BLIND, last_position=self.last_good_position_text()
            )

    def _record_good_position(self, context: FlightContext) -> None:
        self.doubtful_since_s, self.last_good_position = None, context.telemetry.position
        if self.lost_since_s is not None:
            lost_s = context.t_s - self.lost_since_s
            self.lost_since_s = None
            context.report_alert(Alert.POSITION_BACK, duration_s=lost_s)
            context.record_decision("position_back", f"after {lost_s:.0f} s")


@dataclass(slots=True, eq=False)
class ReturnCourseMonitor:
    """Detects a missed item, a flight away from the return route, and a hover on it.

    The course check starts with a confirmed jump to the return route and ends near its target or
    with its finding. The leg check covers each item from its first report on, and restarts when
    the item is ordered again.
    """

    _item: CurrentItem
    _course: CourseMonitor | None = None
    _leg: LegMonitor | None = None
    """Monitors the current item on the return route."""
    _step_count: int = 0
    """Steps of the position before the checks began: none is evaluated across a step."""
    _last_motion_s: float = 0.0
    """Time of the last motion on the return route."""

    def start_course_check(self, context: FlightContext) -> None:
        """Check the course to the current item, after a jump to the return route."""
        flown, position = context.flight_plan, context.telemetry.position
        target = self._item.position_ned_m(context)
        if flown is not None and position is not None and target is not None:
            away_m = horizontal_distance_m(flown.position_to_ned_m(position), target)
            self._course = CourseMonitor(context.t_s, away_m)
            self._step_count = context.telemetry.position_watch.step_count

    def restart_leg_check(self) -> None:
        """Restart the check of the current item."""
        self._leg = None

    def restart_checks_after_detour(self, t_s: float) -> None:
        """Restart the check of the current item, and the course check if it is active."""
        self._leg = None
        if self._course is not None:
            self._course = CourseMonitor(t_s, math.inf)

    def update_and_get_item_after_overshoot(
        self, context: FlightContext, position_ned_m: Ned
    ) -> int | None:
        """Return the next item with a clear straight line if the current one was missed."""
        flown = context.flight_plan
        target = self._item.position_ned_m(context)
        leg = self._update_leg_monitor(context)
        if flown is None or target is None or leg is None:
            return None
        leg.record_distance_and_closing_speed(
            context.t_s,
            horizontal_distance_m(position_ned_m, target),
            _closing_speed_mps(context, position_ned_m, target),
        )
        if not leg.has_overshot_item(context.t_s) or _is_course_inconclusive_in_wind(
            context, position_ned_m, target
        ):
            return None
        overshot_item = flown.mission.resolve_setpoint_item_target(leg.index)
        next_item = flown.next_return_item_with_clear_line(overshot_item, position_ned_m)
        if next_item is None:
            return None
        label, onward = (flown.mission.items[index].label for index in (overshot_item, next_item))
        context.record_decision("waypoint_missed", f"{label} passed but not reached: to {onward}")
        context.report_alert(Alert.LEG_MISSED, label=label, next_label=onward)
        return next_item

    def update_and_check_off_return_route(
        self, context: FlightContext, position_ned_m: Ned
    ) -> bool:
        """Return whether it flies away from the return route; the course check then ends."""
        target = self._item.position_ned_m(context)
        if target is None:
            return False
        leg = self._update_leg_monitor(context)
        flown_past = leg is not None and leg.has_flown_far_past_item()
        off_course = self._update_and_check_off_course(context, position_ned_m, target)
        if not (flown_past or off_course) or _is_course_inconclusive_in_wind(
            context, position_ned_m, target
        ):
            return False
        if not flown_past:
            self._course = None
        return True

    def update_and_check_stationary(self, context: FlightContext, position_ned_m: Ned) -> bool:
        """Return whether it hovers on the return route for long, at any item."""
        vehicle, target = context.telemetry.state, self._item.position_ned_m(context)
        is_hovering = (
            context.telemetry.speed_3d_mps() <= STATIONARY_MPS
            and vehicle is not None
            and vehicle.mode is Mode.MISSION
            and not context.telemetry.position_faults()
            and not (
                target is not None
                and _is_course_inconclusive_in_wind(context, position_ned_m, target)
            )
        )
        if not is_hovering:
            self._last_motion_s = context.t_s
        stood_s = min(context.time_in_phase_s, context.seconds_since(self._last_motion_s))
        return stood_s > STATIONARY_S

    def restart_standstill_timer(self, t_s: float) -> None:
        """Restart the timer of a hover."""
        self._last_motion_s = t_s

    def _update_leg_monitor(self, context: FlightContext) -> LegMonitor | None:
        """Return the monitor of the current item; None if it cannot be evaluated now."""
        index, telemetry = self._item.index, context.telemetry
        if index is None or telemetry.state is None or telemetry.state.mode is not Mode.MISSION:
            self._leg = None
            return None
        if self._leg is None or self._leg.index != index:
            self._leg = LegMonitor(index)
            self._step_count = telemetry.position_watch.step_count
        is_reported = telemetry.is_recent(telemetry.progress, PROGRESS_MAX_AGE_S)
        has_stepped = self._step_count != telemetry.position_watch.step_count
        if has_stepped:
            self._course = None
        if not is_reported or has_stepped or telemetry.position_faults():
            self._leg.suspend_check()
            return None
        return self._leg

    def _update_and_check_off_course(
        self, context: FlightContext, position_ned_m: Ned, target_ned_m: Ned
    ) -> bool:
        if self._course is None:
            return False
        away_m = horizontal_distance_m(position_ned_m, target_ned_m)
        if away_m < MIN_COURSE_DISTANCE_M:
            self._course = None
            return False
        return self._course.update_and_check_off_course(
            context.t_s, away_m, _closing_speed_mps(context, position_ned_m, target_ned_m)
        )


def _direction_ne(position_ned_m: Ned, target_ned_m: Ned) -> tuple[float, float] | None:
    """Return the horizontal unit vector to the target; None at the target."""
    away_m = horizontal_distance_m(position_ned_m, target_ned_m)
    if away_m == 0.0:
        return None
    north_m, east_m = target_ned_m[0] - position_ned_m[0], target_ned_m[1] - position_ned_m[1]
    return north_m / away_m, east_m / away_m


def _closing_speed_mps(context: FlightContext, position_ned_m: Ned, target_ned_m: Ned) -> float:
    """Return the closing speed to a position (m/s); negative when opening."""
    position, direction = context.telemetry.position, _direction_ne(position_ned_m, target_ned_m)
    if position is None or direction is None:
        return 0.0
    return position.vel_n_mps * direction[0] + position.vel_e_mps * direction[1]


def _is_course_inconclusive_in_wind(
    context: FlightContext, position_ned_m: Ned, target_ned_m: Ned
) -> bool:
    """Return whether the wind leaves so little speed that the course is inconclusive.

    It would hold an RTL too, which ends at a position that is not promised.
    """
    estimates, direction = context.estimates, _direction_ne(position_ned_m, target_ned_m)
    if estimates.wind is None or not estimates.wind.valid or direction is None:
        return False
    north, east = direction
    to_north, to_east = (float(x) for x in estimates.wind.mean_to_ne_mps)
    tailwind_mps = to_north * north + to_east * east
    crosswind_mps = to_east * north - to_north * east
    top_mps = estimates.route_energy.level_airspeed_at_max_tilt_mps(estimates.payload_kg)
    left_mps = float(airspeeds_along_path_mps(top_mps, np.array([crosswind_mps]))[0]) + tailwind_mps
    drifts = (
        _closing_speed_mps(context, position_ned_m, target_ned_m)
        > min(left_mps, 0.0) - MIN_HEADROOM_MPS
    )
    return left_mps < MIN_HEADROOM_MPS and drifts
