"""PX4's failsafes (src/modules/commander/failsafe/failsafe.cpp).

For radio, ground station and battery the vehicle first holds for COM_FAIL_ACT_T, to allow a pilot
override, then acts.
"""

import math
from dataclasses import dataclass, field

from sim_bridge.autopilot.base.modes import NEED_POSITION, PILOTED, Mode
from sim_bridge.autopilot.flight.battery import BatteryMonitor
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.failsafe import Latches
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.mavlink.enums import Severity
from sim_bridge.autopilot.mission.fence import Geofence
from sim_bridge.autopilot.px4.checks import Px4Checks
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState

_LINK_ACTIONS = {1: Mode.HOLD, 2: Mode.RTL, 3: Mode.LAND}
"""NAV_RCL_ACT and NAV_DLL_ACT; 5 and 6 (terminate, lockdown) disarm."""
_TERMINATE = (5, 6)
_FENCE_ACTIONS = {2: Mode.HOLD, 3: Mode.RTL, 5: Mode.LAND}
_LINK_EXCEPT = {Mode.AUTO: 1, Mode.HOLD: 2, Mode.GUIDED: 4}
"""Bits of COM_RCL_EXCEPT and COM_DLL_EXCEPT."""
_RTL_OR_LAND = frozenset({Mode.RTL, Mode.LAND, Mode.DESCEND})


