"""PX4's conditions for modes and arming.

Sources: PX4, src/modules/commander/ModeUtil/mode_requirements.cpp, Commander.cpp.
"""

import math

from sim_bridge.autopilot.base.modes import NEED_POSITION, Mode
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.px4.mission import Px4Mission
from sim_bridge.autopilot.state import VehicleState

PREVENT_ARMING = frozenset({Mode.RTL, Mode.LAND, Mode.DESCEND})
"""Nobody arms in these; what disarms in one is in another mode then."""


class Px4Checks:
    """Whether a mode can run, and whether the vehicle may be armed."""

    def __init__(
        self, state: VehicleState, rc: RcInput, targets: ModeTargets, mission: Px4Mission
    ) -> None:
        self._state = state
        self._rc = rc
        self._targets = targets
        self._mission = mission

    def has_setpoints(self) -> bool:
        """Whether a set-point has come within COM_OF_LOSS_T."""
        setpoint = self._targets.setpoint
        age = math.inf if setpoint is None else self._state.t_s - setpoint.t_s
        return age <= max(self._state.params["COM_OF_LOSS_T"], 0.1)

    def can_run(self, mode: Mode) -> bool:
        """Whether a mode's requirements are met now."""
        if mode in NEED_POSITION | {Mode.LAND} and not self._state.has_position:
            return False
        if mode is Mode.AUTO:
            return self._mission.is_valid
        if mode is Mode.GUIDED:
            return self.has_setpoints()
        if mode in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER):
            return self._rc.sticks() is not None
        return True

    def arming_problem(self) -> str | None:
        """Why arming is refused now."""
        state = self._state
        if not state.ekf_is_ready or state.readings is None:
            return "Resolve system health failures first"
        if state.mode in PREVENT_ARMING:
            return "Mode not suitable for takeoff"
        return None if self.can_run(state.mode) else "Mode not ready"
