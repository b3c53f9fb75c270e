"""Requests to the identified autopilot: commands, streams, parameters and missions.

Commands are queued until they are acknowledged or confirmed by telemetry. An acknowledgement is
reported but is no evidence: the pilot checks the effect in telemetry.
"""

from collections.abc import Callable
from typing import Any

from companion.adapters.autopilots.codec import COMPONENT, mavlink
from companion.adapters.autopilots.commands import CommandQueue, command_long
from companion.adapters.autopilots.mission_transfer import MISSION_MESSAGES, MissionClient
from companion.adapters.autopilots.order_commands import (
    STREAM_LANE,
    command_of_order,
    velocity_message,
)
from companion.adapters.autopilots.parameters import ParameterClient
from companion.adapters.autopilots.telemetry import AutopilotProfile, events_from_message
from companion.adapters.clock import AutopilotClock
from companion.core.mission.actions import (
    ClearMission,
    FlyVelocity,
    Order,
    RequestParameters,
    RequestTelemetry,
    SetParameters,
    UploadMission,
    VerifyMission,
)
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import (
    BoardIdReceived,
    Event,
    MessageRequestRefused,
    MissionProgress,
    MissionWriteDetected,
    OtherStationModeCommand,
    Position,
    StreamsConfigured,
    VehicleState,
)


class StreamRequests:
    """Requests of telemetry streams, in a lane of the command queue.

    Refusals are collected while requests are pending, and reported once, when all have ended.
    """

    def __init__(self, commands: CommandQueue, profile: AutopilotProfile, system_id: int) -> None:
        self._commands = commands
        self._profile = profile
        self._system_id = system_id
        self._is_requesting = False
        self._refused_streams: list[str] = []

    def request_all(self, t_s: float) -> None:
        """Request every stream at its rate, and the end of the unwanted ones."""
        self._refused_streams = []
        self._is_requesting = True
        intervals = [(name, number, 1e6 / hz) for name, number, hz, _ in self._profile.streams]
        intervals += [(f"-{number}", number, -1.0) for number in self._profile.unwanted_streams]
        for name, number, interval_us in intervals:
            entry = command_long(
                self._system_id,
                CommandKind.REQUEST,
                name,
                mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                (float(number), interval_us),
                lane=STREAM_LANE,
            )
            self._commands.enqueue_and_send_if_first(entry, t_s)

    def cancel(self) -> None:
        """Report nothing about the present requests."""
        self._is_requesting = False

    def remove_and_store_refusals(self, events: list[Event]) -> list[Event]:
        """Store refusals of streams; return the other events."""
        passed: list[Event] = []
        for event in events:
            if isinstance(event, MessageRequestRefused):
                self._refused_streams.append(event.message_name)
            else:
                passed.append(event)
        return passed

    def take_ended_events(self, t_s: float) -> list[Event]:
        """Return one report when all requests have ended."""
        if not self._is_requesting or self._commands.has_pending(STREAM_LANE):
            return []
        self._is_requesting = False
        required = {name for name, _, _, is_required in self._profile.streams if is_required}
        return [StreamsConfigured(t_s, tuple(n for n in self._refused_streams if n in required))]