@dataclass(slots=True)
class Px4Failsafe:
    """Monitors failure conditions and triggers actions.

    `interrupted` is the mode that a failsafe has replaced because it could not run.
    """

    _state: VehicleState
    _radio: Radio
    _commander: Commander
    _rc: RcInput
    _battery: BatteryMonitor
    _geofence: Geofence
    _checks: Px4Checks
    _latches: Latches = field(default_factory=Latches)
    interrupted: Mode | None = None
    _delayed: tuple[Mode, float] | None = None
    """A mode to change to, and when."""

    def reset_failure_latches(self) -> None:
        """Reset the monitors."""
        self._latches = Latches()

    def record_gcs_heartbeat(self, gcs_system_id: int) -> None:
        """Any ground station keeps the link alive."""
        self._latches.last_gcs_heartbeat_s = self._state.t_s

    def cancel_failsafe_actions(self) -> None:
        """Cancel all pending failsafe actions after a user decision."""
        self._delayed = None
        self.interrupted = None
        self._commander.set_failsafe_reason(None)

    def on_disarmed(self) -> None:
        """Clear pending actions after a flight."""
        self._delayed = None
        self.interrupted = None

    def run_due_delayed_action(self) -> None:
        """Change to the mode that was delayed, if the vehicle still holds."""
        if self._delayed is None or self._state.t_s < self._delayed[1]:
            return
        mode, self._delayed = self._delayed[0], None
        if self._state.mode is Mode.HOLD and mode is not Mode.HOLD:
            self._commander.set_mode(mode)

    def check_failures_and_trigger_failsafes(self) -> None:
        """Check all failure conditions."""
        self._trigger_or_end_position_failsafe()
        if self._state.mode is Mode.DESCEND:
            return
        self._trigger_battery_failsafes()
        self._trigger_rc_loss_failsafe()
        self._trigger_gcs_loss_failsafe()
        self._trigger_fence_failsafe()

    def _trigger_or_end_position_failsafe(self) -> None:
        """No position: altitude mode for a pilot, else blind descent; with it: previous mode."""
        state, commander = self._state, self._commander
        lost = not state.has_position and not state.is_landed
        if self._latches.position.update_and_report_trigger(
            lost, state.t_s, 1.0
        ) and state.mode in (NEED_POSITION | {Mode.LAND}):
            commander.set_failsafe_reason("position")
            if self._rc.stick_positions() is not None:
                commander.set_mode(Mode.ALT_HOLD)
                self._radio.send_status_text(
                    Severity.CRITICAL, "Failsafe: no position, switching to Altitude mode"
                )
                return
            self.interrupted = state.mode
            commander.set_mode(Mode.DESCEND)
            self._radio.send_status_text(
                Severity.CRITICAL, "Failsafe activated: Autopilot disengaged, descending"
            )
        elif not lost and state.mode is Mode.DESCEND and not state.is_landed:
            commander.set_failsafe_reason(None)
            self._restore_interrupted_mode()

    def _restore_interrupted_mode(self) -> None:
        """Return to the mode that could not run."""
        resumed_mode, self.interrupted = self.interrupted, None
        if resumed_mode is not None and self._checks.can_mode_run(resumed_mode):
            self._commander.set_mode(resumed_mode)

    def _trigger_rc_loss_failsafe(self) -> None:
        state, params = self._state, self._state.params
        action = int(params["NAV_RCL_ACT"])
        lost = self._rc.time_since_signal_loss_s(state.t_s) > 0.0 and action > 0
        if not self._latches.rc.update_and_report_trigger(lost, state.t_s, params["COM_RC_LOSS_T"]):
            return
        if int(params["COM_RCL_EXCEPT"]) & _LINK_EXCEPT.get(state.mode, 0):
            return
        self._react_to_link_loss(action, "Manual control lost")

    def _trigger_gcs_loss_failsafe(self) -> None:
        state, params = self._state, self._state.params
        action = int(params["NAV_DLL_ACT"])
        silent_s = self._latches.time_since_gcs_heartbeat_s(state.t_s)
        silent = silent_s > params["COM_DL_LOSS_T"] and action > 0
        if not self._latches.gcs.update_and_report_trigger(silent, state.t_s, 0.0):
            return
        if int(params["COM_DLL_EXCEPT"]) & _LINK_EXCEPT.get(state.mode, 0):
            return
        self._react_to_link_loss(action, "GCS connection lost")

    def _react_to_link_loss(self, action_number: int, loss_text: str) -> None:
        self._radio.send_status_text(Severity.CRITICAL, f"Failsafe activated: {loss_text}")
        if action_number in _TERMINATE:
            self._commander.disarm()
        elif action_number in _LINK_ACTIONS and not self._state.is_landed:
            self._hold_then_switch_mode(_LINK_ACTIONS[action_number], loss_text)

    def _hold_then_switch_mode(self, failsafe_mode: Mode, reason: str) -> None:
        """Hold, and act after COM_FAIL_ACT_T; a mode flown by sticks is not held."""
        state, commander = self._state, self._commander
        if state.mode is failsafe_mode or (
            failsafe_mode is Mode.RTL and state.mode in _RTL_OR_LAND
        ):
            return
        commander.set_failsafe_reason(reason)
        delay_s = state.params["COM_FAIL_ACT_T"]
        if delay_s <= 0.0 or state.mode in PILOTED:
            commander.set_mode(failsafe_mode)
        else:
            commander.set_mode(Mode.HOLD)
            self._delayed = (failsafe_mode, state.t_s + delay_s)

    def _trigger_battery_failsafes(self) -> None:
        state, latches, left = self._state, self._latches, self._battery.remaining_frac
        params = state.params
        left = math.inf if left is None else left
        act = int(params["COM_LOW_BAT_ACT"])
        is_action_due = act in (2, 3) and not state.is_landed
        if latches.battery_low.update_and_report_trigger(
            left < params["BAT_LOW_THR"], state.t_s, 0.0
        ):
            self._radio.send_status_text(Severity.WARNING, "Low battery level")
        if latches.battery_critical.update_and_report_trigger(
            left < params["BAT_CRIT_THR"], state.t_s, 0.0
        ):
            self._radio.send_status_text(Severity.CRITICAL, "Critical battery level")
            if is_action_due:
                self._hold_then_switch_mode(Mode.LAND if act == 2 else Mode.RTL, "battery critical")
        if latches.battery_emergency.update_and_report_trigger(
            left < params["BAT_EMERGEN_THR"], state.t_s, 0.0
        ):
            self._radio.send_status_text(Severity.EMERGENCY, "Dangerous battery level")
            if is_action_due:
                self._commander.set_failsafe_reason("battery emergency")
                self._commander.set_mode(Mode.LAND)

    def _trigger_fence_failsafe(self) -> None:
        state = self._state
        breached = self._geofence.current_vehicle_breach() is not None
        if not self._latches.fence.update_and_report_trigger(breached, state.t_s, 0.0):
            return
        self._radio.send_status_text(Severity.WARNING, "Geofence violation")
        action = int(state.params["GF_ACTION"])
        if action == 4:
            self._commander.disarm()
        elif action in _FENCE_ACTIONS and state.mode not in _RTL_OR_LAND:
            self._commander.set_failsafe_reason("fence")
            self._commander.set_mode(_FENCE_ACTIONS[action])
