"""ArduCopter's failsafes (ArduCopter/events.cpp, ekf_check.cpp, fence.cpp; AP_BattMonitor)."""

from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.failsafe import Failsafes
from sim_bridge.autopilot.flight.modes import NEED_POSITION, Mode
from sim_bridge.autopilot.mavlink.enums import Severity

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

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


def _act(ap: "Autopilot", mode: Mode, reason: str) -> None:
    """Go over to a mode, or land where that needs a position that is not there."""
    ap.failsafe_reason = reason
    if ap.is_landed:
        ap.disarm()
        return
    if mode in NEED_POSITION and not ap.has_position:
        mode = Mode.LAND
    if mode is Mode.RTL and ap.mode in (Mode.RTL, Mode.LAND):
        return
    ap.set_mode(mode)


def watch(ap: "Autopilot", failsafes: Failsafes) -> None:
    """Look at everything that can fail."""
    _position(ap, failsafes)
    _radio(ap, failsafes)
    _ground_station(ap, failsafes)
    _battery(ap, failsafes)
    _fence(ap, failsafes)


def _position(ap: "Autopilot", failsafes: Failsafes) -> None:
    """EKF failsafe: a second without a position where one is needed; LAND, and it stays LAND."""
    lost = not ap.has_position and not ap.is_landed
    action = int(ap.params["FS_EKF_ACTION"])
    if failsafes.position.update(lost, ap.t_s, 1.0) and action > 0:
        ap.failsafe_reason = "EKF"
        needs = ap.mode in NEED_POSITION or action == 3
        if not needs:
            return
        mode = Mode.ALT_HOLD if action == 2 and ap.pilot.sticks() is not None else Mode.LAND
        ap.set_mode(mode)
        name = "LAND" if mode is Mode.LAND else "ALT_HOLD"
        ap.say(Severity.CRITICAL, f"EKF Failsafe: changed to {name} Mode")
    elif not lost and ap.failsafe_reason == "EKF":
        ap.failsafe_reason = None
        ap.say(Severity.INFO, "EKF Failsafe Cleared")


def _radio(ap: "Autopilot", failsafes: Failsafes) -> None:
    enable, options = int(ap.params["FS_THR_ENABLE"]), int(ap.params["FS_OPTIONS"])
    lost = ap.pilot.lost_for_s(ap.t_s) > 0.0 and enable > 0
    if not failsafes.rc.update(lost, ap.t_s, ap.params["RC_FS_TIMEOUT"]):
        return
    ap.say(Severity.WARNING, "Radio Failsafe")
    if ap.mode is Mode.AUTO and options & _RC_CONTINUE_AUTO:
        return
    if ap.mode is Mode.GUIDED and options & _RC_CONTINUE_GUIDED:
        return
    if ap.mode is Mode.LAND and options & _CONTINUE_LANDING:
        return
    _act(ap, Mode.LAND if enable == 3 else _LINK_ACTIONS.get(enable, Mode.RTL), "radio")


def _ground_station(ap: "Autopilot", failsafes: Failsafes) -> None:
    enable, options = int(ap.params["FS_GCS_ENABLE"]), int(ap.params["FS_OPTIONS"])
    silent = failsafes.gcs_silent_s(ap.t_s) > ap.params["FS_GCS_TIMEOUT"] and enable > 0
    if not failsafes.gcs.update(silent, ap.t_s, 0.0):
        return
    ap.say(Severity.WARNING, "GCS Failsafe")
    if ap.mode is Mode.AUTO and options & _GCS_CONTINUE_AUTO:
        return
    if ap.mode is Mode.LAND and options & _CONTINUE_LANDING:
        return
    piloted = ap.mode in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER)
    if piloted and options & _GCS_CONTINUE_PILOTED:
        return
    _act(ap, _LINK_ACTIONS.get(enable, Mode.RTL), "ground station")


def _battery(ap: "Autopilot", failsafes: Failsafes) -> None:
    params, battery = ap.params, ap.battery
    left_mah = params["BATT_CAPACITY"] - battery.consumed_mah

    def is_under(volt_name: str, mah_name: str) -> tuple[bool, bool]:
        volt, mah = params[volt_name], params[mah_name]
        by_volt = volt > 0.0 and battery.voltage_v is not None and battery.voltage_v < volt
        by_mah = mah > 0.0 and battery.knows_current and left_mah < mah
        return by_volt, by_mah

    timer_s = params["BATT_LOW_TIMER"]
    for latch, prefix, label, action_name in (
        (failsafes.battery_critical, "BATT_CRT", "critical", "BATT_FS_CRT_ACT"),
        (failsafes.battery_low, "BATT_LOW", "low", "BATT_FS_LOW_ACT"),
    ):
        by_volt, by_mah = is_under(f"{prefix}_VOLT", f"{prefix}_MAH")
        wait_s = 0.0 if by_mah else timer_s
        if not latch.update(by_volt or by_mah, ap.t_s, wait_s):
            continue
        volts = 0.0 if battery.voltage_v is None else battery.voltage_v
        ap.say(
            Severity.WARNING,
            f"Battery 1 is {label} {volts:.2f}V used {battery.consumed_mah:.0f} mAh",
        )
        action = int(params[action_name])
        if action == _TERMINATE:
            ap.disarm()
        elif action in _BATTERY_ACTIONS:
            _act(ap, _BATTERY_ACTIONS[action], "battery")


def _fence(ap: "Autopilot", failsafes: Failsafes) -> None:
    breach = None
    if not ap.fence.is_empty and not ap.is_landed and ap.has_position:
        north, east, _ = ap.pos_ned_m
        home = ap.home_ned_m
        breach = ap.fence.breach((north, east), (home[0], home[1]), ap.height_above_home_m())
    if not failsafes.fence.update(breach is not None, ap.t_s, 0.0):
        return
    ap.say(Severity.NOTICE, "Fence Breached")
    action = int(ap.params["FENCE_ACTION"])
    if action in _FENCE_ACTIONS:
        _act(ap, _FENCE_ACTIONS[action], "fence")
