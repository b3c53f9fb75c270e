"""State that several controllers of one flight read or change.

It is created before the controllers and passed to each that needs it, which avoids circular
references: mission progress reports a refused jump, which closes the gate; the return decision
orders jumps.
"""

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from companion.core.base.geo import Ned, horizontal_distance_m
from companion.core.mission.alerts import Alert
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.mission_items import Part
from companion.core.pilot.context import CurrentPlan, FlightContext
from companion.core.pilot.estimators.release_watch import ReleaseMonitor
from companion.core.pilot.telemetry_state import POSITION_MAX_AGE_S, PROGRESS_MAX_AGE_S
from companion.core.pilot.transitions import Phase, Trigger

LANDING_RADIUS_M, LANDING_MAX_SPEED_MPS = 5.0, 1.5
"""Closer and slower than this the vehicle descends at its site under any list."""

PART_TRIGGERS: dict[Part | None, Trigger] = {
    Part.TAKEOFF: Trigger.TELEMETRY_AVAILABLE,
    Part.SETTLE: Trigger.AT_HEIGHT,
    Part.OUTBOUND: Trigger.DEPARTURE_CLEARED,
    Part.DELIVER: Trigger.CUSTOMER_REACHED,
    Part.RELEASE: Trigger.DROP_REACHED,
    Part.RETURN: Trigger.RETURN_STARTED,
    Part.RALLY: Trigger.RALLY_BOUND,
    **dict.fromkeys((Part.LAND, Part.RALLY_LAND, Part.END), Trigger.LANDING),
}
"""Trigger of the phase in which a part of the mission is flown."""


@dataclass(slots=True)
class FlightState:
    """Whether the flight has started, and its wind measurement."""

    in_flight: bool = False
    takeoff_s: float | None = None
    wind_measurement_start_s: float | None = None
    """Start of the hover in which the wind is measured."""

    def record_takeoff(self, t_s: float) -> None:
        """Record the takeoff: armed in the mission."""
        self.in_flight = True
        self.takeoff_s = t_s

    def record_in_flight(self) -> None:
        """Record that the vehicle is already in flight."""
        self.in_flight = True

    def record_wind_measurement_start(self, t_s: float) -> None:
        """Record the arrival over the depot at height; only the first call counts."""
        if self.wind_measurement_start_s is None:
            self.wind_measurement_start_s = t_s

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"flying": self.in_flight, "took_off_s": self.takeoff_s}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore from a checkpoint; `record_in_flight` sets whether there is a flight."""
        self.takeoff_s = checkpoint.took_off_s


@dataclass(slots=True)
class ReturnState:
    """Reason that closed the gate, and the landing site that replaces the plan's own."""

    gate_closed_reason: str = ""
    landing_site: str | None = None

    def close_gate(self, reason: str) -> None:
        """Close the gate; the first reason is kept."""
        self.gate_closed_reason = self.gate_closed_reason or reason

    def replace_gate_reason(self, reason: str) -> None:
        """Close the gate for this reason, replacing any earlier one."""
        self.gate_closed_reason = reason

    def set_landing_site(self, site_name: str | None) -> None:
        """Set the landing site of the mission; `None`: the plan's own landing."""
        self.landing_site = site_name

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"gate_closed": self.gate_closed_reason, "rally": self.landing_site}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore from a checkpoint."""
        self.gate_closed_reason, self.landing_site = checkpoint.gate_closed, checkpoint.rally


@dataclass(slots=True)
class PromisedStop:
    """End of the uploaded mission without the companion, and the stop that the truck requests."""

    _plan: CurrentPlan
    reported_home: str | None = None
    """Set only on flights to a promised stop, once the autopilot flies there."""
    requested_stop: str | None = None
    """`None`: no change of the stop."""

    def current_home_stop_name(self, context: FlightContext) -> str | None:
        """Return the stop at which the flight ends without the companion; `None`: no stops."""
        return self.reported_home or context.flight.site.home

    def update_home_from_item(self, context: FlightContext, item_index: int) -> None:
        """Process the current item: report its landing site if it is another stop."""
        flown = context.flight_plan
        if flown is None or flown.plan.home is None:
            return
        part = flown.mission.part_of_item(item_index)
        if part is None or part is Part.END:
            return
        home = flown.landing_name_and_position_after_item(item_index)[0]
        before = self.current_home_stop_name(context)
        self.reported_home = home
        if home == before:
            return
        self.set_requested_stop(
            context, None if self.requested_stop == home else self.requested_stop
        )
        context.report_alert(Alert.LANDING_STOP_MOVED, site=home)
        context.record_decision(
            "home_moved", f"onboard mission ends at {home}, previously at {before}"
        )
        context.request_checkpoint()

    def set_requested_stop(self, context: FlightContext, stop_name: str | None) -> None:
        """Set the stop that the truck requests, or none: it and the present home may be chosen."""
        flown = context.flight_plan
        self.requested_stop = stop_name
        if flown is None or flown.plan.home is None:
            return
        plan = flown.plan.copy_with_selectable_stops(
            self.current_home_stop_name(context), stop_name
        )
        if plan != flown.plan:
            self._plan.store(replace(flown, plan=plan))

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"home": self.reported_home, "wanted": self.requested_stop}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore from a checkpoint."""
        self.reported_home, self.requested_stop = checkpoint.home, checkpoint.wanted


