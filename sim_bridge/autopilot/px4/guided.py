"""OFFBOARD: flight by external set-points (flight_mode_manager, Commander's failsafe)."""

from dataclasses import dataclass

from sim_bridge.autopilot.base.goals import FlyVelocity, Goal, HoldPoint, Idle
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.enums import Severity
from sim_bridge.autopilot.px4.checks import Px4Checks
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState

_LOSS_ACTIONS = {
    0: Mode.LOITER,
    1: Mode.ALT_HOLD,
    2: Mode.STABILIZE,
    3: Mode.RTL,
    4: Mode.LAND,
    5: Mode.HOLD,
}
"""COM_OBL_RC_ACT."""


@dataclass(slots=True)
class Px4Guided:
    """Target of the latest set-point, and the reaction to a loss of set-points."""

    _state: VehicleState
    _radio: Radio
    _commander: Commander
    _targets: ModeTargets
    _checks: Px4Checks

    def setpoint_goal_or_handle_loss(self) -> Goal:
        """Return the goal in OFFBOARD."""
        state, setpoint = self._state, self._targets.setpoint
        if setpoint is None or not self._checks.has_recent_setpoint():
            if state.is_landed:
                return Idle()
            self._trigger_setpoint_loss_failsafe()
            return HoldPoint(state.pos_ned_m)
        pos, vel = setpoint.pos_ned_m, setpoint.vel_ned_mps
        is_climb_demanded = (pos is not None and pos[2] < state.pos_ned_m[2] - 0.3) or (
            vel is not None and vel[2] < -0.1
        )
        if state.is_landed and not (is_climb_demanded and state.are_motors_spooled_up):
            return Idle()
        if pos is None:
            assert vel is not None
            return FlyVelocity(
                vel, setpoint.yaw_rad, setpoint.yaw_rate_rps, setpoint.accel_ned_mps2
            )
        return HoldPoint(pos, setpoint.yaw_rad)

    def _trigger_setpoint_loss_failsafe(self) -> None:
        """COM_OBL_RC_ACT; RTL if that mode cannot run."""
        self._commander.set_failsafe_reason("offboard")
        self._radio.send_status_text(Severity.CRITICAL, "Failsafe activated: Offboard control lost")
        action = int(self._state.params["COM_OBL_RC_ACT"])
        failsafe_mode = _LOSS_ACTIONS.get(action, Mode.RTL)
        self._commander.set_mode(
            failsafe_mode if self._checks.can_mode_run(failsafe_mode) else Mode.RTL
        )
