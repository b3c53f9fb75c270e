"""The autopilot's parameters: read by name, set and read back, encoded as the autopilot does."""

import math
import struct
from collections.abc import Callable, Iterable
from typing import Any

from companion.adapters.autopilots.codec import mavlink

RETRY_S = 1.0
TRIES = 8
"""With a fifth of all frames lost, both ways, 4 tries leave one name in sixty unanswered, and a
launch was refused for that (flown); 8 leave one in 3,500."""
AT_ONCE = 6

INTEGER_TYPES = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B",
    mavlink.MAV_PARAM_TYPE_INT8: "<b",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H",
    mavlink.MAV_PARAM_TYPE_INT16: "<h",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


def decode_bytewise(value: float, kind: int) -> float:
    """PX4: the integer's bits lie in the float's bytes."""
    layout = INTEGER_TYPES.get(kind)
    if layout is None:
        return value
    raw = struct.pack("<f", value)
    return float(struct.unpack_from(layout, raw)[0])


def encode_bytewise(value: float, kind: int) -> float:
    """PX4: put the integer's bits into the float's bytes."""
    layout = INTEGER_TYPES.get(kind)
    if layout is None:
        return value
    raw = struct.pack(layout, round(value)).ljust(4, b"\0")
    return struct.unpack("<f", raw)[0]


class ParameterClient:
    """Reads and sets parameters, a few at a time, each until it is answered or given up."""

    def __init__(self, send: Callable[[Any], None], *, bytewise: bool) -> None:
        self._send = send
        self._bytewise = bytewise
        self._target = 1
        self._reading: dict[str, tuple[int, float]] = {}
        self._setting: dict[str, tuple[float, int, float]] = {}
        self._kinds: dict[str, int] = {}
        self.values: dict[str, float | None] = {}
        self.failed: list[str] = []

    def aim(self, system_id: int) -> None:
        """Address this system."""
        self._target = system_id

    def read(self, names: Iterable[str], t_s: float) -> None:
        """Ask for parameters; `values` fills with numbers, or `None` for those never answered."""
        for name in names:
            self._reading[name] = (0, t_s)
        self.tick(t_s)

    def set(self, wanted: dict[str, float], t_s: float) -> None:
        """Set parameters and read them back; `failed` names those that do not come out so."""
        self.failed.clear()
        for name, value in wanted.items():
            self._setting[name] = (value, 0, t_s)
        self.tick(t_s)

    def clear(self) -> None:
        """Forget what is being asked or set."""
        self._reading.clear()
        self._setting.clear()

    @property
    def busy(self) -> bool:
        """True while something is being asked or set."""
        return bool(self._reading or self._setting)

    def on_value(self, message: Any) -> None:
        """Take a PARAM_VALUE of the autopilot."""
        name = message.param_id
        kind = message.param_type
        value = float(message.param_value)
        if self._bytewise:
            value = decode_bytewise(value, kind)
        if not math.isfinite(value):
            return
        learnt = name not in self._kinds
        self._kinds[name] = kind
        self.values[name] = value
        self._reading.pop(name, None)
        wish = self._setting.get(name)
        if wish is not None and learnt:
            self._setting[name] = (wish[0], 0, 0.0)  # its type is known now: set it at once
        if wish is not None and abs(wish[0] - value) <= 1e-4 * max(1.0, abs(wish[0])):
            del self._setting[name]

    def on_error(self, message: Any) -> None:
        """Take a PARAM_ERROR (PX4 1.18): there is no such parameter, or it cannot be set so."""
        name = message.param_id
        if self._reading.pop(name, None) is not None:
            self.values.setdefault(name, None)
        if self._setting.pop(name, None) is not None:
            self.failed.append(name)

    def tick(self, t_s: float) -> None:
        """Ask (again) for what is due."""
        for name in list(self._reading)[:AT_ONCE]:
            tries, due_s = self._reading[name]
            if t_s < due_s:
                continue
            if tries >= TRIES:
                del self._reading[name]
                self.values.setdefault(name, None)
                continue
            self._reading[name] = (tries + 1, t_s + RETRY_S)
            self._request(name)
        for name in list(self._setting)[:AT_ONCE]:
            value, tries, due_s = self._setting[name]
            if t_s < due_s:
                continue
            if tries >= TRIES:
                del self._setting[name]
                self.failed.append(name)
                continue
            kind = self._kinds.get(name)
            if kind is None:  # its type comes with its value: read it first
                self._setting[name] = (value, tries + 1, t_s + RETRY_S)
                self._request(name)
                continue
            self._setting[name] = (value, tries + 1, t_s + RETRY_S)
            wire = encode_bytewise(value, kind) if self._bytewise else value
            self._send(
                mavlink.MAVLink_param_set_message(
                    self._target, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), wire, kind
                )
            )

    def _request(self, name: str) -> None:
        self._send(
            mavlink.MAVLink_param_request_read_message(
                self._target, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1
            )
        )
