"""Communication with an autopilot outside a flight: heartbeats, TIMESYNC, telemetry, requests."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from companion.adapters.autopilots.codec import (
    MavlinkCodec,
    heartbeat_message,
    mavlink,
    timesync_response_message,
)
from companion.adapters.autopilots.link import Link
from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.clock import AutopilotClock, is_due, wall_s
from companion.core.mission.events import ClockSteppedBack, Event
from companion.core.pilot.telemetry_state import TelemetryState

WAIT_S = 0.1
HEARTBEAT_S = 1.0


@dataclass(slots=True)
class AutopilotClient:
    """Receives from one autopilot on a link, and stores its telemetry.

    Replies go to the peer of the accepted autopilot, and only its TIMESYNC requests set the clock
    and are answered.
    """

    link: Link
    codec: MavlinkCodec
    system_id: int | None = None
    """The system to accept; `None`: the first that is identified."""
    now_s: Callable[[], float] = wall_s
    clock: AutopilotClock = field(default_factory=AutopilotClock)
    telemetry: TelemetryState = field(default_factory=TelemetryState)
    observe: Callable[[Any], None] = lambda _: None
    """Called with each message of an accepted autopilot."""
    port: AutopilotPort = field(init=False)
    received_s: float = field(init=False)
    """Time of the last message of the autopilot, at first of the start."""
    _heartbeat_s: float | None = None

    def __post_init__(self) -> None:
        self.port = AutopilotPort(self.send, self.clock, self.system_id)
        self.received_s = self.now_s()

    def send(self, message: Any) -> None:
        """Send one message."""
        self.link.send(self.codec.pack(message))

    def receive_events(self) -> list[Event]:
        """Send a standby heartbeat if due, which does not affect another companion; receive."""
        now_s = self.now_s()
        if is_due(self._heartbeat_s, HEARTBEAT_S, now_s):
            self._heartbeat_s = now_s
            self.send(heartbeat_message(mavlink.MAV_STATE_STANDBY))
        events: list[Event] = []
        if (incoming := self.link.receive(WAIT_S)) is not None:
            for message in self.codec.parse_valid_messages(incoming.data):
                events += self._process_message(message, incoming.peer)
        return events

    def _process_message(self, message: Any, peer: Any) -> list[Event]:
        from_autopilot = self.port.is_from_accepted_autopilot(message)
        if from_autopilot:
            self.link.set_reply_peer(peer)
            self.received_s = self.now_s()
            self.observe(message)
        if message.get_type() == "TIMESYNC":
            if message.tc1 != 0:
                self.port.update_clock_from_timesync_response(message)
            elif from_autopilot:
                self.clock.update_from_sync_time(message.ts1 / 1e9)
                self.send(timesync_response_message(self.clock.t_s, message.ts1))
            return []
        events = self.port.on_message(message)
        for event in events:
            if isinstance(event, ClockSteppedBack):
                self.telemetry.clear_samples()
            self.telemetry.store_event(event)
        if self.port.system_id is not None:
            self.codec.set_source_system_id(self.port.system_id)
        return events
