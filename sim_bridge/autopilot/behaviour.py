"""The interface that PX4 and ArduCopter both implement, and the parts that they are built from."""

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
    """What `autopilot.py` builds for either autopilot."""

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
    """What an autopilot's parameters mean for flying, in SI."""

    def flight_rules(self, params: ParameterStore) -> FlightRules:
        """How mission items are flown."""
        ...

    def limits(self, params: ParameterStore) -> Limits:
        """Limits of the controller."""
        ...

    def drag_coefficients(self, params: ParameterStore) -> DragCoefficients | None:
        """Coefficients of drag fusion; None if it is off."""
        ...

    def sink_mps(self, params: ParameterStore, height_m: float) -> float:
        """Descent speed of a landing at a height above home."""
        ...

    def faces_legs(self, params: ParameterStore) -> bool:
        """Whether the nose points along each leg."""
        ...

    def fence(self, state: VehicleState, store: MissionStore) -> Fence:
        """The geofence in force."""
        ...

    def return_plan(self, state: VehicleState, store: MissionStore) -> ReturnPlan:
        """How to return to launch from here."""
        ...


class AutopilotBehaviour(Protocol):
    """What `autopilot.py` and `inbox.py` ask of PX4 and of ArduCopter."""

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
    def release(self) -> bool:
        """Whether the gripper is open."""
        ...

    # --- flying -------------------------------------------------------------------------------

    def initial_mode(self) -> Mode:
        """The mode after a boot on the ground."""
        ...

    def goal(self) -> Goal:
        """What the present mode asks for; only called while armed."""
        ...

    def slow_step(self) -> None:
        """Radio control, failsafes, automatic disarming and delayed messages, at 10 Hz."""
        ...

    def boot(self, *, in_flight: bool) -> None:
        """Forget what a reboot loses."""
        ...

    def remaining_frac(self) -> float | None:
        """Remaining battery charge as a share of full; call it at 10 Hz."""
        ...

    # --- messages -----------------------------------------------------------------------------

    @property
    def answers_ping(self) -> bool: ...

    def gcs_heard(self, system: int) -> None:
        """A ground station's HEARTBEAT has arrived."""
        ...

    def take_setpoint(self, setpoint: Setpoint) -> None:
        """A set-point has arrived."""
        ...

    def override_channels(self, system: int, channels: list[int]) -> None:
        """RC_CHANNELS_OVERRIDE or MANUAL_CONTROL from a system."""
        ...

    def set_mode_message(self, link_id: int, message: Message) -> None:
        """SET_MODE."""
        ...

    def set_parameter(self, link_id: int, message: Message) -> None:
        """PARAM_SET."""
        ...

    def parameter_unknown(self, link_id: int, message: Message) -> None:
        """A parameter was asked for that does not exist."""
        ...

    def answered_index(self, requested: int) -> int | None:
        """PARAM_VALUE.param_index in an answer; None is the parameter's own index."""
        ...

    def mission_set_current(self, link_id: int, seq: int) -> None:
        """MISSION_SET_CURRENT."""
        ...

    def guided_item(self, link_id: int, message: Message) -> bool:
        """A mission item with current = 2; whether it was taken as a command to fly there."""
        ...

    def data_stream(self, stream_id: int) -> tuple[str, ...]:
        """Names of the messages in a group of REQUEST_DATA_STREAM."""
        ...
