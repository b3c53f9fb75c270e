"""Other onboard computers in the vehicle's MAVLink system: a payload and a second companion."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from sim_bridge.adapters.endpoint import EndpointSet, bundle_frames
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.app.faults.verdict import EXIT_USAGE_ERROR
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.world.station import Station
from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

SECOND_LINK = 3
BOOT_LIMIT_S = 60.0
REPLY_LIMIT_S = 20.0
PAYLOAD_COMPONENT = 192
ONBOARD_CONTROLLER, NO_AUTOPILOT, STATE_ACTIVE = 18, 8, 4
AUTO_ENABLED = 4


def connect_payload_computer(stage: FaultContext) -> Station:
    """Connect component 192 of the vehicle's system on a separate link."""
    return Station(stage.craft.link, (stage.craft.number, PAYLOAD_COMPONENT), LinkKind.ONBOARD)


def expect_payload_heartbeats(stage: FaultContext) -> None:
    """Require that the companion receives messages of component 192."""
    sender, counts = (stage.craft.number, PAYLOAD_COMPONENT), stage.tap.sender_counts
    stage.expect_change("component 192 is received", lambda: counts[sender])


def send_onboard_computer_heartbeat(
    station: Station, *, control_since_s: float | None = None
) -> None:
    """Send its heartbeat. With `control_since_s` it claims control of the flight since that
    time.
    """
    claims_control = control_since_s is not None
    station.send_to_autopilot(
        Message(
            "HEARTBEAT",
            type=ONBOARD_CONTROLLER,
            autopilot=NO_AUTOPILOT,
            base_mode=AUTO_ENABLED if claims_control else 0,
            custom_mode=round((control_since_s or 0.0) * 1000.0),
            system_status=STATE_ACTIVE,
            mavlink_version=3,
        )
    )


@dataclass(slots=True)
class SecondCompanion:
    """A second companion process on a separate link, in lockstep like the first."""

    stage: FaultContext
    run_dir: Path
    process: CompanionProcess = field(init=False)
    has_replied: bool = False
    """Whether it has sent a datagram."""
    has_claimed_control: bool = False
    """Whether one of its heartbeats has claimed control."""
    _endpoints: EndpointSet = field(init=False)
    _lockstep: Lockstep = field(init=False)
    _frames: list[bytes] = field(default_factory=list)
    _time_encoder: Encoder = field(init=False)

    def __post_init__(self) -> None:
        craft, ends = self.stage.craft, self.stage.resources
        self._time_encoder = Encoder(craft.number, 1)
        self._endpoints = ends.enter_context(EndpointSet(["udpin:127.0.0.1:0"]))
        port = self._endpoints.urls[0].rsplit(":", 1)[1]
        others = [a for a in craft.companion.arguments if not a.startswith("--link=")]
        arguments = [f"--link=udpout:127.0.0.1:{port}", *others]
        self.process = CompanionProcess(
            self.run_dir, arguments, fork_server=craft.companion.fork_server
        )
        self._lockstep = Lockstep(
            self._endpoints,
            range(1),
            lambda _, t_ns: self._take_pending_datagrams_with_timesync(t_ns),
            limit_s=REPLY_LIMIT_S,
            is_alive=lambda _: self.process.is_running,
        )
        craft.autopilot.add_link(SECOND_LINK, LinkKind.ONBOARD)
        craft.link.listeners[SECOND_LINK] = lambda _, frame: self._frames.append(frame)
        ends.callback(self.process.terminate_or_kill)

    def start_and_wait_for_connection(self) -> None:
        """Start the process. Simulated time waits until it is up or has ended."""
        self.process.start()
        gathered = self._lockstep.wait_until_clients_respond(self._simulated_time_ns, BOOT_LIMIT_S)
        self._deliver_to_autopilot(gathered.received)

    def exchange_messages_once(self) -> None:
        """Run one exchange of 0.1 s."""
        if self.process.is_running:
            self._deliver_to_autopilot(
                self._lockstep.exchange_one_step(self._simulated_time_ns).received
            )

    @property
    def _simulated_time_ns(self) -> int:
        return max(1, round(self.stage.t_s * 1e9))

    def _take_pending_datagrams_with_timesync(self, t_ns: int) -> list[bytes]:
        frames, self._frames = self._frames, []
        request = self._time_encoder.encode_next_frame(Message("TIMESYNC", tc1=0, ts1=t_ns))
        return [*bundle_frames(frames), request]

    def _deliver_to_autopilot(self, received: list[tuple[int, bytes]]) -> None:
        for _, datagram in received:
            self.has_replied = True
            self.has_claimed_control |= any(
                message.msg_name == "HEARTBEAT" and bool(message.base_mode & AUTO_ENABLED)
                for message in Decoder().decode_bytes(datagram)
            )
            self.stage.craft.autopilot.process_received_datagram(SECOND_LINK, datagram)


def copy_run_dir_to_sibling(run_dir: Path) -> Path:
    """Copy a run folder to a sibling folder, as after an SD card is moved to another computer."""
    copy = run_dir.with_name(f"{run_dir.name}-second")
    shutil.copytree(run_dir, copy, ignore=shutil.ignore_patterns("lock", "companion.out"))
    return copy


SECOND_REFUSED_NOTE = "refused"
STALL_FOR_SECOND_S = 15.0
"""Time for a second companion to find the vehicle, read its mission and continue the flight."""


def run_second_companion_while_first_stalls(
    run_dir_for_second: Callable[[Path], Path],
    *,
    second_resumes_flight: bool = False,
    second_is_refused: bool = False,
) -> FaultProcedure:
    """Return a procedure: the companion is stopped, a second one starts, then the first resumes."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        stage.stall_companion()
        second = SecondCompanion(stage, run_dir_for_second(stage.craft.run_dir))
        if second_is_refused:
            stage.expect_effect(
                "the second companion is refused",
                lambda: second.process.exit_code == EXIT_USAGE_ERROR,
            )
        else:
            stage.expect_effect("the second companion replies", lambda: second.has_replied)
        if second_resumes_flight:
            stage.expect_effect("the second claims control", lambda: second.has_claimed_control)
        second.start_and_wait_for_connection()
        resume_at_s = stage.t_s + STALL_FOR_SECOND_S
        while stage.t_s < resume_at_s:
            if second.process.is_running:
                second.exchange_messages_once()
            yield
        if second.process.exit_code == EXIT_USAGE_ERROR:
            stage.notes.append(SECOND_REFUSED_NOTE)
        if second_resumes_flight and second.has_claimed_control:
            stage.record_take_over(0.0)
        stage.resume_companion()
        while second.process.is_running:
            yield
            second.exchange_messages_once()

    return procedure
