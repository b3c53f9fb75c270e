"""Progress of the autopilot in the mission: monitored jumps, and the ground speed of each leg.

A jump is confirmed by telemetry only (jump_watch.py): it is repeated, then abandoned.
"""

import math
from dataclasses import dataclass, field

from companion.core.base.geo import horizontal_distance_m
from companion.core.mission.actions import JumpTo, LogNote, SetGroundSpeed
from companion.core.mission.alerts import Alert
from companion.core.mission.events import (
    Event,
    MissionProgress,
    MissionState,
    Mode,
    OrderRefused,
    VehicleState,
)
from companion.core.mission.jump_watch import (
    MAX_REPORT_DELAY_S,
    JumpMonitor,
    JumpStatus,
    JumpType,
)
from companion.core.mission.mission_items import ReturnByDefaultMission
from companion.core.pilot.context import FlightContext
from companion.core.pilot.flight_state import (
    CurrentItem,
    OnboardListState,
    PromisedStop,
    ReturnState,
)
from companion.core.pilot.return_course import ReturnCourseMonitor
from companion.core.pilot.telemetry_state import PROGRESS_MAX_AGE_S
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger

STOPPED_STATES = (MissionState.COMPLETE, MissionState.NOT_STARTED)
"""States of ArduCopter's mission in AUTO in which a jump alone does not move the vehicle."""

MIN_MOVE_REPORTS = 2
"""Number of consecutive messages that confirm a move by another station."""

SPEED_STEP_MPS = 0.5
SPEED_STEP_FRAC = 0.05
SPEED_INTERVAL_S = 5.0
SPEED_RETRY_S = 1.0
MIN_TARGET_DISTANCE_M = 30.0


@dataclass(frozen=True, slots=True)
class UnexpectedItem:
    """An item that another station moved the mission to, and its number of consecutive reports."""

    index: int
    reports: int


@dataclass(slots=True)
class ProgressState:
    """The monitored jump, the last confirmed one, and an unexpected item."""

    jump: JumpMonitor | None = None
    confirmed_jump: JumpMonitor | None = None
    """The latest jump confirmed by telemetry, and its time."""
    confirmed_s: float = 0.0
    reports: tuple[MissionProgress, ...] = ()
    """Reports of the last second."""
    unexpected_item: UnexpectedItem | None = None


