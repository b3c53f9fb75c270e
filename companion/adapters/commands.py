"""Orders that are acknowledged: sent, retried on the autopilot's clock, answered or given up."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from companion.adapters.mavlink_codec import mavlink
from companion.core.events import Event, OrderAccepted, OrderRefused

RETRY_S = 1.0
BUSY_S = 1.0
TRIES = 4

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
    current item is `until_seq`.
    """

    name: str
    make: Callable[[int], Any]
    command: int | None = None
    until_seq: int | None = None
    quiet: bool = False
    tries: int = 0
    next_try_s: float = 0.0


@dataclass(slots=True)
class CommandDesk:
    """Orders in lanes: within a lane one after the other, lanes beside each other."""

    send: Callable[[Any], None]
    _lanes: dict[str, list[Job]] = field(default_factory=dict)

    def submit(self, lane: str, job: Job, t_s: float, *, replace: bool = False) -> None:
        """Queue an order; `replace` forgets what the lane still holds (a newer wish)."""
        jobs = self._lanes.setdefault(lane, [])
        if replace:
            jobs.clear()
        jobs.append(job)
        if len(jobs) == 1:
            self._try(job, t_s)

    def clear(self) -> None:
        """Forget everything: nothing more is sent or retried."""
        self._lanes.clear()

    def pending(self, lane: str) -> bool:
        """Tell whether a lane still works on something."""
        return bool(self._lanes.get(lane))

    def hear_ack(self, message: Any, t_s: float) -> list[Event]:
        """Take a COMMAND_ACK that is addressed to us (or to everybody)."""
        for lane, jobs in self._lanes.items():
            if not jobs or jobs[0].command != message.command:
                continue
            job = jobs[0]
            match message.result:
                case mavlink.MAV_RESULT_ACCEPTED:
                    return self._finish(lane, t_s, None)
                case mavlink.MAV_RESULT_IN_PROGRESS:
                    job.next_try_s = t_s + 5.0 * RETRY_S
                case mavlink.MAV_RESULT_TEMPORARILY_REJECTED if job.tries < TRIES:
                    job.next_try_s = t_s + BUSY_S
                case _:
                    reason = RESULT.get(message.result, f"result {message.result}")
                    return self._finish(lane, t_s, reason)
            return []
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
        job.next_try_s = t_s + RETRY_S

    def _finish(self, lane: str, t_s: float, reason: str | None) -> list[Event]:
        jobs = self._lanes[lane]
        job = jobs.pop(0)
        if jobs:
            self._try(jobs[0], t_s)
        if job.quiet and reason is None:
            return []
        if reason is None:
            return [OrderAccepted(t_s, job.name)]
        return [OrderRefused(t_s, job.name, reason)]
