"""The autopilot's parameters: read by name, set and verified, encoded as the autopilot requires."""

import math
import struct
from collections.abc import Callable, Iterable
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, mavlink
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import AutopilotParameters, Event, ParametersSet

RETRY_S, MAX_TRIES = CommandKind.PARAMETER.value.interval_s, CommandKind.PARAMETER.value.max_tries
MAX_PARALLEL_REQUESTS = 6

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
        self._pending_reads: dict[str, tuple[int, float]] = {}
        self._pending_writes: dict[str, tuple[float, int, float]] = {}
        self._values_before_write: dict[str, float] = {}
        self._is_armed = False
        self._types: dict[str, int] = {}
        self.values: dict[str, float | None] = {}
        self.failed: list[str] = []

    def request_values(self, names: Iterable[str], t_s: float) -> None:
        """Request parameters; `values` receives numbers, or `None` for those without a response."""
        self._is_requesting = True
        for name in names:
            self._pending_reads[name] = (0, t_s)
        self.tick(t_s)

    def start_setting_values(self, target_values: dict[str, float], t_s: float) -> None:
        """Set parameters and read them back; `failed` lists the names whose value differs."""
        self._is_setting = True
        self.failed.clear()
        self._values_before_write.clear()
        for name, value in target_values.items():
            self._pending_writes[name] = (value, 0, t_s)
            if (before := self.values.get(name)) is not None:
                self._values_before_write[name] = before
        self.tick(t_s)

    def record_armed_state(self, *, armed: bool) -> None:
        """Process a heartbeat: writes to a vehicle that is armed meanwhile are void."""
        if armed and not self._is_armed:
            self.failed += self._pending_writes
            self._pending_writes.clear()
        self._is_armed = armed

    def cancel_all(self) -> None:
        """Cancel all pending reads and writes."""
        self._pending_reads.clear()
        self._pending_writes.clear()
        self._is_requesting = self._is_setting = False

    def take_ended_events(self, t_s: float) -> list[Event]:
        """Return the result of the requests once they have all ended."""
        if self._pending_reads or self._pending_writes:
            return []
        if self._is_setting:
            self._is_setting = False
            return [
                ParametersSet(t_s, tuple(self.failed)),
                AutopilotParameters(t_s, dict(self.values)),
            ]
        if self._is_requesting:
            self._is_requesting = False
            return [AutopilotParameters(t_s, dict(self.values))]
        return []

    def process_param_value(self, message: Any) -> None:
        """Process a PARAM_VALUE of the autopilot."""
        name = message.param_id
        kind = message.param_type
        value = float(message.param_value)
        if self._bytewise:
            value = decode_bytewise(value, kind)
        if not math.isfinite(value):
            return
        is_new_type = name not in self._types
        self._types[name] = kind
        self.values[name] = value
        self._pending_reads.pop(name, None)
        pending_write = self._pending_writes.get(name)
        if pending_write is None:
            return
        target_value = pending_write[0]
        if is_new_type:  # set it immediately
            self._pending_writes[name] = (target_value, 0, 0.0)
        before = self._values_before_write.setdefault(name, value)
        if _is_same_value(target_value, value):
            del self._pending_writes[name]
        elif not _is_same_value(before, value):
            del self._pending_writes[name]
            self.failed.append(name)

    def process_param_error(self, message: Any) -> None:
        """Process a PARAM_ERROR (PX4 1.18): no such parameter, or the value cannot be set."""
        name = message.param_id
        if self._pending_reads.pop(name, None) is not None:
            self.values.setdefault(name, None)
        if self._pending_writes.pop(name, None) is not None:
            self.failed.append(name)

    def tick(self, t_s: float) -> None:
        """Send requests that are due, first or repeated."""
        for name in list(self._pending_reads)[:MAX_PARALLEL_REQUESTS]:
            tries, due_s = self._pending_reads[name]
            if t_s < due_s:
                continue
            if tries >= MAX_TRIES:
                del self._pending_reads[name]
                self.values.setdefault(name, None)
                continue
            self._pending_reads[name] = (tries + 1, t_s + RETRY_S)
            self._send_read_request(name)
        for name in list(self._pending_writes)[:MAX_PARALLEL_REQUESTS]:
            value, tries, due_s = self._pending_writes[name]
            if t_s < due_s:
                continue
            if tries >= MAX_TRIES:
                del self._pending_writes[name]
                self.failed.append(name)
                continue
            self._pending_writes[name] = (value, tries + 1, t_s + RETRY_S)
            kind = self._types.get(name)
            if kind is None:  # the type is known from the value: read it first
                self._send_read_request(name)
                continue
            wire = encode_bytewise(value, kind) if self._bytewise else value
            self._send(
                mavlink.MAVLink_param_set_message(
                    self._target, AUTOPILOT, name.encode(), wire, kind
                )
            )

    def _send_read_request(self, name: str) -> None:
        self._send(
            mavlink.MAVLink_param_request_read_message(self._target, AUTOPILOT, name.encode(), -1)
        )


def _is_same_value(a: float, b: float) -> bool:
    """Return whether two values are equal as sent (32-bit floats)."""
    return abs(a - b) <= 1e-4 * max(1.0, abs(a))
