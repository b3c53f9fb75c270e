"""Flight goals of ArduCopter's modes.

Sources: ArduPilot, ArduCopter/mode_*.cpp.
"""

from dataclasses import dataclass

from sim_bridge.autopilot.ardupilot.guided import ArduPilotGuided
from sim_bridge.autopilot.ardupilot.mission import ArduPilotMission
from sim_bridge.autopilot.base.goals import Descend, Goal, HoldPoint, Idle, Setpoint
from sim_bridge.autopilot.base.modes import PILOTED, Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.piloted import level_descent_goal, stick_flight_goal
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.returning import ReturnPhase
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.enums import MissionState
from sim_bridge.autopilot.mission.executor import Phase
from sim_bridge.autopilot.state import VehicleState

_SPOOL_DOWN_S = 0.4
"""Time from landed to ground idle, and so to disarming (flown; MOT_SPOOL_TIM_DN)."""


@dataclass(slots=True)
class ArduPilotModes:
    """The modes' goals."""

    _state: VehicleState
    _commander: Commander
    _targets: ModeTargets
    _rc: RcInput
    _mission: ArduPilotMission
    _guided: ArduPilotGuided

    def initialise_entered_mode(self, mode: Mode) -> None:
        """Initialise a mode on entry."""
        self._guided.discard_setpoint()
        if not self._state.is_armed:
            return
        if mode is Mode.AUTO:
            self._guided.clear_guided_limits()
            self._mission.executor.activate_at_current_item()
        elif mode is Mode.RTL:
            self._targets.returning = self._mission.plan_return_to_launch()

    def update_and_return_goal(self) -> Goal:
        """Return the goal of the current mode (called only while armed)."""
        state, mode = self._state, self._state.mode
        if mode is Mode.AUTO:
            return self._update_and_return_auto_goal()
        if mode is Mode.GUIDED:
            return self._guided.update_and_return_guided_goal()
        if mode is Mode.RTL:
            return self._update_and_return_rtl_goal()
        if mode is Mode.LAND:
            return self._disarm_or_return_land_goal()
        if mode in PILOTED:
            speed = state.params.centimetre_value_as_m("LOIT_SPEED")
            climb = state.params.centimetre_value_as_m("PILOT_SPEED_UP")
            return stick_flight_goal(state, self._targets, self._rc, speed, climb)
        return (
            Idle()
            if state.is_landed
            else HoldPoint(self._targets.hold_point_or_store_stopping_point())
        )

    def accept_setpoint_if_guided(self, setpoint: Setpoint) -> None:
        """Accept set-points only in GUIDED or a guided mission item, and only after take-off is
        complete."""
        mode, leg = self._state.mode, self._mission.executor.leg
        in_mission = mode is Mode.AUTO and leg is not None and leg.phase is Phase.GUIDED
        if (mode is Mode.GUIDED or in_mission) and self._targets.takeoff_down_m is None:
            self._guided.start_flight_to_setpoint(setpoint)

    def _update_and_return_auto_goal(self) -> Goal:
        executor = self._mission.executor
        leg = executor.leg
        if self._state.is_landed and leg is not None and executor.state == MissionState.ACTIVE:
            landing = leg.phase is Phase.DESCEND
            if leg.returning is not None and leg.returning.phase is ReturnPhase.LAND:
                landing = True
            if landing:  # it stays at this item and disarms; disarming resets the mission
                return self._disarm_after_spool_down()
        return executor.advance_and_return_goal()

    def _update_and_return_rtl_goal(self) -> Goal:
        if self._targets.returning is None:
            self._targets.returning = self._mission.plan_return_to_launch()
        goal = self._targets.returning.update_phase_and_return_goal(
            self._state, self._mission.landing_descent_speed_mps
        )
        return self._disarm_after_spool_down() if goal is None else goal

    def _disarm_after_spool_down(self) -> Goal:
        """Disarm when the motors have spooled down, regardless of remaining mission items."""
        if self._state.t_s - self._state.landed_since_s >= _SPOOL_DOWN_S:
            self._commander.disarm()
        return Idle()

    def _disarm_or_return_land_goal(self) -> Goal:
        state = self._state
        if state.is_landed:
            return self._disarm_after_spool_down()
        rate = self._mission.landing_descent_speed_mps(state.height_above_home_m)
        if not state.has_position:
            return level_descent_goal(rate)
        north, east, _ = self._targets.hold_point_or_store_stopping_point()
        return Descend((north, east), rate)
