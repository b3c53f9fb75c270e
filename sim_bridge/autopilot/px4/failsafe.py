"""PX4's failsafes (src/modules/commander/failsafe/failsafe.cpp).

For radio, ground station and battery the vehicle first holds for COM_FAIL_ACT_T, so that a pilot
can step in, then acts.
"""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.failsafe import Failsafes
from sim_bridge.autopilot.flight.modes import NEED_POSITION, PILOTED, Mode
from sim_bridge.autopilot.mavlink.enums import Severity

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_LINK_ACTIONS = {1: Mode.HOLD, 2: Mode.RTL, 3: Mode.LAND}
"""NAV_RCL_ACT and NAV_DLL_ACT; 5 and 6 (terminate, lockdown) disarm."""
_TERMINATE = (5, 6)
_FENCE_ACTIONS = {2: Mode.HOLD, 3: Mode.RTL, 5: Mode.LAND}
_LINK_EXCEPT = {Mode.AUTO: 1, Mode.HOLD: 2, Mode.GUIDED: 4}
"""Bits of COM_RCL_EXCEPT and COM_DLL_EXCEPT."""
_HOME_OR_DOWN = frozenset({Mode.RTL, Mode.LAND, Mode.DESCEND})


def watch(ap: "Autopilot", failsafes: Failsafes) -> None:
    """Look at everything that can fail."""
    _position(ap, failsafes)
    if ap.mode is Mode.DESCEND:
        return
    _battery(ap, failsafes)
    _radio(ap, failsafes)
    _ground_station(ap, failsafes)
    _fence(ap, failsafes)


def _position(ap: "Autopilot", failsafes: Failsafes) -> None:
    """No position: altitude mode for a pilot, else blind descent; with it, back to the mode."""
    lost = not ap.has_position and not ap.is_landed
    if failsafes.position.update(lost, ap.t_s, 1.0) and ap.mode in NEED_POSITION | {Mode.LAND}:
        ap.failsafe_reason = "position"
        if ap.pilot.sticks() is not None:
            ap.set_mode(Mode.ALT_HOLD)
            ap.say(Severity.CRITICAL, "Failsafe: no position, switching to Altitude mode")
            return
        ap.px4.fall_back(ap, Mode.DESCEND)
        ap.say(Severity.CRITICAL, "Failsafe activated: Autopilot disengaged, descending")
    elif not lost and ap.mode is Mode.DESCEND and not ap.is_landed:
        ap.failsafe_reason = None
        ap.px4.recover(ap)


def _radio(ap: "Autopilot", failsafes: Failsafes) -> None:
    action = int(ap.params["NAV_RCL_ACT"])
    lost = ap.pilot.lost_for_s(ap.t_s) > 0.0 and action > 0
    if not failsafes.rc.update(lost, ap.t_s, ap.params["COM_RC_LOSS_T"]):
        return
    if int(ap.params["COM_RCL_EXCEPT"]) & _LINK_EXCEPT.get(ap.mode, 0):
        return
    _link_lost(ap, action, "Manual control lost")


def _ground_station(ap: "Autopilot", failsafes: Failsafes) -> None:
    action = int(ap.params["NAV_DLL_ACT"])
    silent = failsafes.gcs_silent_s(ap.t_s) > ap.params["COM_DL_LOSS_T"] and action > 0
    if not failsafes.gcs.update(silent, ap.t_s, 0.0):
        return
    if int(ap.params["COM_DLL_EXCEPT"]) & _LINK_EXCEPT.get(ap.mode, 0):
        return
    _link_lost(ap, action, "GCS connection lost")


def _link_lost(ap: "Autopilot", action: int, text: str) -> None:
    ap.say(Severity.CRITICAL, f"Failsafe activated: {text}")
    if action in _TERMINATE:
        ap.disarm()
    elif action in _LINK_ACTIONS and not ap.is_landed:
        _act(ap, _LINK_ACTIONS[action], text)


def _act(ap: "Autopilot", mode: Mode, reason: str) -> None:
    """Hold, and act after COM_FAIL_ACT_T; a pilot's mode has nothing to hold."""
    if ap.mode is mode or (mode is Mode.RTL and ap.mode in _HOME_OR_DOWN):
        return
    ap.failsafe_reason = reason
    delay_s = ap.params["COM_FAIL_ACT_T"]
    if delay_s <= 0.0 or ap.mode in PILOTED:
        ap.set_mode(mode)
    else:
        ap.px4.hold_then(ap, mode, delay_s)


def _battery(ap: "Autopilot", failsafes: Failsafes) -> None:
    params, left = ap.params, ap.battery_remaining_frac
    left = math.inf if left is None else left
    act = int(params["COM_LOW_BAT_ACT"])
    if failsafes.battery_low.update(left < params["BAT_LOW_THR"], ap.t_s, 0.0):
        ap.say(Severity.WARNING, "Low battery level")
    if failsafes.battery_critical.update(left < params["BAT_CRIT_THR"], ap.t_s, 0.0):
        ap.say(Severity.CRITICAL, "Critical battery level")
        if act in (2, 3) and not ap.is_landed:
            _act(ap, Mode.LAND if act == 2 else Mode.RTL, "battery critical")
    if failsafes.battery_emergency.update(left < params["BAT_EMERGEN_THR"], ap.t_s, 0.0):
        ap.say(Severity.EMERGENCY, "Dangerous battery level")
        if act in (2, 3) and not ap.is_landed:
            ap.failsafe_reason = "battery emergency"
            ap.set_mode(Mode.LAND)


def _fence(ap: "Autopilot", failsafes: Failsafes) -> None:
    breach = None
    if not ap.fence.is_empty and not ap.is_landed and ap.has_position:
        north, east, _ = ap.pos_ned_m
        home = ap.home_ned_m
        breach = ap.fence.breach((north, east), (home[0], home[1]), ap.height_above_home_m())
    if not failsafes.fence.update(breach is not None, ap.t_s, 0.0):
        return
    ap.say(Severity.WARNING, "Geofence violation")
    action = int(ap.params["GF_ACTION"])
    if action == 4:
        ap.disarm()
    elif action in _FENCE_ACTIONS and ap.mode not in _HOME_OR_DOWN:
        ap.failsafe_reason = "fence"
        ap.set_mode(_FENCE_ACTIONS[action])
