"""PX4's failsafes (src/modules/commander/failsafe/failsafe.cpp).

For radio, ground station and battery the vehicle first holds for COM_FAIL_ACT_T, so that a pilot
can step in, then acts.
"""

import math

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
_HOME_OR_DOWN = frozenset({Mode.RTL, Mode.LAND, Mode.DESCEND})


class Px4Failsafe:
    """Watches what can fail, and acts.

    `interrupted` is the mode that a failsafe has replaced because it could not run.
    """

    def __init__(
        self,
        state: VehicleState,
        radio: Radio,
        commander: Commander,
        rc: RcInput,
        battery: BatteryMonitor,
        geofence: Geofence,
        checks: Px4Checks,
    ) -> None:
        self._state = state
        self._radio = radio
        self._commander = commander
        self._rc = rc
        self._battery = battery
        self._geofence = geofence
        self._checks = checks
        self._latches = Latches()
        self.interrupted: Mode | None = None
        self._delayed: tuple[Mode, float] | None = None
        """A mode to change to, and when."""

    def boot(self) -> None:
        """Start watching afresh."""
        self._latches = Latches()

    def gcs_heard(self, system: int) -> None:
        """Any ground station keeps the link alive."""
        self._latches.gcs_heard_s = self._state.t_s

    def user_took_over(self) -> None:
        """Somebody has decided: nothing that a failsafe had begun goes on."""
        self._delayed = None
        self.interrupted = None
        self._commander.note_failsafe(None)

    def disarmed(self) -> None:
        """Nothing is pending after a flight."""
        self._delayed = None
        self.interrupted = None

    def act_when_due(self) -> None:
        """Change to the mode that was delayed, if the vehicle still holds."""
        if self._delayed is None or self._state.t_s < self._delayed[1]:
            return
        mode, self._delayed = self._delayed[0], None
        if self._state.mode is Mode.HOLD and mode is not Mode.HOLD:
            self._commander.set_mode(mode)

    def watch(self) -> None:
        """Check everything that can fail."""
        self._watch_position()
        if self._state.mode is Mode.DESCEND:
            return
        self._watch_battery()
        self._watch_radio()
        self._watch_ground_station()
        self._watch_fence()

    def _watch_position(self) -> None:
        """No position: altitude mode for a pilot, else blind descent; with it, back to the mode."""
        state, commander = self._state, self._commander
        lost = not state.has_position and not state.is_landed
        if self._latches.position.update(lost, state.t_s, 1.0) and state.mode in (
            NEED_POSITION | {Mode.LAND}
        ):
            commander.note_failsafe("position")
            if self._rc.sticks() is not None:
                commander.set_mode(Mode.ALT_HOLD)
                self._radio.say(
                    Severity.CRITICAL, "Failsafe: no position, switching to Altitude mode"
                )
                return
            self.interrupted = state.mode
            commander.set_mode(Mode.DESCEND)
            self._radio.say(
                Severity.CRITICAL, "Failsafe activated: Autopilot disengaged, descending"
            )
        elif not lost and state.mode is Mode.DESCEND and not state.is_landed:
            commander.note_failsafe(None)
            self._recover()

    def _recover(self) -> None:
        """Back to the mode that could not run."""
        wanted, self.interrupted = self.interrupted, None
        if wanted is not None and self._checks.can_run(wanted):
            self._commander.set_mode(wanted)

    def _watch_radio(self) -> None:
        state, params = self._state, self._state.params
        action = int(params["NAV_RCL_ACT"])
        lost = self._rc.lost_for_s(state.t_s) > 0.0 and action > 0
        if not self._latches.rc.update(lost, state.t_s, params["COM_RC_LOSS_T"]):
            return
        if int(params["COM_RCL_EXCEPT"]) & _LINK_EXCEPT.get(state.mode, 0):
            return
        self._link_lost(action, "Manual control lost")

    def _watch_ground_station(self) -> None:
        state, params = self._state, self._state.params
        action = int(params["NAV_DLL_ACT"])
        silent_s = self._latches.gcs_silent_s(state.t_s)
        silent = silent_s > params["COM_DL_LOSS_T"] and action > 0
        if not self._latches.gcs.update(silent, state.t_s, 0.0):
            return
        if int(params["COM_DLL_EXCEPT"]) & _LINK_EXCEPT.get(state.mode, 0):
            return
        self._link_lost(action, "GCS connection lost")

    def _link_lost(self, action: int, text: str) -> None:
        self._radio.say(Severity.CRITICAL, f"Failsafe activated: {text}")
        if action in _TERMINATE:
            self._commander.disarm()
        elif action in _LINK_ACTIONS and not self._state.is_landed:
            self._act(_LINK_ACTIONS[action], text)

    def _act(self, mode: Mode, reason: str) -> None:
        """Hold, and act after COM_FAIL_ACT_T; a mode flown by sticks is not held."""
        state, commander = self._state, self._commander
        if state.mode is mode or (mode is Mode.RTL and state.mode in _HOME_OR_DOWN):
            return
        commander.note_failsafe(reason)
        delay_s = state.params["COM_FAIL_ACT_T"]
        if delay_s <= 0.0 or state.mode in PILOTED:
            commander.set_mode(mode)
        else:
            commander.set_mode(Mode.HOLD)
            self._delayed = (mode, state.t_s + delay_s)

    def _watch_battery(self) -> None:
        state, latches, left = self._state, self._latches, self._battery.remaining_frac
        params = state.params
        left = math.inf if left is None else left
        act = int(params["COM_LOW_BAT_ACT"])
        acts = act in (2, 3) and not state.is_landed
        if latches.battery_low.update(left < params["BAT_LOW_THR"], state.t_s, 0.0):
            self._radio.say(Severity.WARNING, "Low battery level")
        if latches.battery_critical.update(left < params["BAT_CRIT_THR"], state.t_s, 0.0):
            self._radio.say(Severity.CRITICAL, "Critical battery level")
            if acts:
                self._act(Mode.LAND if act == 2 else Mode.RTL, "battery critical")
        if latches.battery_emergency.update(left < params["BAT_EMERGEN_THR"], state.t_s, 0.0):
            self._radio.say(Severity.EMERGENCY, "Dangerous battery level")
            if acts:
                self._commander.note_failsafe("battery emergency")
                self._commander.set_mode(Mode.LAND)

    def _watch_fence(self) -> None:
        state = self._state
        breached = self._geofence.breach() is not None
        if not self._latches.fence.update(breached, state.t_s, 0.0):
            return
        self._radio.say(Severity.WARNING, "Geofence violation")
        action = int(state.params["GF_ACTION"])
        if action == 4:
            self._commander.disarm()
        elif action in _FENCE_ACTIONS and state.mode not in _HOME_OR_DOWN:
            self._commander.note_failsafe("fence")
            self._commander.set_mode(_FENCE_ACTIONS[action])