@dataclass(slots=True, eq=False)
class MissionProgressMonitor:
    """Follows the onboard mission by the reported items, and orders jumps.

    A jump is pending from its order until a report confirms it, it is abandoned, control is
    released, or the flight is resumed. At most one is pending; a new order replaces it. While one
    is pending, only reports of items that the autopilot may still fly on its own are expected.
    """

    _item: CurrentItem
    _course: ReturnCourseMonitor
    _gate: ReturnState
    _promise: PromisedStop
    _aboard: OnboardListState
    _state: ProgressState = field(default_factory=ProgressState)

    @property
    def pending_jump_item_index(self) -> int | None:
        """Target item of a jump that telemetry has not confirmed yet."""
        return None if self._state.jump is None else self._state.jump.index

    @property
    def destination_item_index(self) -> int | None:
        """Target item of a pending jump, otherwise the current item."""
        return self._item.index if self._state.jump is None else self._state.jump.index

    @property
    def jump_ordered_s(self) -> float:
        """Time of the latest jump, pending or confirmed; -inf without one."""
        jumps = (self._state.jump, self._state.confirmed_jump)
        return max((j.first_ordered_s for j in jumps if j is not None), default=-math.inf)

    @property
    def is_jumping_home(self) -> bool:
        """Whether a jump home is pending."""
        return self._state.jump is not None and self._state.jump.jump_type is JumpType.HOME

    # --- orders ----------------------------------------------------------------------------------

    def order_jump(self, context: FlightContext, item_index: int, jump_type: JumpType) -> None:
        """Order a jump to this item, and monitor it."""
        state, current_index = self._state, self._item.index
        recent = {r.index for r in state.reports if context.t_s - r.t_s <= MAX_REPORT_DELAY_S}
        replaced = (state.jump.index, *state.jump.previous_items) if state.jump is not None else ()
        before = {at for at in (*recent, *replaced, current_index) if at is not None}
        if (
            current_index == item_index
        ):  # it flies there already: indistinguishable from a confirmation
            before.discard(item_index)
        state.jump = JumpMonitor(item_index, jump_type, context.t_s, frozenset(before))
        self._course.restart_leg_check()
        observed = context.telemetry.observed  # after one report of the end the tick may send it
        if observed.mission_state or observed.reported_state is not MissionState.COMPLETE:
            _queue_jump_order(context, state.jump)

    def stop_monitoring_jump(self) -> None:
        """Stop waiting for a jump."""
        self._state.jump = None

    def clear_for_resumption(self) -> None:
        """Clear the current item and the jumps; telemetry has to report the item again."""
        self._item.clear_index()
        self._course.restart_leg_check()
        self._state = ProgressState(reports=self._state.reports)

    # --- events and ticks ------------------------------------------------------------------------

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process the autopilot's current item, or its refusal of an order."""
        match event:
            case MissionProgress():
                self._update_from_progress(context, event)
                recent = (r for r in self._state.reports if event.t_s - r.t_s <= MAX_REPORT_DELAY_S)
                self._state.reports = (*recent, event)
            case OrderRefused():
                self._record_or_report_refusal(context, event)
            case _:
                return

    def suspend_on_unexpected_item(self, context: FlightContext) -> bool:
        """Return whether another station may have moved the mission; suspend after two reports.

        One message may be a late one from before the companion's jump: MISSION_CURRENT has no time.
        """
        state, telemetry = self._state, context.telemetry
        unexpected = state.unexpected_item
        if not telemetry.is_recent(telemetry.progress, PROGRESS_MAX_AGE_S):
            state.unexpected_item = None
            return False
        if unexpected is not None and unexpected.reports >= MIN_MOVE_REPORTS:
            state.unexpected_item = None
            reason = f"another station moved the mission to item {unexpected.index}"
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, reason)
        return unexpected is not None

    def tick(self, context: FlightContext) -> None:
        """Repeat a jump that telemetry does not confirm, or abandon it."""
        jump = self._state.jump
        if jump is None or self._aboard.is_unverified:
            return  # no item of a list in doubt
        match jump.update_retry_status(context.t_s):
            case JumpStatus.UNREPORTED:
                context.queue_actions(
                    LogNote(f"jump to item {jump.index} not repeated: item not reported")
                )
            case JumpStatus.REPEAT:
                context.queue_actions(
                    LogNote(f"jump to item {jump.index} not confirmed: repeating")
                )
                _queue_jump_order(context, jump)
            case JumpStatus.REFUSED:
                self._abandon_jump(context, jump)
            case _:
                return

    # --- inside ----------------------------------------------------------------------------------

    def _update_from_progress(self, context: FlightContext, event: MissionProgress) -> None:
        """Update the position in the mission from the reported item."""
        state, flown, current_index = self._state, context.flight_plan, self._item.index
        if context.phase not in FLIGHT_PHASES or flown is None or event.index is None:
            return
        mission, vehicle = flown.mission, context.telemetry.state
        if (
            event.in_mission is False
            and context.phase not in (Phase.LAND, Phase.LAST_RESORT)
            and vehicle is not None
            and vehicle.armed
        ):
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, "the autopilot left the mission")
            return
        if self._aboard.is_unverified:
            return  # its index may refer to another list
        if state.jump is not None:
            if state.jump.is_confirmed_by_report(mission, event.index, event.t_s):
                self._complete_confirmed_jump(context, state.jump, event.index)
            elif state.jump.record_if_intermediate_item(mission, event.index):
                state.jump.unchanged_s = event.t_s
                state.unexpected_item = None  # the jump is pending; the tick repeats or abandons it
            else:
                self._count_unexpected_item(event.index)
            return
        if context.phase is Phase.LAST_RESORT and not _is_mission_mode_or_unknown(vehicle):
            state.unexpected_item = None
            return  # RTL or a landing needs no item
        if self._is_report_possibly_before_jump(mission, event.index, event.t_s):
            return  # the current item is reported again within a second
        if event.index == current_index or context.phase is Phase.LAND:
            state.unexpected_item = None
            return
        if current_index is not None and not mission.is_item_reachable_without_jump(
            current_index, event.index
        ):
            self._count_unexpected_item(event.index)
            return
        state.unexpected_item = None
        self._item.set_index_and_advance_phase(context, event.index)

    def _count_unexpected_item(self, item_index: int) -> None:
        """Count the report; the tick evaluates it, as a silent link may hide progress."""
        before = self._state.unexpected_item
        reports = before.reports if before is not None and before.index == item_index else 0
        self._state.unexpected_item = UnexpectedItem(item_index, reports + 1)

    def _is_report_possibly_before_jump(
        self, mission: ReturnByDefaultMission, reported_item_index: int, reported_s: float
    ) -> bool:
        """Return whether this report may have been sent before the jump that was just executed."""
        state = self._state
        return (
            state.confirmed_jump is not None
            and reported_s - state.confirmed_s <= MAX_REPORT_DELAY_S
            and state.confirmed_jump.is_possibly_stale_item(mission, reported_item_index)
        )

    def _record_or_report_refusal(self, context: FlightContext, event: OrderRefused) -> None:
        """Process a refusal in flight: a refused jump is repeated at once."""
        jump = self._state.jump
        if jump is not None and event.order == f"jump to item {jump.index}":
            jump.refused = event.is_response
        elif context.phase in FLIGHT_PHASES:
            context.report_alert_once(
                Alert.COMMAND_REFUSED, command=event.order, reason=event.reason
            )

    def _complete_confirmed_jump(
        self, context: FlightContext, jump: JumpMonitor, reported_item_index: int
    ) -> None:
        state, flown = self._state, context.flight_plan
        assert flown is not None
        state.jump = state.unexpected_item = None
        state.confirmed_jump, state.confirmed_s = jump, context.t_s
        self._item.set_index(context, jump.index)
        if jump.jump_type is JumpType.ONWARD:
            self._item.enter_phase(context)
        else:
            self._course.start_course_check(context)
            context.queue_actions(LogNote(f"returning home by item {jump.index}"))
        if jump.jump_type is JumpType.OTHER_HOME:
            site = flown.other_landing_site_name_of_item(jump.index)
            self._gate.set_landing_site(site)
            context.apply_phase_trigger(
                Trigger.RETURN_STARTED if site is None else Trigger.RALLY_BOUND
            )
        if reported_item_index != jump.index:
            self._item.set_index_and_advance_phase(context, reported_item_index)

    def _abandon_jump(self, context: FlightContext, jump: JumpMonitor) -> None:
        """The autopilot does not execute this jump."""
        self._state.jump = None
        context.report_alert(Alert.JUMP_IGNORED, item=jump.index)
        text = f"jump to item {jump.index} not confirmed by telemetry"
        if jump.jump_type is JumpType.HOME:
            context.record_decision("way_home_refused", text)
            reason = "the jump home was not executed"
            context.apply_phase_trigger(Trigger.RETURN_REFUSED, reason)
            return
        if jump.jump_type is JumpType.OTHER_HOME:
            self._promise.set_requested_stop(context, None)
            context.record_decision("home_stays", text)
            return
        # Without clearance the onboard mission returns on its own.
        context.record_decision("onward_refused", text)
        self._gate.close_gate("the autopilot does not jump onward")
        progress = context.telemetry.progress
        if progress is not None and progress.index is not None:
            self._item.set_index_and_advance_phase(context, progress.index)


