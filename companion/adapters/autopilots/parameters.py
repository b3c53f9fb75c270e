"""The autopilot's parameters: read by name, set and verified, encoded as the autopilot requires.

A name without a response is not an absent one: the link may lose or delay it. A name is absent by
PARAM_ERROR, or when an existing one would almost certainly have been answered: the chance is
computed from the transmissions that answered names needed. A round counts only if the autopilot
answered another request in it.
"""

import math
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, mavlink
from companion.adapters.autopilots.commands import ResponseTime
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import (
    AutopilotParameters,
    Event,
    ParametersAwaited,
    ParametersSet,
)

RETRY_S, MAX_RETRY_S = CommandKind.PARAMETER.value.interval_s, 16.0
"""First and last interval between transmissions on a link that answers nothing."""

MIN_ANSWERED_ROUNDS, MAX_TRIES = 8, CommandKind.PARAMETER.value.max_tries
"""Answered rounds after which a name is absent at the earliest, and transmissions of a name."""

UNANSWERED_CHANCE = 1e-4
"""Chance that an existing name stays unanswered until it counts as absent."""

MAX_PARALLEL_REQUESTS, SLOW_TRIES = 6, 3
"""Parallel requests, and transmissions after which a name does not hold up others."""

SILENT_ROUNDS, MAX_SILENT_ROUNDS = 3, 20
"""Rounds of transmissions without any response after which one name at a time is requested, and
after which the requests end as unanswered. Two such rounds double the interval."""

AWAITED_AFTER_S = 15.0
"""Time after which the awaited names are reported."""

INTEGER_TYPES = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B",
    mavlink.MAV_PARAM_TYPE_INT8: "<b",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H",
    mavlink.MAV_PARAM_TYPE_INT16: "<h",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


def decode_bytewise(value: float, mav_param_type: int) -> float:
    """Decode a PX4 value: the float's bytes hold an integer."""
    layout = INTEGER_TYPES.get(mav_param_type)
    if layout is None:
        return value
    raw = struct.pack("<f", value)
    return float(struct.unpack_from(layout, raw)[0])


def encode_bytewise(value: float, mav_param_type: int) -> float:
    """Encode a PX4 value: store an integer in the float's bytes."""
    layout = INTEGER_TYPES.get(mav_param_type)
    if layout is None:
        return value
    raw = struct.pack(layout, round(value)).ljust(4, b"\0")
    return struct.unpack("<f", raw)[0]


@dataclass(slots=True)
class _Request:
    """A parameter to read, or to set to `target`."""

    target: float | None
    due_s: float
    before: float | None = None
    """Value before the write."""
    first_s: float = 0.0
    tries: int = 0
    answered_rounds: int = 0
    responses_before: int = 0


