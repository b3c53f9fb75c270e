"""RTL or LAND as the last resort: the order is repeated until telemetry shows the mode."""

from dataclasses import dataclass, field

from companion.core.mission.alerts import Alert
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import Event, Mode, OrderRefused
from companion.core.pilot.authority import OrderedMode
from companion.core.pilot.context import FlightContext
from companion.core.pilot.flight_state import CurrentItem
from companion.core.pilot.ground.autopilot_settings import AutopilotSettings
from companion.core.pilot.home_watch import HomeMonitor
from companion.core.pilot.transitions import Phase, Trigger

ORDER_INTERVAL_S = CommandKind.LAST_RESORT_MODE.value.interval_s
"""A mode shows within 1 s (HEARTBEAT), and twice that on a slow link."""

MAX_RTL_ORDERS = 10
"""Number of RTL orders without effect (20 s) after which LAND and RTL are ordered alternately."""

MODE_NAMES = {Mode.RTL: "RTL", Mode.LAND: "LAND"}


@dataclass(slots=True)
class ResortState:
    """The orders sent so far; `first_mode` is the mode that was ordered first."""

    first_mode: Mode | None = None
    started_s: float = 0.0
    ordered_s: float = 0.0
    orders: int = 1
    refusal: str = ""


@dataclass(slots=True, eq=False)
class LastResort:
    """Repeats RTL or LAND until telemetry shows the mode; raises alarms, falls back on LAND.

    An autopilot may refuse the mode for some seconds, or accept it without effect. Any other mode
    is a takeover and ends this at once (authority.py). So does a gap in telemetry after which the
    vehicle is back in a mode that a pilot selected before.
    """

    _modes: OrderedMode
    _home: HomeMonitor
    _item: CurrentItem
    _settings: AutopilotSettings
    _state: ResortState = field(default_factory=ResortState)

    def order_return_without_mission(self, context: FlightContext) -> None:
        """Order a return that needs no mission: LAND above the landing site; else RTL, if its
        altitude clears every obstacle; else the onboard mission returns home.
        """
        if self._item.is_descending_over_landing_site(context):
            context.report_alert(Alert.RETURN_REFUSED_LAND)
            context.record_decision("last_resort", "above its landing site: LAND")
            self._modes.order_mode(context, Mode.LAND)
            return
        if not self._settings.is_rtl_known_safe:
            context.report_alert(Alert.RETURN_REFUSED_NO_RTL)
            reason = "no RTL: its altitude may not clear the obstacles"
            context.record_decision("last_resort", reason)
            return
        context.report_alert(Alert.RETURN_REFUSED_RTL)
        context.record_decision(
            "last_resort", f"RTL{self._home.order_rtl_and_destination_text(context)}"
        )

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Store the autopilot's reason for the alarm."""
        if isinstance(event, OrderRefused) and event.mode is not None:
            self._state.refusal = event.reason

    def tick(self, context: FlightContext) -> None:
        """Repeat the order when due."""
        state, vehicle, mode = self._state, context.telemetry.state, self._modes.ordered
        is_active = context.phase is Phase.LAST_RESORT and context.telemetry.airborne
        if (
            not is_active
            or vehicle is None
            or mode not in MODE_NAMES
            or vehicle.mode in (mode, Mode.LAND)
        ):
            self._state = ResortState()
        elif state.first_mode is None or self._home.is_rtl_pending:
            self._state = ResortState(mode, context.t_s, context.t_s)
        elif vehicle.mode is not Mode.MISSION and context.telemetry.has_mode_gap_since(
            state.started_s
        ):
            reason = "gap in telemetry after the mode command"
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, reason)
        else:
            self._report_mode_not_in_effect(context, mode)
            if context.seconds_since(state.ordered_s) >= ORDER_INTERVAL_S - 1e-6:
                self._repeat_mode_order(context, state.first_mode)

    def _report_mode_not_in_effect(self, context: FlightContext, ordered_mode: Mode) -> None:
        state = self._state
        overdue = state.refusal or context.seconds_since(state.ordered_s) >= ORDER_INTERVAL_S - 1e-6
        if overdue:
            mode, reason = MODE_NAMES[ordered_mode], state.refusal or "unconfirmed"
            context.report_alert(Alert.MODE_NOT_IN_EFFECT, is_alarm=True, mode=mode, reason=reason)

    def _repeat_mode_order(self, context: FlightContext, first_mode: Mode) -> None:
        state = self._state
        mode = Mode.LAND if state.orders >= MAX_RTL_ORDERS and state.orders % 2 == 0 else first_mode
        if state.orders == MAX_RTL_ORDERS and mode is not first_mode:
            context.report_alert(Alert.RTL_WITHOUT_EFFECT, count=MAX_RTL_ORDERS)
            context.record_decision("last_resort", "RTL without effect: LAND")
        state.orders += 1
        state.ordered_s = context.t_s
        self._modes.order_mode(context, mode)