def _queue_jump_order(context: FlightContext, jump: JumpMonitor) -> None:
    flown = context.flight_plan
    others = frozenset[int]() if flown is None else jump.other_confirming_items(flown.mission)
    is_restart = is_mission_stopped(context)
    context.queue_actions(JumpTo(jump.index, others, is_restart=is_restart))


def is_mission_stopped(context: FlightContext) -> bool:
    """Return whether the mission mode is active but its mission is complete or stopped."""
    return context.telemetry.observed.mission_state in STOPPED_STATES


def _is_mission_mode_or_unknown(vehicle_state: VehicleState | None) -> bool:
    return vehicle_state is None or vehicle_state.mode is Mode.MISSION


@dataclass(slots=True, eq=False)
class GroundSpeedController:
    """Commands the ground speed of the leg to the current item; again when the wind changes."""

    _item: CurrentItem
    _progress: MissionProgressMonitor
    speed_mps: float | None = None
    """The commanded speed; `None` before the first command."""
    _checked_s: float | None = None
    _commanded_item: int | None = None

    def command_again(self) -> None:
        """Command the speed again."""
        self.speed_mps = None

    def tick(self, context: FlightContext) -> None:
        """Command the speed on a new leg, and after a change at intervals."""
        index, before_mps = self._item.index, self.speed_mps
        if (
            context.phase not in (Phase.OUTBOUND, Phase.RETURN, Phase.DIVERT)
            or self._progress.pending_jump_item_index is not None
        ):
            return
        new_leg = before_mps is None or self._commanded_item != index
        if not new_leg and context.seconds_since(self._checked_s) < SPEED_INTERVAL_S:
            return
        here, target = context.recent_position_ned_m(), self._item.position_ned_m(context)
        if here is None or target is None or context.telemetry.position_faults():
            return
        if horizontal_distance_m(here, target) < MIN_TARGET_DISTANCE_M:
            return
        speed_mps = context.estimates.ground_speed_to_command_mps(here, target)
        if speed_mps is None:
            return
        speed_mps = min(speed_mps, context.airframe.speeds.max_ground_mps)
        if not new_leg and before_mps is not None:
            step_mps = max(SPEED_STEP_MPS, SPEED_STEP_FRAC * before_mps)
            if abs(speed_mps - before_mps) < step_mps:
                self._checked_s = context.t_s - SPEED_INTERVAL_S + SPEED_RETRY_S
                return
        self.speed_mps, self._checked_s, self._commanded_item = speed_mps, context.t_s, index
        context.queue_actions(SetGroundSpeed(round(speed_mps, 2)))
