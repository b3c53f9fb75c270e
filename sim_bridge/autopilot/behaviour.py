"""The common interface of PX4 and ArduCopter, and their components."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from sim_bridge.autopilot.base.goals import Goal, Setpoint
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.battery import BatteryMonitor
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance, Limits
from sim_bridge.autopilot.flight.landing import LandingDetector
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.returning import ReturnPlan
from sim_bridge.autopilot.flight.wind import DragCoefficients, WindFusion
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mission.executor import MissionExecutor
from sim_bridge.autopilot.mission.fence import Fence, Geofence
from sim_bridge.autopilot.mission.items import MissionStore
from sim_bridge.autopilot.services.commands import Handler
from sim_bridge.autopilot.services.mission_protocol import MissionWatcher
from sim_bridge.autopilot.services.radio import Builder, Radio
from sim_bridge.autopilot.state import FlightRules, VehicleState


@dataclass(frozen=True, slots=True)
class AutopilotParts:
    """Components that `autopilot.py` builds for either autopilot."""

    state: VehicleState
    radio: Radio
    guidance: Guidance
    landing: LandingDetector
    battery: BatteryMonitor
    wind: WindFusion
    rc: RcInput
    geofence: Geofence
    store: MissionStore
    reboot: Callable[[], None]


class ParameterRules(Protocol):
    """Flight rules derived from an autopilot's parameters, in SI."""

    def mission_flight_rules(self, params: ParameterStore) -> FlightRules:
        """Return the rules for flying mission items."""
        ...

    def controller_limits(self, params: ParameterStore) -> Limits:
        """Limits of the controller."""
        ...

    def drag_coefficients(self, params: ParameterStore) -> DragCoefficients | None:
        """Return the coefficients of drag fusion; None if it is off."""
        ...

    def landing_descent_speed_mps(
        self, params: ParameterStore, height_above_home_m: float
    ) -> float:
        """Descent speed of a landing at a height above home."""
        ...

    def is_nose_pointed_along_leg(self, params: ParameterStore) -> bool:
        """Return True if the nose points along each leg."""
        ...

    def fence_in_force(self, state: VehicleState, store: MissionStore) -> Fence:
        """The geofence in force."""
        ...

    def return_to_launch_plan(self, state: VehicleState, store: MissionStore) -> ReturnPlan:
        """Return the plan for returning to launch from here."""
        ...


class AutopilotBehaviour(Protocol):
    """Interface that `autopilot.py` and `inbox.py` use for PX4 and ArduCopter."""

    commands: dict[int, Handler]
    """Handlers of commands by number."""

    @property
    def rules(self) -> ParameterRules: ...
    @property
    def commander(self) -> Commander: ...
    @property
    def executor(self) -> MissionExecutor: ...
    @property
    def mission(self) -> MissionWatcher: ...
    @property
    def streams(self) -> Mapping[str, Builder]:
        """Builders of messages by name."""
        ...

    @property
    def is_gripper_open(self) -> bool:
        """Return True if the gripper is open."""
        ...

    # --- flying -------------------------------------------------------------------------------

    def initial_mode(self) -> Mode:
        """The mode after a boot on the ground."""
        ...

    def advance_mode_and_return_goal(self) -> Goal:
        """Return the goal of the current mode; called only while armed."""
        ...

    def run_10hz_tasks(self) -> None:
        """Radio control, failsafes, automatic disarming and delayed messages, at 10 Hz."""
        ...

    def reset_at_reboot(self, *, in_flight: bool) -> None:
        """Reset the volatile state at a reboot."""
        ...

    def update_remaining_battery_frac(self) -> float | None:
        """Remaining battery charge as a share of full; call it at 10 Hz."""
        ...

    # --- messages -----------------------------------------------------------------------------

    @property
    def responds_to_ping(self) -> bool: ...

    def on_gcs_heartbeat(self, gcs_system_id: int) -> None:
        """A ground station's HEARTBEAT has arrived."""
        ...

    def on_setpoint(self, setpoint: Setpoint) -> None:
        """A set-point has arrived."""
        ...

    def on_rc_override(self, sender_system_id: int, channel_pulses_us: list[int]) -> None:
        """RC_CHANNELS_OVERRIDE or MANUAL_CONTROL from a system."""
        ...

    def handle_set_mode_message(self, link_id: int, message: Message) -> None:
        """SET_MODE."""
        ...

    def handle_param_set_and_respond(self, link_id: int, message: Message) -> None:
        """PARAM_SET."""
        ...

    def handle_unknown_parameter_request(self, link_id: int, message: Message) -> None:
        """Handle a request for a parameter that does not exist."""
        ...

    def param_value_response_index(self, requested_index: int) -> int | None:
        """Return PARAM_VALUE.param_index for a response; None means the parameter's own index."""
        ...

    def on_mission_set_current(self, link_id: int, seq: int) -> None:
        """MISSION_SET_CURRENT."""
        ...

    def try_fly_to_guided_mission_item(self, link_id: int, message: Message) -> bool:
        """Handle a mission item with current = 2; return True if accepted as a fly-to command."""
        ...

    def message_names_of_stream_group(self, stream_group_id: int) -> tuple[str, ...]:
        """Names of the messages in a group of REQUEST_DATA_STREAM."""
        ...
