"""Parameters of the vehicle under test, in its encoding, with the values to restore."""

import contextlib
import struct
from collections.abc import Iterator

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.client import Client, Message
from sim_bridge.conform.dialect import PX4, Dialect
from sim_bridge.conform.errors import ObservationError

_INTEGER_CODES = {
    mavlink.MAV_PARAM_TYPE_INT8: "<b",
    mavlink.MAV_PARAM_TYPE_UINT8: "<B",
    mavlink.MAV_PARAM_TYPE_INT16: "<h",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
}


class Parameters:
    """Reads and writes parameters, and restores those that were changed."""

    def __init__(self, client: Client, dialect: Dialect) -> None:
        self._client, self._dialect = client, dialect
        self._originals: dict[str, tuple[float, int]] = {}

    def read_message(self, name: str) -> Message | None:
        """Return the PARAM_VALUE of a parameter; None without a response."""
        self._client.send("PARAM_REQUEST_READ", param_id=name.encode(), param_index=-1)
        return self._wait_param_value(name)

    def write_message(self, name: str, wire_value: float, param_type: int) -> Message | None:
        """Send PARAM_SET unchanged; return the PARAM_VALUE of the response, if any."""
        self._client.send(
            "PARAM_SET", param_id=name.encode(), param_value=wire_value, param_type=param_type
        )
        return self._wait_param_value(name)

    def _wait_param_value(self, name: str) -> Message | None:
        return self._client.wait_next_message("PARAM_VALUE", 3.0, lambda m: m.param_id == name)

    def read(self, name: str) -> float | None:
        """Return a parameter's value in this autopilot's encoding; None if it does not exist."""
        message = self.read_message(name)
        return None if message is None else self.decoded_value(message)

    def set_until_restored(self, name: str, value: float) -> None:
        """Set a parameter until `restore`; ObservationError if not accepted."""
        before = self.read_message(name)
        if before is None:
            raise ObservationError(f"there is no parameter {name}")
        self.record_original(before)
        wire_value, code = value, self._integer_code(before.param_type)
        if code is not None:
            data = struct.pack(code, int(value)).ljust(4, b"\0")
            wire_value = struct.unpack("<f", data)[0]
        after = self.write_message(name, wire_value, before.param_type)
        if after is None or self.decoded_value(after) != _float32(value):
            raise ObservationError(f"{name} does not take {value}")

    def record_original(self, message: Message) -> None:
        """Note a parameter's PARAM_VALUE, for `restore`."""
        self._originals.setdefault(message.param_id, (message.param_value, message.param_type))

    def decoded_value(self, message: Message) -> float:
        """Return the value of a PARAM_VALUE."""
        code = self._integer_code(message.param_type)
        if code is None:
            return message.param_value
        data = struct.pack("<f", message.param_value)[: struct.calcsize(code)]
        return float(struct.unpack(code, data)[0])

    def _integer_code(self, param_type: int) -> str | None:
        """PX4 puts an integer's bytes into the float; ArduPilot sends its value."""
        return _INTEGER_CODES.get(param_type) if self._dialect is PX4 else None

    def restore(self) -> None:
        """Restore every changed parameter."""
        for name, (wire_value, kind) in list(self._originals.items()):
            if self.write_message(name, wire_value, kind) is not None:
                del self._originals[name]

    @contextlib.contextmanager
    def temporarily_set(self, name: str, value: float) -> Iterator[None]:
        """A parameter at a value while the block runs."""
        self.set_until_restored(name, value)
        try:
            yield
        finally:
            self.restore()


def _float32(value: float) -> float:
    return struct.unpack("<f", struct.pack("<f", value))[0]
