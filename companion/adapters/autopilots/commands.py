"""Orders that are acknowledged: sent, retried on the autopilot's clock, answered or given up."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from companion.adapters.autopilots.codec import mavlink
from companion.core.mission.events import Event, OrderAccepted, OrderRefused

RETRY_S = 1.0
BUSY_S = 1.0
TRIES = 4

STALE_S = 1.0
"""How long the answers to repetitions may trail the first answer. A busy autopilot works off a
doubled order in one go, so both COMMAND_ACKs come together (seen on PX4 1.18 at first contact).
"""

RESULT = {
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "unsupported",
    mavlink.MAV_RESULT_FAILED: "failed",
    6: "cancelled",  # MAV_RESULT_CANCELLED, younger than the dialect
}


@dataclass(slots=True)
class Job:
    """One order on its way. `make(attempt)` builds the message.

    It ends with COMMAND_ACK of `command`, or (where the flavour sends none) when the mission's
    current item is `until_seq`. `again_s` is how long it waits before it is sent again.
    """

    name: str
    make: Callable[[int], Any]
    command: int | None = None
    until_seq: int | None = None
    quiet: bool = False
    again_s: float = RETRY_S
    tries: int = 0
    answers: int = 0
    next_try_s: float = 0.0

    @property
    def unanswered(self) -> int:
        """How many COMMAND_ACKs of it may still come."""
        return self.tries - self.answers if self.command is not None else 0


@dataclass(slots=True)
class _Owed:
    """Answers that belong to orders which are over; they must not be booked to the next one."""

    answers: int
    until_s: float


@dataclass(slots=True)
class CommandDesk:
    """Orders in lanes: within a lane one after the other, lanes beside each other.

    A COMMAND_ACK names the command and not the order: two orders with the same command in a row
    (one stream and the next) are told apart by counting what was sent and what was answered.
    """

    send: Callable[[Any], None]
    _lanes: dict[str, list[Job]] = field(default_factory=dict)
    _owed: dict[int, _Owed] = field(default_factory=dict)

    def submit(self, lane: str, job: Job, t_s: float, *, replace: bool = False) -> None:
        """Queue an order; `replace` forgets what the lane still holds (a newer wish)."""
        jobs = self._lanes.setdefault(lane, [])
        if replace and jobs:
            self._owe(jobs[0], t_s)
            jobs.clear()
        jobs.append(job)
        if len(jobs) == 1:
            self._try(job, t_s)

    def clear(self, t_s: float) -> None:
        """Forget everything: nothing more is sent or retried."""
        for jobs in self._lanes.values():
            if jobs:
                self._owe(jobs[0], t_s)
        self._lanes.clear()

    def pending(self, lane: str) -> bool:
        """Tell whether a lane still works on something."""
        return bool(self._lanes.get(lane))

    def hear_ack(self, message: Any, t_s: float) -> list[Event]:
        """Take a COMMAND_ACK that is addressed to us (or to everybody)."""
        if message.result != mavlink.MAV_RESULT_IN_PROGRESS and self._stale(message.command, t_s):
            return []
        for lane, jobs in self._lanes.items():
            if not jobs or jobs[0].command != message.command or jobs[0].tries == 0:
                continue
            job = jobs[0]
            if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
                job.next_try_s = t_s + 5.0 * RETRY_S
                return []
            job.answers += 1
            match message.result:
                case mavlink.MAV_RESULT_ACCEPTED:
                    return self._finish(lane, t_s, None)
                case mavlink.MAV_RESULT_TEMPORARILY_REJECTED if job.tries < TRIES:
                    job.next_try_s = t_s + BUSY_S
                    return []
                case _:
                    reason = RESULT.get(message.result, f"result {message.result}")
                    return self._finish(lane, t_s, reason)
        return []

    def hear_current(self, seq: int, t_s: float) -> list[Event]:
        """Take the mission's current item: ends jumps that nobody acknowledges."""
        for lane, jobs in self._lanes.items():
            if jobs and jobs[0].until_seq == seq:
                return self._finish(lane, t_s, None)
        return []

    def tick(self, t_s: float) -> list[Event]:
        """Retry what is due; give up what was tried often enough."""
        events: list[Event] = []
        for lane, jobs in list(self._lanes.items()):
            if jobs and t_s >= jobs[0].next_try_s:
                if jobs[0].tries >= TRIES:
                    events += self._finish(lane, t_s, "no answer")
                else:
                    self._try(jobs[0], t_s)
        return events

    def _try(self, job: Job, t_s: float) -> None:
        self.send(job.make(job.tries))
        job.tries += 1
        job.next_try_s = t_s + job.again_s

    def _owe(self, job: Job, t_s: float) -> None:
        """Expect the answers that a finished or forgotten order may still get."""
        if job.command is None or job.unanswered <= 0:
            return
        owed = self._owed.setdefault(job.command, _Owed(0, t_s))
        owed.answers += job.unanswered
        owed.until_s = t_s + STALE_S

    def _stale(self, command: int, t_s: float) -> bool:
        """Book an answer to an order that is over; the order that waited for it may go then."""
        owed = self._owed.get(command)
        if owed is None:
            return False
        if t_s > owed.until_s:
            del self._owed[command]
            return False
        owed.answers -= 1
        if owed.answers <= 0:
            del self._owed[command]
            for jobs in self._lanes.values():
                if jobs and jobs[0].command == command and jobs[0].tries == 0:
                    self._try(jobs[0], t_s)
        return True

    def _finish(self, lane: str, t_s: float, reason: str | None) -> list[Event]:
        jobs = self._lanes[lane]
        job = jobs.pop(0)
        self._owe(job, t_s)
        if jobs:
            owed = self._owed.get(jobs[0].command) if jobs[0].command is not None else None
            if owed is None or t_s > owed.until_s:
                self._try(jobs[0], t_s)
            else:  # sent beside late answers to the last one it could not be told from that
                jobs[0].next_try_s = owed.until_s
        if job.quiet and reason is None:
            return []
        if reason is None:
            return [OrderAccepted(t_s, job.name)]
        return [OrderRefused(t_s, job.name, reason)]
