"""ArduCopter's conditions for modes and arming (ArduCopter/AP_Arming_Copter.cpp, mode.cpp)."""

from dataclasses import dataclass

from sim_bridge.autopilot.ardupilot.mode_numbers import NAMES
from sim_bridge.autopilot.base.modes import NEED_POSITION, Mode
from sim_bridge.autopilot.flight.battery import BatteryMonitor
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.mavlink.enums import TERRAIN_FRAMES, Cmd, Severity
from sim_bridge.autopilot.mission.items import MissionStore
from sim_bridge.autopilot.mission.plan import Plan
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState

PREARM_OK_AFTER_S = 36.0
_ARMABLE = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER, Mode.GUIDED, Mode.AUTO})
_AUTO_ALLOWS_ARMING = 1
_CHECKS_OFF = 0


@dataclass(slots=True)
class ArduPilotChecks:
    """Checks of whether a mode can be entered and whether the vehicle can be armed."""

    _state: VehicleState
    _radio: Radio
    _rc: RcInput
    _battery: BatteryMonitor
    _store: MissionStore
    _plan: Plan

    def _has_initial_takeoff(self) -> bool:
        """Return True if the first navigation item is a take-off."""
        plan = self._plan
        first = plan.item_index_after_jumps(plan.first, count_jumps=False)
        if first is None:
            return False
        if plan.items[first].command == Cmd.NAV_TAKEOFF:
            return True
        return any(item.command == Cmd.NAV_TAKEOFF for item in plan.items_flown_after(first))

    def _needs_terrain_data(self) -> bool:
        """Return True if a mission needs terrain data, which only a ground station provides."""
        return any(item.frame in TERRAIN_FRAMES for item in self._store.mission[1:])

    def prearm_problem(self) -> str | None:
        """Return the finding of the pre-arm checks, which do not depend on the mode."""
        state = self._state
        if state.t_since_boot_s < PREARM_OK_AFTER_S:
            return (
                "EKF3 still initialising" if state.t_since_boot_s > 10.0 else "Gyros not calibrated"
            )
        if not state.gnss_ok:
            return "GPS 1: Bad fix"
        if self._needs_terrain_data():
            return "waiting for terrain data"
        voltage, least = self._battery.voltage_v, state.params["BATT_ARM_VOLT"]
        if voltage is not None and voltage < least:
            return "Battery 1 below minimum arming voltage"
        return None

    def arming_denial_reason(self) -> str | None:
        """Return the reason that prevents arming now."""
        state = self._state
        checking = state.params["ARMING_CHECK"] != _CHECKS_OFF
        if checking:
            problem = self.prearm_problem()
            if problem is not None:
                return problem
        mode = state.mode
        if mode not in _ARMABLE:
            return f"{NAMES.get(mode, 'mode')} mode not armable"
        if mode in NEED_POSITION and not state.has_position:
            return "Need Position Estimate"
        if mode is Mode.AUTO:
            if not int(state.params["AUTO_OPTIONS"]) & _AUTO_ALLOWS_ARMING:
                return "AUTO mode not armable"
            if self._plan.is_empty:
                return "Mode requires mission"
            if not self._has_initial_takeoff():
                return "Missing Takeoff Cmd"
        if checking and mode not in (Mode.GUIDED, Mode.AUTO):
            sticks = self._rc.stick_positions()
            if sticks is None:
                return "Throttle below Failsafe"
            if sticks.throttle > (0.05 if mode is Mode.STABILIZE else 0.6):
                return "Throttle too high"
        return None

    def mode_entry_problem(self, mode: Mode) -> str | None:
        """Return the reason that prevents entry to a mode now."""
        state = self._state
        if state.is_armed and mode in NEED_POSITION and not state.has_position:
            return "requires position"
        if (
            mode is Mode.AUTO and state.is_armed
        ):  # no requirement while disarmed (mode_auto.cpp, init)
            if self._plan.is_empty:
                return "init failed"
            if state.is_landed and not self._has_initial_takeoff():
                self._radio.send_status_text(Severity.CRITICAL, "Auto: Missing Takeoff Cmd")
                return "init failed"
        return None