@dataclass(slots=True)
class CurrentItem:
    """The autopilot's current mission item, and the phase in which it is flown.

    The index is `None` until telemetry reports an item of the verified onboard list, and again
    while a flight is resumed; the outbound leg is kept, also over a restart. Only mission progress
    and the resumption change the index; the flight sequence also sets the leg. Each new index
    updates the promised stop.
    """

    _gate: ReturnState
    _promise: PromisedStop
    index: int | None = None
    outbound_leg: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"leg": self.outbound_leg}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore from a checkpoint."""
        self.outbound_leg = checkpoint.leg

    def clear_index(self) -> None:
        """Clear the item; telemetry has to report it again."""
        self.index = None

    def set_outbound_leg(self, leg_index: int) -> None:
        """Set the outbound leg that is ordered."""
        self.outbound_leg = leg_index

    def set_index(self, context: FlightContext, item_index: int) -> None:
        """Set the item that the autopilot flies; the phase stays."""
        self.index = item_index
        self._promise.update_home_from_item(context, item_index)

    def position_ned_m(self, context: FlightContext) -> Ned | None:
        """Return the position that the item leads to; `None` without one."""
        flown, index = context.flight_plan, self.index
        if flown is None or index is None:
            return None
        spot = flown.mission.position_at_or_after_item(index)
        return None if spot is None else flown.mission_position_to_ned_m(spot)

    def is_descending_over_landing_site(self, context: FlightContext) -> bool:
        """Return whether it is descending to land above its site without another destination."""
        flown = context.flight_plan
        here = context.recent_position_ned_m()
        site = self.position_ned_m(context)
        if flown is None or here is None or site is None or self.index is None:
            return False
        return (
            flown.mission.part_of_item(self.index) in (Part.LAND, Part.RALLY_LAND)
            and not context.telemetry.position_faults()
            and horizontal_distance_m(here, site) <= LANDING_RADIUS_M
            and context.telemetry.ground_speed_mps() <= LANDING_MAX_SPEED_MPS
        )

    def set_index_and_advance_phase(self, context: FlightContext, item_index: int) -> None:
        """The mission has advanced to this item on its own: update the phase."""
        assert context.flight_plan is not None
        mission = context.flight_plan.mission
        self.set_index(context, item_index)
        match mission.part_of_item(item_index):
            case Part.SETTLE if context.phase is Phase.CLIMB:
                if item_index == mission.settle:
                    context.apply_phase_trigger(Trigger.AT_HEIGHT)
            case Part.OUTBOUND:
                if item_index in mission.outbound:
                    self.outbound_leg = mission.outbound.index(item_index)
            case Part.RELEASE if context.phase is Phase.DELIVER:
                context.apply_phase_trigger(Trigger.DROP_REACHED)
            case Part.RETURN:
                self._record_autonomous_return(context)
            case Part.LAND | Part.RALLY_LAND | Part.END:
                if context.is_outbound:
                    self._record_autonomous_return(context)
                context.apply_phase_trigger(Trigger.LANDING)
            case _:
                return

    def _record_autonomous_return(self, context: FlightContext) -> None:
        """The mission advanced to the return route on its own."""
        if context.phase is Phase.RELEASE:
            context.apply_phase_trigger(Trigger.DROP_OVER)
        elif context.is_outbound:
            reason = self._gate.gate_closed_reason or "next leg not cleared in time"
            context.record_decision("turn_back", f"onboard mission returned on its own: {reason}")
            context.report_alert(Alert.RETURN_BY_MISSION)
            context.apply_phase_trigger(Trigger.RETURN_STARTED, reason)

    def try_resume_from_reported_item(self, context: FlightContext) -> bool:
        """The onboard mission is verified and flies: enter the phase of its reported item.

        Returns False while item or position are unknown, and if the list is another one.
        """
        telemetry, flown = context.telemetry, context.flight_plan
        progress = telemetry.recent_or_none(telemetry.progress, PROGRESS_MAX_AGE_S)
        if progress is None or progress.index is None:
            return False
        if not telemetry.is_recent(telemetry.position, POSITION_MAX_AGE_S):
            return False
        assert flown is not None
        if progress.total is not None and progress.total != len(flown.mission.items):
            reason = f"another mission onboard ({progress.total} items)"
            context.apply_phase_trigger(Trigger.MISSION_UNKNOWN, reason)
            return False
        if flown.mission.part_of_item(progress.index) not in PART_TRIGGERS:
            context.apply_phase_trigger(Trigger.MISSION_UNKNOWN, f"item {progress.index} unknown")
            return False
        text = f"at item {progress.index} ({flown.mission.items[progress.index].label})"
        self.set_index(context, progress.index)
        context.record_decision("recognised", f"companion mission, {text}")
        self.enter_phase(context, text)
        return True

    def enter_phase(self, context: FlightContext, reason: str = "") -> None:
        """Enter the phase in which the item is flown."""
        assert context.flight_plan is not None
        assert self.index is not None
        mission = context.flight_plan.mission
        part = mission.part_of_item(self.index)
        if part is Part.OUTBOUND:
            passed = (leg for leg, item in enumerate(mission.outbound) if item <= self.index)
            self.outbound_leg = max(passed, default=0)
        elif part in (Part.RALLY, Part.LAND, Part.RALLY_LAND, Part.END):
            site = context.flight_plan.other_landing_site_name_of_item(self.index)
            self._gate.set_landing_site(site)
        context.apply_phase_trigger(PART_TRIGGERS[part], reason)


class VerificationStep(Enum):
    """Action on an unverified list."""

    READ = "read"
    RESTORE = "restore"
    GIVEN_UP = "given up"


@dataclass(slots=True)
class OnboardListState:
    """Whether the onboard list is verified, and since when it is not."""

    mission_id: int | None = None
    unverified_since_s: float | None = None
    step: VerificationStep = VerificationStep.READ
    slow_read_start_s: float | None = None
    """Start of the last slow read-back."""
    failed_s: float | None = None
    """Time at which the transfer failed that has to be repeated."""
    modified_during_read: bool = False
    """Written to since the start of the current read-back."""
    restored: bool = False
    last_mismatch_s: float | None = None
    """Last report of a foreign list or none; also after control is released."""
    last_match_s: float | None = None
    """Last report that shows no sign of a foreign list."""

    @property
    def is_unverified(self) -> bool:
        """Whether the onboard list may be a foreign one."""
        return self.unverified_since_s is not None

    def is_unchanged_in_phase(self, context: FlightContext) -> bool:
        """Return whether no foreign list was reported in this phase."""
        return context.seconds_since(self.last_mismatch_s) > context.time_in_phase_s


@dataclass(slots=True)
class ParcelState:
    """State of the parcel."""

    delivered: bool = False
    release_commanded: bool = False
    """The gripper was commanded to open: without confirmation the parcel's location is unknown."""
    release_monitor: ReleaseMonitor | None = None
    release_repeated: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"delivered": self.delivered, "drop_begun": self.release_commanded}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore; over the customer the onboard mission has continued on its own since."""
        over_customer = (Phase.DELIVER.value, Phase.RELEASE.value)
        self.delivered = checkpoint.delivered
        self.release_commanded = checkpoint.drop_begun or checkpoint.phase in over_customer

    @property
    def is_release_pending(self) -> bool:
        """Whether the parcel is on the vehicle and no release has been started."""
        return not self.delivered and self.release_monitor is None
