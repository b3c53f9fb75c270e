"""MAVLink link between a simulated autopilot and its companion, with link faults.

All vehicles with a companion use it, in flights, days and trials. It also distributes the frames
for other ground stations, which leave the autopilot at the same time.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from sim_bridge.adapters.endpoint import bundle_frames
from sim_bridge.app.link.bad_link import FaultyLink
from sim_bridge.app.link.forger import Forger
from sim_bridge.app.link.tap import Tap
from sim_bridge.app.world.safety_rules import SentCommand, TakeOver, format_sent_command
from sim_bridge.app.world.vehicle_host import VehicleHost
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

COMPANION_LINK, OPERATOR_LINK = 0, 1
COMMAND_MESSAGES = {  # messages that change the flight, unlike telemetry and requests
    "COMMAND_LONG",
    "COMMAND_INT",
    "SET_MODE",
    "MISSION_COUNT",
    "MISSION_ITEM_INT",
    "MISSION_SET_CURRENT",
    "MISSION_CLEAR_ALL",
    "MISSION_WRITE_PARTIAL_LIST",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ATTITUDE_TARGET",
    "RC_CHANNELS_OVERRIDE",
    "MANUAL_CONTROL",
    "PARAM_SET",
}
REQUEST_COMMANDS = {410, 511, 512, 519, 520, 521}
"""Commands that request messages and intervals."""

MAV_RESULT_FAILED = 4


@dataclass(slots=True)
class CompanionLink:
    """One vehicle's link to its companion. Times are seconds since power-up."""

    host: VehicleHost
    system_id: int
    listeners: dict[int, Callable[[float, bytes], object]] = field(default_factory=dict)
    """Receivers of frames for other ground stations, by link number."""
    silent_until_s: float = -1.0
    bad_link: FaultyLink | None = None
    forger: Forger | None = None
    taps: list[Tap] = field(default_factory=list)
    draw_frame_loss: Callable[[], bool] | None = None
    """Draw whether the next frame is lost."""
    refused: frozenset[tuple[str, int]] = frozenset()
    """Messages and commands of the companion that the autopilot refuses."""
    refused_count: int = 0
    lost_count: int = 0
    """Frames to the companion and datagrams of the companion lost by silence or drawn loss."""
    records_commands: bool = True
    commands: list[SentCommand] = field(default_factory=list)
    """Commands of the companion that change the flight."""
    takeover: TakeOver | None = None
    """The last take-over."""
    earlier_takeovers: list[TakeOver] = field(default_factory=list)
    _decoder: Decoder = field(default_factory=Decoder)
    _refusals: list[bytes] = field(default_factory=list)

    @property
    def late_commands(self) -> list[SentCommand]:
        """Commands that the companion sent although it could know of a take-over, which lasts to
        the operator's next command to the companion.
        """
        takeovers = [*self.earlier_takeovers, *([self.takeover] if self.takeover else [])]
        late = (takeover.find_late_commands(self.commands) for takeover in takeovers)
        return sorted(set().union(*late))

    def record_take_over(self, t_s: float, known_after_s: float) -> None:
        """Record a take-over at `t_s`, which the companion can know of after `known_after_s`."""
        if self.takeover is not None:
            self.earlier_takeovers.append(self.takeover)
        self.takeover = TakeOver(t_s)
        self.takeover.record_known(t_s, known_after_s)

    def record_hand_back(self) -> None:
        """Record a command to the companion, which ends the present take-over."""
        if self.takeover is not None:
            self.takeover.ended_s = min(self.takeover.ended_s, self.host.t_s)

    @property
    def late_commands_text(self) -> str:
        """Number and first of `late_commands`, empty if there are none."""
        late = self.late_commands
        return (
            f"{len(late)} commands after the take-over, {format_sent_command(late[0])}"
            if late
            else ""
        )

    @property
    def is_up(self) -> bool:
        """False while the link is silent."""
        return self.host.t_s >= self.silent_until_s

    def take_datagrams_for_companion(self, timesync_ns: int) -> list[bytes]:
        """Return datagrams for the companion: the autopilot's frames, then TIMESYNC of
        `timesync_ns`.

        A silent link still carries TIMESYNC, which drives the lockstep and is not telemetry.
        """
        frames = [*self._distribute_and_take_companion_frames(), *self._refusals]
        self._refusals = []
        for tap in self.taps:
            frames = tap.transmit_to_companion(frames, self.host.t_s)
        sent_count = len(frames)
        if self.draw_frame_loss is not None:
            frames = [frame for frame in frames if not self.draw_frame_loss()]
        frames = frames if self.is_up else []
        self.lost_count += sent_count - len(frames)
        if self.bad_link is not None and self.is_up:
            datagrams = self.bad_link.apply_random_faults_to_exchange(
                frames, self.host.autopilot.time_boot_ms
            )
        else:
            datagrams = bundle_frames(frames)
        if self.forger is not None and self.is_up:
            datagrams += self.forger.forge_to_companion()
        self.host.autopilot.send_timesync_request(COMPANION_LINK, timesync_ns)
        return [*datagrams, *bundle_frames(self._distribute_and_take_companion_frames())]

    def discard_companion_frames(self) -> None:
        """Discard frames for the companion while it is not running; deliver those for others."""
        self._distribute_and_take_companion_frames()

    def _distribute_and_take_companion_frames(self) -> list[bytes]:
        """Return frames for the companion; deliver those for other stations."""
        frames: list[bytes] = []
        for link, frame in self.host.autopilot.take_frames_to_send():
            if link == COMPANION_LINK:
                frames.append(frame)
            elif link in self.listeners:
                self.listeners[link](self.host.t_s, frame)
        return frames

    def pass_datagram_to_autopilot(self, datagram: bytes) -> None:
        """Pass a datagram of the companion to the autopilot."""
        if not self.is_up:
            self.lost_count += 1
            return
        if self.records_commands or self.refused:
            datagram = self._record_commands_and_drop_refused(datagram)
        if self.draw_frame_loss is not None and self.draw_frame_loss():
            self.lost_count += 1
            return
        for tap in self.taps:
            datagram = tap.transmit_to_autopilot(datagram)
        self.host.autopilot.process_received_datagram(COMPANION_LINK, datagram)

    def _record_commands_and_drop_refused(self, datagram: bytes) -> bytes:
        """Record the commands in a datagram; return it without the refused messages."""
        for message in self._decoder.decode_bytes(datagram):
            number = message.__dict__.get("command", 0)
            if message.msg_name in COMMAND_MESSAGES and number not in REQUEST_COMMANDS:
                self.commands.append((self.host.t_s, message.msg_name, number))
            if (message.msg_name, number) in self.refused:
                self.refused_count += 1
                if number:  # other messages (PX4's jump) get no reply
                    ack = Message("COMMAND_ACK", command=number, result=MAV_RESULT_FAILED)
                    self._refusals.append(Encoder(self.system_id, 1).encode_next_frame(ack))
                datagram = datagram.replace(message.wire_bytes, b"")
        return datagram