class AutopilotSession:
    """Executes orders and reads messages of one autopilot, from its identification to the end of
    the process. Discarding all requests keeps the parameters and positions that were received.
    """

    def __init__(
        self,
        send: Callable[[Any], None],
        clock: AutopilotClock,
        profile: AutopilotProfile,
        system_id: int,
        discard_unsent: Callable[[], None],
    ) -> None:
        self._send = send
        self._discard_unsent = discard_unsent
        self._clock = clock
        self.profile = profile
        self.system_id = system_id
        self._commands = CommandQueue(send, discard_unsent)
        self._streams = StreamRequests(self._commands, profile, system_id)
        self._parameters = ParameterClient(send, system_id, bytewise=profile.bytewise_parameters)
        self._missions = MissionClient(send, system_id, profile)

    @property
    def estimates_wind(self) -> bool | None:
        """Whether the autopilot measures the wind itself; `None`: its parameters are not known."""
        values, names = self._parameters.values, self.profile.trust_parameters
        return any(values[n] for n in names) if all(n in values for n in names) else None

    def on_message(self, message: Any, t_s: float) -> list[Event]:
        """Return the events in a message of the autopilot."""
        response_events = self._process_request_response(message, t_s)
        if response_events is not None:
            return response_events
        found = events_from_message(message, self.profile, self._parameters.values, t_s)
        ended: list[Event] = []
        for event in found:
            ended += self._end_requests_by_telemetry(event, t_s)
        return found + ended

    def _end_requests_by_telemetry(self, event: Event, t_s: float) -> list[Event]:
        """End what a telemetry event shows as effective, or as void after a newer decision."""
        ended = self._commands.end_commands_by_telemetry(event, t_s)
        match event:
            case MissionProgress():
                ended += self._discard_unsent_if_any(self._missions.end_upload_if_id_changed(event))
            case Position():
                self._missions.record_first_position(event)
            case VehicleState():
                self._parameters.record_armed_state(armed=event.armed)
                ended += self._parameters.take_ended_events(t_s)
            case _:
                pass
        return ended

    def _discard_unsent_if_any(self, void_events: list[Event]) -> list[Event]:
        if void_events:
            self._discard_unsent()
        return void_events

    def _process_request_response(self, message: Any, t_s: float) -> list[Event] | None:
        """Process responses to requests of this companion; return `None` for all other messages."""
        kind, parameters = message.get_type(), self._parameters
        is_addressed_here = getattr(message, "target_system", 0) in (0, self.system_id) and getattr(
            message, "target_component", 0
        ) in (0, COMPONENT)
        match kind:
            case "AUTOPILOT_VERSION":
                return [BoardIdReceived(t_s, _board_serial(message))]
            case "PARAM_VALUE":
                parameters.process_param_value(message, t_s)
                return parameters.take_ended_events(t_s)
            case "MISSION_ACK" if not is_addressed_here and _is_mission_write_accepted(message):
                writer = f"{message.target_system}/{message.target_component}"
                written = MissionWriteDetected(t_s, f"{writer} wrote the mission")
                ended = self._discard_unsent_if_any(self._missions.end_upload_written_by_other(t_s))
                return [written, *self._end_requests_by_telemetry(written, t_s), *ended]
            case "COMMAND_ACK" if not is_addressed_here and _is_mode_command_accepted(message):
                selected = OtherStationModeCommand(t_s)
                return [selected, *self._end_requests_by_telemetry(selected, t_s)]
            case "COMMAND_ACK" | "PARAM_ERROR" if not is_addressed_here:
                return []
            case "COMMAND_ACK":
                return self._streams.remove_and_store_refusals(
                    self._commands.process_command_ack(message, t_s)
                )
            case "PARAM_ERROR":
                parameters.process_param_error(message, t_s)
                return parameters.take_ended_events(t_s)
            case _ if kind in MISSION_MESSAGES:
                return self._missions.on_message(message, t_s) if is_addressed_here else []
            case _:
                return None

    def execute(self, order: Order, t_s: float) -> None:
        """Execute an order of the core."""
        match order:
            case RequestTelemetry():
                self._streams.request_all(t_s)
            case RequestParameters():  # and those that indicate which telemetry is measured
                names = dict.fromkeys((*order.names, *self.profile.trust_parameters))
                self._parameters.request_values(names, t_s)
            case SetParameters():
                self._parameters.start_setting_values(order.values, t_s)
            case UploadMission() | ClearMission() | VerifyMission():
                self._missions.start_transfer(order, t_s)
            case FlyVelocity():
                boot_ms = self._clock.autopilot_time_since_boot_ms
                self._send(velocity_message(order, self.system_id, boot_ms))
            case _:
                entry = command_of_order(order, self.profile, self.system_id)
                self._commands.enqueue_and_send_if_first(entry, t_s)

    def discard_all_pending_requests(self) -> None:
        """Discard all commands, transfers and requests in progress."""
        self._commands.discard_all(self._clock.t_s)
        self._streams.cancel()
        self._parameters.cancel_all()
        self._missions.cancel()

    def tick(self, t_s: float) -> list[Event]:
        """Retry what is due and return the events of what ended."""
        events = self._streams.remove_and_store_refusals(self._commands.tick(t_s))
        events += self._streams.take_ended_events(t_s)
        events += self._missions.tick(t_s)
        self._parameters.tick(t_s)
        return events + self._parameters.take_ended_events(t_s)


def _board_serial(message: Any) -> str:
    """Return the board's serial number; "" if it has none, like simulators."""
    long = bytes(message.uid2).hex()
    short = f"{message.uid:016x}"
    return next((number for number in (long, short) if number.strip("0")), "")


def _is_mission_write_accepted(message: Any) -> bool:
    """MISSION_ACK ends an upload or a clearing; a download ends with the station's own."""
    accepted = message.type == mavlink.MAV_MISSION_ACCEPTED
    return accepted and message.mission_type == mavlink.MAV_MISSION_TYPE_MISSION


def _is_mode_command_accepted(message: Any) -> bool:
    accepted = message.result == mavlink.MAV_RESULT_ACCEPTED
    return accepted and message.command == mavlink.MAV_CMD_DO_SET_MODE
