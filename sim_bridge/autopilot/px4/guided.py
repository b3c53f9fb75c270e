"""OFFBOARD: flying by set-points from outside (flight_mode_manager, Commander's failsafe)."""

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


class Px4Guided:
    """What the latest set-point asks for, and what happens when set-points stop."""

    def __init__(
        self,
        state: VehicleState,
        radio: Radio,
        commander: Commander,
        targets: ModeTargets,
        checks: Px4Checks,
    ) -> None:
        self._state = state
        self._radio = radio
        self._commander = commander
        self._targets = targets
        self._checks = checks

    def goal(self) -> Goal:
        """What to fly in OFFBOARD."""
        state, setpoint = self._state, self._targets.setpoint
        if setpoint is None or not self._checks.has_setpoints():
            if state.is_landed:
                return Idle()
            self._lost()
            return HoldPoint(state.pos_ned_m)
        pos, vel = setpoint.pos_ned_m, setpoint.vel_ned_mps
        wants_up = (pos is not None and pos[2] < state.pos_ned_m[2] - 0.3) or (
            vel is not None and vel[2] < -0.1
        )
        if state.is_landed and not (wants_up and state.is_spooled):
            return Idle()
        if pos is None:
            assert vel is not None
            return FlyVelocity(
                vel, setpoint.yaw_rad, setpoint.yaw_rate_rps, setpoint.accel_ned_mps2
            )
        return HoldPoint(pos, setpoint.yaw_rad)

    def _lost(self) -> None:
        """COM_OBL_RC_ACT; RTL if that mode cannot run."""
        self._commander.note_failsafe("offboard")
        self._radio.say(Severity.CRITICAL, "Failsafe activated: Offboard control lost")
        action = int(self._state.params["COM_OBL_RC_ACT"])
        wanted = _LOSS_ACTIONS.get(action, Mode.RTL)
        self._commander.set_mode(wanted if self._checks.can_run(wanted) else Mode.RTL)
