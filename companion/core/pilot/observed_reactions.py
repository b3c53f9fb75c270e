"""Reactions to the observed state (observed_state.py): one alert and one reaction for each finding.

| finding | reaction |
| --- | --- |
| mission paused | a person's: control is released |
| mission complete in the air, at a landing item | by itself: return without the mission |
| mission complete in the air, elsewhere | a person's item selection: control is released |
| fall | reported; unless it recovers in the air, the flight did not come home |
| failsafe of the autopilot | reported; a mode change that follows is a takeover |
| standstill on the return route | one more jump to its item, then a return without the mission |
| heights differ | reported; the gate closes (`ReturnDecision`) |
"""

from dataclasses import dataclass

from companion.core.mission.alerts import Alert
from companion.core.mission.events import (
    Event,
    GnssFix,
    MissionProgress,
    MissionState,
    Position,
    VehicleState,
)
from companion.core.mission.jump_watch import JumpType
from companion.core.mission.mission_items import Part
from companion.core.pilot.context import (
    MAX_GROUND_HEIGHT_M,
    FlightContext,
    height_above_nearest_site_m,
)
from companion.core.pilot.flight_state import CurrentItem, OnboardListState
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.return_course import ReturnCourseMonitor
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger

RECOVERY_S, MAX_RECOVERED_SINK_MPS = 2.0, 1.0
"""A vehicle that keeps its height for so long, above the ground, has recovered from a fall."""

LANDING_PARTS = (Part.LAND, Part.RALLY_LAND, Part.END)


@dataclass(slots=True, eq=False)
class ObservedReactions:
    """Reports findings about the vehicle in flight, and reacts to them."""

    _item: CurrentItem
    _aboard: OnboardListState
    _course: ReturnCourseMonitor
    _progress: MissionProgressMonitor
    has_fallen: bool = False
    """It fell and did not recover in the air."""
    _jumped_again_item: int | None = None
    """Last item to which a vehicle that stood still was sent again."""

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process the telemetry of a vehicle in flight."""
        is_own_flight = context.phase in FLIGHT_PHASES
        if not is_own_flight and context.phase is not Phase.SUSPENDED:
            return
        match event:
            case MissionProgress() if is_own_flight and context.phase is not Phase.LAST_RESORT:
                self._react_to_mission_state(context)
            case Position():
                self._report_fall_or_recovery(context, event)
            case VehicleState() if event.failsafe and event.armed:
                context.report_alert_once(Alert.AUTOPILOT_FAILSAFE, mode=event.mode_name)
            case GnssFix() if context.telemetry.observed.height_conflict_text():
                limit_m = context.telemetry.observed.height_limit_m
                context.report_alert_once(Alert.HEIGHT_DOUBT, limit_m=limit_m)
            case _:
                return

    def _react_to_mission_state(self, context: FlightContext) -> None:
        """Release control after a pause or a selected end; return after an end by itself."""
        flown, state = context.flight_plan, context.telemetry.observed.mission_state
        if flown is None or not context.telemetry.airborne:
            return
        if state is MissionState.PAUSED:
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, "mission paused by a station")
        elif (
            state is MissionState.COMPLETE
            and not (self._aboard.is_unverified or self._aboard.restored)  # a changed mission's end
            and _height_m(context) > MAX_GROUND_HEIGHT_M
        ):
            index = self._item.index
            if index is None or flown.mission.part_of_item(index) not in LANDING_PARTS:
                context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, "mission ended by a station")
                return
            reason = "mission complete in the air"
            context.record_decision("way_home_refused", reason)
            context.apply_phase_trigger(Trigger.RETURN_REFUSED, reason)

    def jump_again_or_standstill_reason(self, context: FlightContext) -> str:
        """Jump to the item again, once; return why a return without the mission is due, or `""`.

        A person may have paused the mission. An autopilot that does not report its state keeps the
        pause until the energy requires the return.
        """
        state, item = context.telemetry.observed.mission_state, self._item.index
        assessment = context.recent_assessment()
        if state in (MissionState.COMPLETE, MissionState.NOT_STARTED) or item is None:
            return "stationary on the return route"
        if self._jumped_again_item != item:
            self._jumped_again_item, next_step = item, "jump again"
            self._course.restart_standstill_timer(context.t_s)
            self._progress.order_jump(context, item, JumpType.HOME)
        elif state is MissionState.ACTIVE or assessment is None:
            return "stationary on the return route"
        elif assessment.p_home < 1.0 - context.estimates.limits.max_loss:
            return "stationary on the return route, energy low"
        else:
            next_step = "paused?"
        context.report_alert_once(Alert.STANDSTILL, next_step=next_step)
        return ""

    def _report_fall_or_recovery(self, context: FlightContext, position: Position) -> None:
        fall_s = context.telemetry.observed.fall_s
        if fall_s == position.t_s and not self.has_fallen:
            self.has_fallen = True
            where = f"{position.lat_deg:.5f} {position.lon_deg:.5f}"
            context.report_alert(Alert.FALLING, where=where)
            context.record_decision("fall", f"at {where}, {position.vel_d_mps:.0f} m/s down")
        elif (
            self.has_fallen
            and context.seconds_since(fall_s) > RECOVERY_S
            and position.vel_d_mps < MAX_RECOVERED_SINK_MPS
            and _height_m(context) > MAX_GROUND_HEIGHT_M
        ):
            self.has_fallen = False
            context.record_decision("fall_over", "it keeps its height again")


def _height_m(context: FlightContext) -> float:
    """Return the height above the nearest landing position; 0 if unknown."""
    here = context.recent_position_ned_m()
    return 0.0 if here is None else height_above_nearest_site_m(context, here)
