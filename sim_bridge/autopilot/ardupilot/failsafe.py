"""ArduCopter's failsafes (ArduCopter/events.cpp, ekf_check.cpp, fence.cpp; AP_BattMonitor)."""

from dataclasses import dataclass, field

from sim_bridge.autopilot.base.modes import NEED_POSITION, Mode
from sim_bridge.autopilot.flight.battery import BatteryMonitor
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.failsafe import Latches
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.mavlink.enums import Severity
from sim_bridge.autopilot.mission.fence import Geofence
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState

_BATTERY_ACTIONS = {
    1: Mode.LAND,
    2: Mode.RTL,
    3: Mode.RTL,
    4: Mode.LAND,
    6: Mode.RTL,
    7: Mode.HOLD,
}
_TERMINATE = 5
_LINK_ACTIONS = {
    1: Mode.RTL,
    3: Mode.RTL,
    4: Mode.RTL,
    5: Mode.LAND,
    6: Mode.RTL,
    7: Mode.HOLD,
}
"""FS_GCS_ENABLE; FS_THR_ENABLE differs in 3, which lands. SmartRTL is not simulated: RTL."""
_FENCE_ACTIONS = {1: Mode.RTL, 2: Mode.LAND, 3: Mode.RTL, 4: Mode.HOLD, 5: Mode.LAND}
_RC_CONTINUE_AUTO, _GCS_CONTINUE_AUTO, _RC_CONTINUE_GUIDED = 1, 2, 4
_CONTINUE_LANDING, _GCS_CONTINUE_PILOTED = 8, 16


