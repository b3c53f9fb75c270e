"""MAVLink commands to the autopilot: sent until acknowledged, confirmed by telemetry or abandoned.

Times are on the autopilot's clock.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, mavlink
from companion.core.mission.command_life_cycle import (
    CommandKind,
    NewerDecision,
    NewerDecisionMonitor,
    reported_values,
)
from companion.core.mission.events import (
    Event,
    MessageRequestRefused,
    Mode,
    OrderAccepted,
    OrderRefused,
)

REJECTED_RETRY_S = 1.0
IN_PROGRESS_WAIT_S = 5.0

LATE_ACK_S = 1.0
"""How late acknowledgements of repetitions may follow the first one. A busy autopilot processes a
doubled command at once, so both COMMAND_ACKs come together (PX4 1.18 at first contact).
"""

NO_RESPONSE = "no answer"

RESULT_TEXT = {
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "unsupported",
    mavlink.MAV_RESULT_FAILED: "failed",
    6: "cancelled",  # MAV_RESULT_CANCELLED, newer than the dialect
}


MAX_RESPONSE_S = 4.0
"""Longest assumed response time: a measured one may contain lost messages and their repetitions."""


class ResponseTime:
    """Round-trip time from a message to its response; a limit for repetitions."""

    def __init__(self) -> None:
        self._measured_s = 0.0

    @property
    def response_timeout_s(self) -> float:
        """Before this time a response may still be in transit."""
        timeout_s = 1.1 * self._measured_s + 0.2
        return min(timeout_s, MAX_RESPONSE_S) if self._measured_s > 0.0 else 0.0

    def store_response_time(
        self, sent_s: float, received_s: float, *, is_repeated: bool = False
    ) -> None:
        """Store the newest response time since the first transmission.

        That of a repeated message, whose first transmission may be lost, only shortens it.
        """
        time_s = max(0.0, received_s - sent_s)
        if is_repeated and self._measured_s > 0.0:
            time_s = min(time_s, self._measured_s)
        self._measured_s = time_s


@dataclass(slots=True)
class PendingCommand:
    """A command in progress in a lane. `build_message(attempt)` builds the message.

    It ends with the COMMAND_ACK of `command`, or with telemetry for which `confirms` is true: a
    COMMAND_ACK may be lost, and PX4 acknowledges no jump. Its kind's row in the table states how
    often it is repeated, and which newer decision ends it. `mode`: the mode that it sets.
    """

    kind: CommandKind
    name: str
    build_message: Callable[[int], Any]
    command: int | None = None
    confirms: Callable[[Event], bool] = lambda _event: False
    mode: Mode | None = None
    lane: str = ""
    newer_decisions: NewerDecisionMonitor = field(init=False)
    attempt_count: int = 0
    ack_count: int = 0
    next_try_s: float = 0.0

    def __post_init__(self) -> None:
        self.newer_decisions = NewerDecisionMonitor(self.kind.value)
        self.lane = self.lane or self.kind.value.lane

    @property
    def has_tries_left(self) -> bool:
        """Whether its row permits a further transmission."""
        return self.attempt_count < self.kind.value.adapter_tries

    @property
    def retry_delay_s(self) -> float:
        """The time to wait after the newest transmission."""
        row = self.kind.value
        timeout_s = 0.0 if self.has_tries_left else row.adapter_timeout_s
        return max(row.interval_s, timeout_s)

    @property
    def outstanding_acks(self) -> int:
        """The number of COMMAND_ACKs for this command that may still arrive."""
        return self.attempt_count - self.ack_count if self.command is not None else 0


def command_long(
    system_id: int,
    kind: CommandKind,
    name: str,
    command: int,
    params: tuple[float, ...],
    **options: Any,
) -> PendingCommand:
    """Return a COMMAND_LONG in progress; `options` are further fields of `PendingCommand`."""
    full = (*params, *([0.0] * (7 - len(params))))

    def build_message(attempt: int) -> Any:
        return mavlink.MAVLink_command_long_message(system_id, AUTOPILOT, command, attempt, *full)

    return PendingCommand(kind, name, build_message, command, **options)


@dataclass(slots=True)
class _LateAcks:
    """Acknowledgements due to ended commands; they must not be counted for the next command."""

    ack_count: int
    until_s: float


@dataclass(slots=True)
class CommandQueue:
    """Commands in lanes: sequential within a lane, lanes in parallel.

    A COMMAND_ACK names the command only: two requests with the same command in succession (for two
    streams) are distinguished by counting transmissions and acknowledgements.
    """

    send: Callable[[Any], None]
    discard_unsent: Callable[[], None] = lambda: None
    """Discards the messages that are encoded and have not left."""
    _lanes: dict[str, list[PendingCommand]] = field(default_factory=dict)
    _late_acks: dict[int, _LateAcks] = field(default_factory=dict)
    _reported: dict[NewerDecision, Hashable] = field(default_factory=dict)
    """Latest reported state that each kind of decision changes."""

    def enqueue_and_send_if_first(self, entry: PendingCommand, t_s: float) -> None:
        """Queue a command in its lane."""
        queued = self._lanes.setdefault(entry.lane, [])
        entry.newer_decisions.before = {
            decision: value
            for decision, value in self._reported.items()
            if decision not in (NewerDecision.MISSION, NewerDecision.HOME)
        }
        if entry.kind.value.supersedes:
            self.discard_lane(entry.lane, t_s)
        queued.append(entry)
        if len(queued) == 1:
            self._send_attempt(entry, t_s)

    def discard_all(self, t_s: float) -> None:
        """Discard all commands: nothing more is sent or retried."""
        for lane in self._lanes:
            self.discard_lane(lane, t_s)

    def discard_lane(self, lane: str, t_s: float) -> None:
        """Discard the commands of a lane."""
        queued = self._lanes.get(lane)
        if queued:
            self._record_expected_late_acks(queued[0], t_s)
            queued.clear()

    def has_pending(self, lane: str) -> bool:
        """Return True while a lane holds a command."""
        return bool(self._lanes.get(lane))

    def process_command_ack(self, message: Any, t_s: float) -> list[Event]:
        """Process a COMMAND_ACK that is addressed to the companion (or broadcast)."""
        if message.result != mavlink.MAV_RESULT_IN_PROGRESS and self._record_if_late_ack(
            message.command, t_s
        ):
            return []
        for lane, queued in self._lanes.items():
            if not queued or queued[0].command != message.command or queued[0].attempt_count == 0:
                continue
            entry = queued[0]
            if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
                entry.next_try_s = t_s + IN_PROGRESS_WAIT_S
                return []
            entry.ack_count += 1
            match message.result:
                case mavlink.MAV_RESULT_ACCEPTED:
                    return self._end_command_and_send_next(lane, t_s, None)
                case mavlink.MAV_RESULT_TEMPORARILY_REJECTED if entry.has_tries_left:
                    entry.next_try_s = t_s + REJECTED_RETRY_S
                    return []
                case _:
                    reason = RESULT_TEXT.get(message.result, f"result {message.result}")
                    return self._end_command_and_send_next(lane, t_s, reason)
        return []

    def end_commands_by_telemetry(self, event: Event, t_s: float) -> list[Event]:
        """Process a telemetry event; end the commands that it confirms or whose newer decision it
        reports.
        """
        ended: list[Event] = []
        for lane, queued in self._lanes.items():
            if queued and queued[0].confirms(event):
                ended += self._end_command_and_send_next(lane, t_s, None)
            elif any(entry.newer_decisions.is_void_after(event) for entry in queued):
                self.discard_lane(lane, t_s)
                self.discard_unsent()
        self._reported.update(reported_values(event))
        return ended

    def tick(self, t_s: float) -> list[Event]:
        """Retry commands that are due; abandon those without a retry left."""
        events: list[Event] = []
        for lane, queued in list(self._lanes.items()):
            entry = queued[0] if queued else None
            if entry is None or t_s < entry.next_try_s:
                continue
            if entry.has_tries_left:
                self._send_attempt(entry, t_s)
            else:
                events += self._end_command_and_send_next(lane, t_s, NO_RESPONSE)
        return events

    def _send_attempt(self, entry: PendingCommand, t_s: float) -> None:
        self.send(entry.build_message(entry.attempt_count))
        entry.attempt_count += 1
        entry.next_try_s = t_s + entry.retry_delay_s

    def _record_expected_late_acks(self, entry: PendingCommand, t_s: float) -> None:
        """Expect the acknowledgements that an ended or discarded command may still get."""
        if entry.command is None or entry.outstanding_acks <= 0:
            return
        late = self._late_acks.setdefault(entry.command, _LateAcks(0, t_s))
        late.ack_count += entry.outstanding_acks
        late.until_s = t_s + LATE_ACK_S

    def _record_if_late_ack(self, command: int, t_s: float) -> bool:
        """Count an acknowledgement of an ended command; after the last, send the next command."""
        late = self._late_acks.get(command)
        if late is None:
            return False
        if t_s > late.until_s:
            del self._late_acks[command]
            return False
        late.ack_count -= 1
        if late.ack_count <= 0:
            del self._late_acks[command]
            for queued in self._lanes.values():
                if queued and queued[0].command == command and queued[0].attempt_count == 0:
                    self._send_attempt(queued[0], t_s)
        return True

    def _end_command_and_send_next(
        self, lane: str, t_s: float, failure_reason: str | None
    ) -> list[Event]:
        queued = self._lanes[lane]
        entry = queued.pop(0)
        self._record_expected_late_acks(entry, t_s)
        if queued:
            late = self._late_acks.get(queued[0].command) if queued[0].command is not None else None
            if late is None or t_s > late.until_s:
                self._send_attempt(queued[0], t_s)
            else:  # sent now, its acknowledgement could be mistaken for a late one
                queued[0].next_try_s = late.until_s
        if entry.kind is CommandKind.REQUEST:
            return [] if failure_reason is None else [MessageRequestRefused(t_s, entry.name)]
        if failure_reason is None:
            return [OrderAccepted(t_s, entry.name)]
        is_response = failure_reason != NO_RESPONSE
        return [OrderRefused(t_s, entry.name, failure_reason, is_response, entry.mode)]
