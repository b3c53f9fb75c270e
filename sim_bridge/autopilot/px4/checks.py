"""PX4's conditions for modes and arming.

Sources: PX4, src/modules/commander/ModeUtil/mode_requirements.cpp, Commander.cpp.
"""

import math
from dataclasses import dataclass

from sim_bridge.autopilot.base.modes import NEED_POSITION, Mode
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.px4.mission import Px4Mission
from sim_bridge.autopilot.state import VehicleState

NON_ARMABLE_MODES = frozenset({Mode.RTL, Mode.LAND, Mode.DESCEND})
"""Modes without arming; automatic disarming in one of them changes the mode first."""


@dataclass(slots=True)
class Px4Checks:
    """Checks of whether a mode can run and whether the vehicle can be armed."""

    _state: VehicleState
    _rc: RcInput
    _targets: ModeTargets
    _mission: Px4Mission

    def has_recent_setpoint(self) -> bool:
        """Return True if a set-point has arrived within COM_OF_LOSS_T."""
        setpoint = self._targets.setpoint
        age = math.inf if setpoint is None else self._state.t_s - setpoint.t_s
        return age <= max(self._state.params["COM_OF_LOSS_T"], 0.1)

    def can_mode_run(self, mode: Mode) -> bool:
        """Return True if a mode's requirements are met now."""
        if mode in NEED_POSITION | {Mode.LAND} and not self._state.has_position:
            return False
        if mode is Mode.AUTO:
            return self._mission.has_flyable_mission
        if mode is Mode.GUIDED:
            return self.has_recent_setpoint()
        if mode in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER):
            return self._rc.stick_positions() is not None
        return True

    def arming_denial_reason(self) -> str | None:
        """Return the reason that prevents arming now."""
        state = self._state
        if not state.ekf_is_ready or state.readings is None:
            return "Resolve system health failures first"
        if state.mode in NON_ARMABLE_MODES:
            return "Mode not suitable for takeoff"
        return None if self.can_mode_run(state.mode) else "Mode not ready"