@dataclass(slots=True)
class ArduPilotFailsafe:
    """Monitors failure conditions and triggers actions."""

    _state: VehicleState
    _radio: Radio
    _commander: Commander
    _rc: RcInput
    _battery: BatteryMonitor
    _geofence: Geofence
    _latches: Latches = field(default_factory=Latches)

    def reset_latches(self) -> None:
        """Reset the monitors."""
        self._latches = Latches()

    def is_own_gcs(self, system: int) -> bool:
        """Return True if a system is the ground station configured by the parameters."""
        return system == self._state.params["SYSID_MYGCS"]

    def record_own_gcs_heartbeat(self, sender_system: int) -> None:
        """Only the ground station configured by the parameters keeps the link alive."""
        if self.is_own_gcs(sender_system):
            self._latches.last_gcs_heartbeat_s = self._state.t_s

    def _disarm_or_change_mode_for_failsafe(self, failsafe_mode: Mode, reason: str) -> None:
        """Change to a mode, or land if that mode needs a position and none is available."""
        state = self._state
        self._commander.set_failsafe_reason(reason)
        if state.is_landed:
            self._commander.disarm()
            return
        if failsafe_mode in NEED_POSITION and not state.has_position:
            failsafe_mode = Mode.LAND
        if failsafe_mode is Mode.RTL and state.mode in (Mode.RTL, Mode.LAND):
            return
        self._commander.set_mode(failsafe_mode)

    def check_and_trigger_failsafes(self) -> None:
        """Check all failure conditions."""
        self._trigger_or_clear_position_failsafe()
        self._trigger_radio_failsafe_if_lost()
        self._trigger_gcs_failsafe_if_silent()
        self._trigger_battery_failsafe_if_low()
        self._trigger_fence_failsafe_on_breach()

    def _trigger_or_clear_position_failsafe(self) -> None:
        """EKF failsafe: a second without a needed position; LAND, and it stays LAND."""
        state = self._state
        lost = not state.has_position and not state.is_landed
        action = int(state.params["FS_EKF_ACTION"])
        if self._latches.position.update_and_report_trigger(lost, state.t_s, 1.0) and action > 0:
            self._commander.set_failsafe_reason("EKF")
            needs = state.mode in NEED_POSITION or action == 3
            if not needs:
                return
            mode = (
                Mode.ALT_HOLD
                if action == 2 and self._rc.stick_positions() is not None
                else Mode.LAND
            )
            self._commander.set_mode(mode)
            name = "LAND" if mode is Mode.LAND else "ALT_HOLD"
            self._radio.send_status_text(Severity.CRITICAL, f"EKF Failsafe: changed to {name} Mode")
        elif not lost and state.failsafe_reason == "EKF":
            self._commander.set_failsafe_reason(None)
            self._radio.send_status_text(Severity.INFO, "EKF Failsafe Cleared")

    def _trigger_radio_failsafe_if_lost(self) -> None:
        state = self._state
        enable, options = (
            int(state.params["FS_THR_ENABLE"]),
            int(state.params["FS_OPTIONS"]),
        )
        lost = self._rc.time_since_signal_loss_s(state.t_s) > 0.0 and enable > 0
        if not self._latches.rc.update_and_report_trigger(
            lost, state.t_s, state.params["RC_FS_TIMEOUT"]
        ):
            return
        self._radio.send_status_text(Severity.WARNING, "Radio Failsafe")
        if state.mode is Mode.AUTO and options & _RC_CONTINUE_AUTO:
            return
        if state.mode is Mode.GUIDED and options & _RC_CONTINUE_GUIDED:
            return
        if state.mode is Mode.LAND and options & _CONTINUE_LANDING:
            return
        self._disarm_or_change_mode_for_failsafe(
            Mode.LAND if enable == 3 else _LINK_ACTIONS.get(enable, Mode.RTL), "radio"
        )

    def _trigger_gcs_failsafe_if_silent(self) -> None:
        state = self._state
        enable, options = (
            int(state.params["FS_GCS_ENABLE"]),
            int(state.params["FS_OPTIONS"]),
        )
        silent = (
            self._latches.time_since_gcs_heartbeat_s(state.t_s) > state.params["FS_GCS_TIMEOUT"]
            and enable > 0
        )
        if not self._latches.gcs.update_and_report_trigger(silent, state.t_s, 0.0):
            return
        self._radio.send_status_text(Severity.WARNING, "GCS Failsafe")
        if state.mode is Mode.AUTO and options & _GCS_CONTINUE_AUTO:
            return
        if state.mode is Mode.LAND and options & _CONTINUE_LANDING:
            return
        piloted = state.mode in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER)
        if piloted and options & _GCS_CONTINUE_PILOTED:
            return
        self._disarm_or_change_mode_for_failsafe(
            _LINK_ACTIONS.get(enable, Mode.RTL), "ground station"
        )

    def _trigger_battery_failsafe_if_low(self) -> None:
        params, battery = self._state.params, self._battery
        left_mah = params["BATT_CAPACITY"] - battery.consumed_mah

        def voltage_and_charge_are_below(
            voltage_param_name: str, charge_param_name: str
        ) -> tuple[bool, bool]:
            volt, mah = params[voltage_param_name], params[charge_param_name]
            by_volt = volt > 0.0 and battery.voltage_v is not None and battery.voltage_v < volt
            by_mah = mah > 0.0 and battery.has_current and left_mah < mah
            return by_volt, by_mah

        timer_s = params["BATT_LOW_TIMER"]
        for latch, prefix, label, action_name in (
            (self._latches.battery_critical, "BATT_CRT", "critical", "BATT_FS_CRT_ACT"),
            (self._latches.battery_low, "BATT_LOW", "low", "BATT_FS_LOW_ACT"),
        ):
            by_volt, by_mah = voltage_and_charge_are_below(f"{prefix}_VOLT", f"{prefix}_MAH")
            wait_s = 0.0 if by_mah else timer_s
            if not latch.update_and_report_trigger(by_volt or by_mah, self._state.t_s, wait_s):
                continue
            volts = 0.0 if battery.voltage_v is None else battery.voltage_v
            self._radio.send_status_text(
                Severity.WARNING,
                f"Battery 1 is {label} {volts:.2f}V used {battery.consumed_mah:.0f} mAh",
            )
            action = int(params[action_name])
            if action == _TERMINATE:
                self._commander.disarm()
            elif action in _BATTERY_ACTIONS:
                self._disarm_or_change_mode_for_failsafe(_BATTERY_ACTIONS[action], "battery")

    def _trigger_fence_failsafe_on_breach(self) -> None:
        breach = self._geofence.current_vehicle_breach()
        if not self._latches.fence.update_and_report_trigger(
            breach is not None, self._state.t_s, 0.0
        ):
            return
        self._radio.send_status_text(Severity.NOTICE, "Fence Breached")
        action = int(self._state.params["FENCE_ACTION"])
        if action in _FENCE_ACTIONS:
            self._disarm_or_change_mode_for_failsafe(_FENCE_ACTIONS[action], "fence")