class ParameterClient:
    """Reads and sets parameters, a few at a time, with retries; known `values` persist.

    A write is void once the parameter shows a third value, neither the one before the write nor the
    target: another station has set it. Arming of the vehicle voids all writes.
    """

    def __init__(
        self, send: Callable[[Any], None], target_system_id: int, *, bytewise: bool
    ) -> None:
        self._send = send
        self._target = target_system_id
        self._bytewise = bytewise
        self._is_requesting = False
        self._is_setting = False
        self._is_armed = False
        self._requests: dict[str, _Request] = {}
        self._answered: set[str] = set()
        """Names that were answered since the request."""
        self._unanswered: list[str] = []
        self._started_s: float | None = None
        """Start of the requests; `None` once the awaited names are reported."""
        self._probe: str | None = None
        self._response = ResponseTime()
        self._responses = self._silent_rounds = 0
        self._answered_reads = self._tries_of_answered_reads = 0
        self._types: dict[str, int] = {}
        self.values: dict[str, float | None] = {}
        self.failed: list[str] = []

    def request_values(self, names: Iterable[str], t_s: float) -> None:
        """Request parameters; `values` receives numbers, or `None` for absent ones. A repetition
        adds only names that are neither pending nor answered since the first request. Absent names
        are not requested again until one of their group is set, or all requests are cancelled.
        """
        if not self._is_requesting:
            self._answered.clear()
        self._is_requesting = True
        known = self._answered | {name for name, value in self.values.items() if value is None}
        self._add_requests(dict.fromkeys(n for n in names if n not in known), t_s)

    def start_setting_values(self, target_values: dict[str, float], t_s: float) -> None:
        """Set parameters and read them back; `failed` lists the names whose value differs."""
        self._is_setting = True
        self.failed.clear()
        for name in target_values:
            self._requests.pop(name, None)
        self._add_requests(target_values, t_s)

    def _add_requests(self, targets: Mapping[str, float | None], t_s: float) -> None:
        if not self._requests:
            self._started_s = t_s
            self._unanswered.clear()
            self._silent_rounds = min(self._silent_rounds, SILENT_ROUNDS)
        for name, target in targets.items():
            self._requests.setdefault(name, _Request(target, t_s, self.values.get(name)))
        self.tick(t_s)

    def record_armed_state(self, *, armed: bool) -> None:
        """Process a heartbeat: writes to a vehicle that is armed meanwhile are void."""
        if armed and not self._is_armed:
            void = [name for name, one in self._requests.items() if one.target is not None]
            self.failed += void
            for name in void:
                del self._requests[name]
        self._is_armed = armed

    def cancel_all(self) -> None:
        """Cancel all pending reads and writes."""
        self._forget_absent_names()
        self._requests.clear()
        self._is_requesting = self._is_setting = False

    def take_ended_events(self, t_s: float) -> list[Event]:
        """Return the result of the requests once they have all ended; once before, what is
        awaited for long.
        """
        if self._requests:
            if self._started_s is None or t_s - self._started_s < AWAITED_AFTER_S:
                return []
            self._started_s = None
            names = tuple(n for n, request in self._requests.items() if request.target is None)
            return [ParametersAwaited(t_s, names)] if names else []
        events: list[Event] = [ParametersSet(t_s, tuple(self.failed))] if self._is_setting else []
        if self._is_setting or self._is_requesting:
            unanswered = tuple(self._unanswered)
            events.append(AutopilotParameters(t_s, dict(self.values), unanswered))
        self._is_setting = self._is_requesting = False
        return events

    def process_param_value(self, message: Any, t_s: float) -> None:
        """Process a PARAM_VALUE of the autopilot."""
        name = message.param_id
        kind = message.param_type
        value = float(message.param_value)
        if self._bytewise:
            value = decode_bytewise(value, kind)
        if not math.isfinite(value):
            return
        request = self._record_response(name, t_s)
        is_new_type = name not in self._types
        self._types[name] = kind
        self.values[name] = value
        if request is None:
            return
        target = request.target
        before = value if request.before is None else request.before
        if target is None or _is_same_value(target, value):
            del self._requests[name]
            if target is not None:
                self._forget_absent_names(name.partition("_")[0])
        elif not _is_same_value(before, value):
            self._end_without_value(name, request)
        elif is_new_type:  # set it immediately
            self._requests[name] = _Request(target, 0.0, before)
        else:
            request.before = before

    def process_param_error(self, message: Any, t_s: float) -> None:
        """Process a PARAM_ERROR (PX4 1.18): no such parameter, or the value cannot be set."""
        name = message.param_id
        request = self._record_response(name, t_s)
        if request is not None:
            self._end_without_value(name, request)

    def _record_response(self, name: str, t_s: float) -> _Request | None:
        """Record that the link answers; return the request that this name answers."""
        request = self._requests.get(name)
        if request is not None and request.tries and request.target is None:
            self._response.store_response_time(request.first_s, t_s, is_repeated=request.tries > 1)
            self._answered_reads += 1
            self._tries_of_answered_reads += request.tries
        if name == self._probe or (request is not None and request.tries):
            self._responses += 1
            self._silent_rounds = 0
        self._answered.add(name)
        return request

    def _end_without_value(self, name: str, request: _Request) -> None:
        del self._requests[name]
        if request.target is not None:
            self.failed.append(name)
        else:
            self.values.setdefault(name, None)

    def _forget_absent_names(self, group: str = "") -> None:
        """Request absent names again: ArduPilot hides parameters of what is not enabled."""
        absent = [name for name, value in self.values.items() if value is None]
        for name in absent:
            if name.startswith(group):
                del self.values[name]

    def _rounds_until_absent(self) -> int:
        """Return the answered rounds after which an existing name would have been answered."""
        frac = (1.0 + self._answered_reads) / (2.0 + self._tries_of_answered_reads)
        rounds = math.log(UNANSWERED_CHANCE) / math.log(1.0 - frac)
        return max(MIN_ANSWERED_ROUNDS, math.ceil(rounds))

    def tick(self, t_s: float) -> None:
        """Send requests that are due, first or repeated."""
        is_probe_due = has_sent = False
        for name, request in self._current_requests():
            if t_s < request.due_s:
                continue
            has_answered = self._responses > request.responses_before
            request.answered_rounds += request.tries > 0 and has_answered
            if request.answered_rounds >= self._rounds_until_absent():
                self._end_without_value(name, request)
                continue
            is_probe_due |= request.tries > 0
            self._send_request(name, request, t_s)
            has_sent = True
            if request.tries >= MAX_TRIES:
                self._end_all_as_unanswered()
                return
        self._silent_rounds += has_sent
        if self._silent_rounds > MAX_SILENT_ROUNDS:
            self._end_all_as_unanswered()
        known = next((n for n, value in self.values.items() if value is not None), None)
        if is_probe_due and known is not None:
            self._probe = known
            self._send_read_request(known)

    def _current_requests(self) -> list[tuple[str, _Request]]:
        """Return the requests in progress: a few, and on a link that answers all slow ones."""
        requests = list(self._requests.items())
        if self._silent_rounds >= SILENT_ROUNDS:
            return requests[:1]
        slow = [(name, request) for name, request in requests if request.tries > SLOW_TRIES]
        fresh = [(name, request) for name, request in requests if request.tries <= SLOW_TRIES]
        return slow + fresh[:MAX_PARALLEL_REQUESTS]

    def _send_request(self, name: str, request: _Request, t_s: float) -> None:
        interval_s = max(RETRY_S, self._response.response_timeout_s)
        interval_s *= 2.0 ** (self._silent_rounds // 2)
        request.first_s = request.first_s if request.tries else t_s
        request.due_s = t_s + min(interval_s, MAX_RETRY_S)
        request.tries += 1
        request.responses_before = self._responses
        kind = self._types.get(name)
        if request.target is None or kind is None:  # a write needs the type, known from the value
            self._send_read_request(name)
            return
        wire = encode_bytewise(request.target, kind) if self._bytewise else request.target
        self._send(
            mavlink.MAVLink_param_set_message(self._target, AUTOPILOT, name.encode(), wire, kind)
        )

    def _end_all_as_unanswered(self) -> None:
        self.failed += [n for n, request in self._requests.items() if request.target is not None]
        self._unanswered += [n for n, request in self._requests.items() if request.target is None]
        self._requests.clear()

    def _send_read_request(self, name: str) -> None:
        self._send(
            mavlink.MAVLink_param_request_read_message(self._target, AUTOPILOT, name.encode(), -1)
        )


def _is_same_value(a: float, b: float) -> bool:
    """Return whether two values are equal as sent (32-bit floats)."""
    return abs(a - b) <= 1e-4 * max(1.0, abs(a))
