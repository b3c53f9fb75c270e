"""ArduCopter's failsafes (ArduCopter/events.cpp, ekf_check.cpp, fence.cpp; AP_BattMonitor)."""

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


class ArduPilotFailsafe:
    """Watches what can fail, and acts."""

    def __init__(
        self,
        state: VehicleState,
        radio: Radio,
        commander: Commander,
        rc: RcInput,
        battery: BatteryMonitor,
        geofence: Geofence,
    ) -> None:
        self._state = state
        self._radio = radio
        self._commander = commander
        self._rc = rc
        self._battery = battery
        self._geofence = geofence
        self._latches = Latches()

    def boot(self) -> None:
        """Start watching afresh."""
        self._latches = Latches()

    def is_own_gcs(self, system: int) -> bool:
        """Whether a system is the ground station that the parameters name."""
        return system == self._state.params.value("SYSID_MYGCS", "MAV_GCS_SYSID")

    def gcs_heard(self, system: int) -> None:
        """Only the ground station that the parameters name keeps the link alive."""
        if self.is_own_gcs(system):
            self._latches.gcs_heard_s = self._state.t_s

    def _act(self, mode: Mode, reason: str) -> None:
        """Change to a mode, or land if that mode needs a position and there is none."""
        state = self._state
        self._commander.note_failsafe(reason)
        if state.is_landed:
            self._commander.disarm()
            return
        if mode in NEED_POSITION and not state.has_position:
            mode = Mode.LAND
        if mode is Mode.RTL and state.mode in (Mode.RTL, Mode.LAND):
            return
        self._commander.set_mode(mode)

    def watch(self) -> None:
        """Check everything that can fail."""
        self._watch_position()
        self._watch_radio()
        self._watch_ground_station()
        self._watch_battery()
        self._watch_fence()

    def _watch_position(self) -> None:
        """EKF failsafe: a second without a needed position; LAND, and it stays LAND."""
        state = self._state
        lost = not state.has_position and not state.is_landed
        action = int(state.params["FS_EKF_ACTION"])
        if self._latches.position.update(lost, state.t_s, 1.0) and action > 0:
            self._commander.note_failsafe("EKF")
            needs = state.mode in NEED_POSITION or action == 3
            if not needs:
                return
            mode = Mode.ALT_HOLD if action == 2 and self._rc.sticks() is not None else Mode.LAND
            self._commander.set_mode(mode)
            name = "LAND" if mode is Mode.LAND else "ALT_HOLD"
            self._radio.say(Severity.CRITICAL, f"EKF Failsafe: changed to {name} Mode")
        elif not lost and state.failsafe_reason == "EKF":
            self._commander.note_failsafe(None)
            self._radio.say(Severity.INFO, "EKF Failsafe Cleared")

    def _watch_radio(self) -> None:
        state = self._state
        enable, options = (
            int(state.params["FS_THR_ENABLE"]),
            int(state.params["FS_OPTIONS"]),
        )
        lost = self._rc.lost_for_s(state.t_s) > 0.0 and enable > 0
        if not self._latches.rc.update(lost, state.t_s, state.params["RC_FS_TIMEOUT"]):
            return
        self._radio.say(Severity.WARNING, "Radio Failsafe")
        if state.mode is Mode.AUTO and options & _RC_CONTINUE_AUTO:
            return
        if state.mode is Mode.GUIDED and options & _RC_CONTINUE_GUIDED:
            return
        if state.mode is Mode.LAND and options & _CONTINUE_LANDING:
            return
        self._act(Mode.LAND if enable == 3 else _LINK_ACTIONS.get(enable, Mode.RTL), "radio")

    def _watch_ground_station(self) -> None:
        state = self._state
        enable, options = (
            int(state.params["FS_GCS_ENABLE"]),
            int(state.params["FS_OPTIONS"]),
        )
        silent = (
            self._latches.gcs_silent_s(state.t_s) > state.params["FS_GCS_TIMEOUT"] and enable > 0
        )
        if not self._latches.gcs.update(silent, state.t_s, 0.0):
            return
        self._radio.say(Severity.WARNING, "GCS Failsafe")
        if state.mode is Mode.AUTO and options & _GCS_CONTINUE_AUTO:
            return
        if state.mode is Mode.LAND and options & _CONTINUE_LANDING:
            return
        piloted = state.mode in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER)
        if piloted and options & _GCS_CONTINUE_PILOTED:
            return
        self._act(_LINK_ACTIONS.get(enable, Mode.RTL), "ground station")

    def _watch_battery(self) -> None:
        params, battery = self._state.params, self._battery
        left_mah = params["BATT_CAPACITY"] - battery.consumed_mah

        def is_under(volt_name: str, mah_name: str) -> tuple[bool, bool]:
            volt, mah = params[volt_name], params[mah_name]
            by_volt = volt > 0.0 and battery.voltage_v is not None and battery.voltage_v < volt
            by_mah = mah > 0.0 and battery.knows_current and left_mah < mah
            return by_volt, by_mah

        timer_s = params["BATT_LOW_TIMER"]
        for latch, prefix, label, action_name in (
            (self._latches.battery_critical, "BATT_CRT", "critical", "BATT_FS_CRT_ACT"),
            (self._latches.battery_low, "BATT_LOW", "low", "BATT_FS_LOW_ACT"),
        ):
            by_volt, by_mah = is_under(f"{prefix}_VOLT", f"{prefix}_MAH")
            wait_s = 0.0 if by_mah else timer_s
            if not latch.update(by_volt or by_mah, self._state.t_s, wait_s):
                continue
            volts = 0.0 if battery.voltage_v is None else battery.voltage_v
            self._radio.say(
                Severity.WARNING,
                f"Battery 1 is {label} {volts:.2f}V used {battery.consumed_mah:.0f} mAh",
            )
            action = int(params[action_name])
            if action == _TERMINATE:
                self._commander.disarm()
            elif action in _BATTERY_ACTIONS:
                self._act(_BATTERY_ACTIONS[action], "battery")

    def _watch_fence(self) -> None:
        breach = self._geofence.breach()
        if not self._latches.fence.update(breach is not None, self._state.t_s, 0.0):
            return
        self._radio.say(Severity.NOTICE, "Fence Breached")
        action = int(self._state.params["FENCE_ACTION"])
        if action in _FENCE_ACTIONS:
            self._act(_FENCE_ACTIONS[action], "fence")
