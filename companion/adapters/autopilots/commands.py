"""MAVLink commands to the autopilot: sent until acknowledged or seen to be obeyed, or given up.

Times are on the autopilot's clock.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from companion.adapters.autopilots.codec import mavlink
from companion.core.mission.events import Event, OrderAccepted, OrderRefused

RETRY_S = 1.0
BUSY_S = 1.0
TRIES = 4

ANSWER_S = 1.0
"""How long the last repetition waits for its answer before the order is given up."""

EVIDENCE_S = 0.3
"""A report of the unchanged state permits a repetition for so long. An older one permits none: a
person may have decided otherwise since (a person needs 0.2 s and more to select a mode or item).
"""

SILENT_S = 3.0
"""An order that may not be repeated for want of a report ends after so long."""

STALE_S = 1.0
"""How long the answers to repetitions may trail the first answer. A busy autopilot works off a
doubled order in one go, so both COMMAND_ACKs come together (seen on PX4 1.18 at first contact).
"""

NO_ANSWER = "no answer"

RESULT = {
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "unsupported",
    mavlink.MAV_RESULT_FAILED: "failed",
    6: "cancelled",  # MAV_RESULT_CANCELLED, younger than the dialect
}


@dataclass(slots=True)
class PendingCommand:
    """One order on its way. `make(attempt)` builds the message.

    It ends with COMMAND_ACK of `command`, or with telemetry that `shows` its effect: an answer may
    be lost, and PX4 acknowledges no jump. `again_s` is how long it waits before it is sent again,
    `most_tries` how often it is sent, `answer_s` how long the last one waits.

    `unchanged`: a report that shows the state as it was at the order. With it, only a recent one
    permits a repetition. `superseded`: a report that shows a newer decision; the order ends.
    """

    name: str
    make: Callable[[int], Any]
    command: int | None = None
    shows: Callable[[Event], bool] | None = None
    unchanged: Callable[[Event], bool] | None = None
    superseded: Callable[[Event], bool] | None = None
    quiet: bool = False
    again_s: float = RETRY_S
    most_tries: int = TRIES
    answer_s: float = ANSWER_S
    tries: int = 0
    answers: int = 0
    next_try_s: float = 0.0
    unchanged_s: float = -math.inf
    """Time of the newest report that shows the state unchanged."""

    def may_repeat(self, t_s: float) -> bool:
        """Tell whether the state is known to be unchanged now."""
        return self.unchanged is None or t_s - self.unchanged_s <= EVIDENCE_S

    @property
    def waits_s(self) -> float:
        """How long to wait after the newest try."""
        return self.again_s if self.tries < self.most_tries else max(self.again_s, self.answer_s)

    @property
    def unanswered(self) -> int:
        """How many COMMAND_ACKs of it may still come."""
        return self.tries - self.answers if self.command is not None else 0


@dataclass(slots=True)
class _LateAnswers:
    """Answers that belong to orders which are over; they must not be booked to the next one."""

    answers: int
    until_s: float


@dataclass(slots=True)
class CommandQueue:
    """Orders in lanes: within a lane one after the other, lanes beside each other.

    A COMMAND_ACK names the command and not the order: two orders with the same command in a row
    (one stream and the next) are told apart by counting what was sent and what was answered.
    """

    send: Callable[[Any], None]
    _lanes: dict[str, list[PendingCommand]] = field(default_factory=dict)
    _late_answers: dict[int, _LateAnswers] = field(default_factory=dict)

    def submit(
        self, lane: str, entry: PendingCommand, t_s: float, *, replace: bool = False
    ) -> None:
        """Queue an order; `replace` forgets what the lane still holds (a newer wish)."""
        queued = self._lanes.setdefault(lane, [])
        if replace:
            self.drop(lane, t_s)
        queued.append(entry)
        if len(queued) == 1:
            self._try(entry, t_s)

    def clear(self, t_s: float) -> None:
        """Forget everything: nothing more is sent or retried."""
        for lane in self._lanes:
            self.drop(lane, t_s)

    def drop(self, lane: str, t_s: float) -> None:
        """Forget what a lane holds."""
        queued = self._lanes.get(lane)
        if queued:
            self._expect_late_answers(queued[0], t_s)
            queued.clear()

    def pending(self, lane: str) -> bool:
        """Tell whether a lane still works on something."""
        return bool(self._lanes.get(lane))

    def on_ack(self, message: Any, t_s: float) -> list[Event]:
        """Take a COMMAND_ACK that is addressed to us (or to everybody)."""
        if message.result != mavlink.MAV_RESULT_IN_PROGRESS and self._is_late_answer(
            message.command, t_s
        ):
            return []
        for lane, queued in self._lanes.items():
            if not queued or queued[0].command != message.command or queued[0].tries == 0:
                continue
            entry = queued[0]
            if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
                entry.next_try_s = t_s + 5.0 * RETRY_S
                return []
            entry.answers += 1
            match message.result:
                case mavlink.MAV_RESULT_ACCEPTED:
                    return self._finish(lane, t_s, None)
                case mavlink.MAV_RESULT_TEMPORARILY_REJECTED if entry.tries < entry.most_tries:
                    entry.next_try_s = t_s + BUSY_S
                    return []
                case _:
                    reason = RESULT.get(message.result, f"result {message.result}")
                    return self._finish(lane, t_s, reason)
        return []

    def on_telemetry(self, event: Event, t_s: float) -> list[Event]:
        """Take a telemetry event: ends the order whose effect, or whose successor, it shows."""
        for lane, queued in self._lanes.items():
            if queued and queued[0].shows is not None and queued[0].shows(event):
                return self._finish(lane, t_s, None)
            if queued and queued[0].superseded is not None and queued[0].superseded(event):
                self.drop(lane, t_s)
            elif queued and queued[0].unchanged is not None and queued[0].unchanged(event):
                queued[0].unchanged_s = t_s
        return []

    def tick(self, t_s: float) -> list[Event]:
        """Retry what is due; give up what was tried often enough."""
        events: list[Event] = []
        for lane, queued in list(self._lanes.items()):
            entry = queued[0] if queued else None
            if entry is None or t_s < entry.next_try_s:
                continue
            last = entry.tries >= entry.most_tries
            if not last and entry.may_repeat(t_s):
                self._try(entry, t_s)
            elif last or t_s >= entry.next_try_s + SILENT_S:
                events += self._finish(lane, t_s, NO_ANSWER)
        return events

    def _try(self, entry: PendingCommand, t_s: float) -> None:
        self.send(entry.make(entry.tries))
        entry.tries += 1
        entry.next_try_s = t_s + entry.waits_s

    def _expect_late_answers(self, entry: PendingCommand, t_s: float) -> None:
        """Expect the answers that a finished or forgotten order may still get."""
        if entry.command is None or entry.unanswered <= 0:
            return
        late = self._late_answers.setdefault(entry.command, _LateAnswers(0, t_s))
        late.answers += entry.unanswered
        late.until_s = t_s + STALE_S

    def _is_late_answer(self, command: int, t_s: float) -> bool:
        """Book an answer to an order that is over; the order that waited for it may go then."""
        late = self._late_answers.get(command)
        if late is None:
            return False
        if t_s > late.until_s:
            del self._late_answers[command]
            return False
        late.answers -= 1
        if late.answers <= 0:
            del self._late_answers[command]
            for queued in self._lanes.values():
                if queued and queued[0].command == command and queued[0].tries == 0:
                    self._try(queued[0], t_s)
        return True

    def _finish(self, lane: str, t_s: float, reason: str | None) -> list[Event]:
        queued = self._lanes[lane]
        entry = queued.pop(0)
        self._expect_late_answers(entry, t_s)
        if queued:
            late = (
                self._late_answers.get(queued[0].command) if queued[0].command is not None else None
            )
            if late is None or t_s > late.until_s:
                self._try(queued[0], t_s)
            else:  # sent beside late answers to the last one it could not be told from that
                queued[0].next_try_s = late.until_s
        if entry.quiet and reason is None:
            return []
        if reason is None:
            return [OrderAccepted(t_s, entry.name)]
        return [OrderRefused(t_s, entry.name, reason, answered=reason != NO_ANSWER)]
