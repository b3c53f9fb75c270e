"""What each of ArduCopter's modes makes the vehicle fly.

Sources: ArduPilot, ArduCopter/mode_*.cpp.
"""

from sim_bridge.autopilot.ardupilot.guided import ArduPilotGuided
from sim_bridge.autopilot.ardupilot.mission import ArduPilotMission
from sim_bridge.autopilot.base.goals import Descend, Goal, HoldPoint, Idle, Setpoint
from sim_bridge.autopilot.base.modes import PILOTED, Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.piloted import level_descent, piloted_goal
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.returning import ReturnPhase
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.enums import MissionState
from sim_bridge.autopilot.mission.executor import Phase
from sim_bridge.autopilot.state import VehicleState

_SPOOL_DOWN_S = 0.4
"""From landed to ground idle, and so to disarming (flown; MOT_SPOOL_TIM_DN)."""


class ArduPilotModes:
    """The modes' goals."""

    def __init__(
        self,
        state: VehicleState,
        commander: Commander,
        targets: ModeTargets,
        rc: RcInput,
        mission: ArduPilotMission,
        guided: ArduPilotGuided,
    ) -> None:
        self._state = state
        self._commander = commander
        self._targets = targets
        self._rc = rc
        self._mission = mission
        self._guided = guided

    def entered(self, mode: Mode) -> None:
        """Start a mode afresh."""
        self._guided.mode_entered()
        if not self._state.is_armed:
            return
        if mode is Mode.AUTO:
            self._guided.clear_limits()
            self._mission.executor.start()
        elif mode is Mode.RTL:
            self._targets.returning = self._mission.plan_return()

    def goal(self) -> Goal:
        """What the mode asks for now (only called while armed)."""
        state, mode = self._state, self._state.mode
        if mode is Mode.AUTO:
            return self._auto()
        if mode is Mode.GUIDED:
            return self._guided.goal()
        if mode is Mode.RTL:
            return self._rtl()
        if mode is Mode.LAND:
            return self._land()
        if mode in PILOTED:
            speed = state.params.metres("LOIT_SPEED")
            climb = state.params.metres("PILOT_SPEED_UP")
            return piloted_goal(state, self._targets, self._rc, speed, climb)
        return Idle() if state.is_landed else HoldPoint(self._targets.hold_here())

    def take_setpoint(self, setpoint: Setpoint) -> None:
        """Only in GUIDED, or where the mission says so, and not before a take-off is done."""
        mode, leg = self._state.mode, self._mission.executor.leg
        in_mission = mode is Mode.AUTO and leg is not None and leg.phase is Phase.GUIDED
        if (mode is Mode.GUIDED or in_mission) and self._targets.takeoff_down_m is None:
            self._guided.follow(setpoint)

    def _auto(self) -> Goal:
        executor = self._mission.executor
        leg = executor.leg
        if self._state.is_landed and leg is not None and executor.state == MissionState.ACTIVE:
            landing = leg.phase is Phase.DESCEND
            if leg.returning is not None and leg.returning.phase is ReturnPhase.LAND:
                landing = True
            if landing:  # it stays at this item and disarms; disarming resets the mission
                return self._touched_down()
        return executor.step()

    def _rtl(self) -> Goal:
        if self._targets.returning is None:
            self._targets.returning = self._mission.plan_return()
        goal = self._targets.returning.step(self._state, self._mission.sink_mps)
        return self._touched_down() if goal is None else goal

    def _touched_down(self) -> Goal:
        """Disarm when the motors have spooled down, whatever the mission has left."""
        if self._state.t_s - self._state.landed_since_s >= _SPOOL_DOWN_S:
            self._commander.disarm()
        return Idle()

    def _land(self) -> Goal:
        state = self._state
        if state.is_landed:
            return self._touched_down()
        rate = self._mission.sink_mps(state.height_above_home_m)
        if not state.has_position:
            return level_descent(rate)
        north, east, _ = self._targets.hold_here()
        return Descend((north, east), rate)
