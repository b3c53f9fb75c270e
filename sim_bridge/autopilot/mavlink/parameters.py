"""The autopilot's parameters: names, values and wire encoding."""

import math
import struct
import tomllib
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sim_bridge.autopilot.kinds import AutopilotKind

_FORMAT = "autopilot-parameters/1"
_INT_RANGES = {
    "int8": (-128, 127),
    "int16": (-(2**15), 2**15 - 1),
    "int32": (-(2**31), 2**31 - 1),
}
MAV_PARAM_TYPES = {"int8": 2, "int16": 4, "int32": 6, "float": 9}
"""MAV_PARAM_TYPE of each storage type (INT8, INT16, INT32, REAL32)."""


class ParameterError(ValueError):
    """An invalid parameter file or setting; states where, what, and what was expected."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its storage type and its value, in the autopilot's own units."""

    name: str
    type: str
    value: float

    def with_cast_value(self, value: float) -> "Parameter":
        """The same parameter holding `value`, as its type can hold it."""
        return replace(self, value=_cast_and_clamp_to_type(self.type, value))


def _cast_and_clamp_to_type(type_name: str, value: float) -> float:
    """`value` as it is stored: a 32-bit float, or an integer within the type's range."""
    if type_name == "float":
        return struct.unpack("<f", struct.pack("<f", value))[0]
    low, high = _INT_RANGES[type_name]
    return float(min(high, max(low, math.floor(value + 0.5))))


def _parse_parameter_entry(path: Path, name: str, entry: Any) -> Parameter:
    where = f"{path.name}: parameters.{name}"
    if len(name) > 16:
        raise ParameterError(f"{where}: a name has at most 16 characters")
    if not isinstance(entry, dict) or entry.keys() != {"type", "default"}:
        raise ParameterError(f"{where}: expected a table with type and default")
    if entry["type"] not in MAV_PARAM_TYPES:
        raise ParameterError(f"{where}.type: expected one of {', '.join(MAV_PARAM_TYPES)}")
    if not isinstance(entry["default"], int | float):
        raise ParameterError(f"{where}.default: expected a number")
    return Parameter(
        name, entry["type"], _cast_and_clamp_to_type(entry["type"], float(entry["default"]))
    )


def read_parameters(
    path: Path,
    override_values: Mapping[str, float] | None = None,
) -> dict[str, Parameter]:
    """The parameters of a file such as `params/autopilots/px4.toml`, with `override_values` on top.

    `override_values` are values by name, in the parameters' own units. `renamed_in_4_7` is a table
    of older files. Raises ParameterError naming the key that is wrong.
    """
    tables = tomllib.loads(path.read_text())
    unknown = tables.keys() - {"format", "autopilot", "flavour", "parameters", "renamed_in_4_7"}
    if unknown or tables.get("format") != _FORMAT:
        raise ParameterError(f"{path.name}: expected format {_FORMAT}, unknown: {sorted(unknown)}")
    parameters = {
        name: _parse_parameter_entry(path, name, entry)
        for name, entry in tables["parameters"].items()
    }
    for name, value in (override_values or {}).items():
        if name not in parameters:
            raise ParameterError(f"{name}: {path.name} has no such parameter")
        parameters[name] = parameters[name].with_cast_value(float(value))
    return parameters


class ParameterStore:
    """The parameters in the order of their indices, and their wire encoding.

    ArduPilot casts any value to float and back; PX4 puts an integer's four bytes into the float
    field and checks the type that it is given.
    """

    def __init__(self, kind: AutopilotKind, parameters: Mapping[str, Parameter]) -> None:
        is_px4 = kind is AutopilotKind.PX4
        self.integers_bytewise = is_px4
        """True if an integer's bytes are stored in the float field, as in PX4."""
        names = sorted(parameters) if is_px4 else parameters
        self._by_name = {name: parameters[name] for name in names}
        self._names = tuple(self._by_name)
        self.revision = 0

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: str) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> float:
        return self._by_name[name].value

    def centimetre_value_as_m(self, name: str) -> float:
        """An ArduCopter length or speed in metres (or degrees)."""
        return self._by_name[name].value * 0.01

    def set(self, name: str, value: float) -> None:
        """Store a value as the type can hold it; an unknown name is a KeyError."""
        self._by_name[name] = self._by_name[name].with_cast_value(value)
        self.revision += 1

    def add_second_battery_monitor(self) -> None:
        """Add ArduCopter's parameters of a second monitor, with the values of the first's."""
        firsts = [one for name, one in self._by_name.items() if name.startswith("BATT_")]
        seconds = [replace(one, name=one.name.replace("BATT_", "BATT2_")) for one in firsts]
        self._by_name |= {one.name: one for one in seconds}
        self._names = tuple(self._by_name)

    def name_at(self, index: int) -> str | None:
        """Name of the parameter with this index, if there is one."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index_of(self, name: str) -> int:
        """Index of a parameter that exists."""
        return self._names.index(name)

    def wire_value_and_type(self, name: str) -> tuple[float | int, int]:
        """PARAM_VALUE's param_value and param_type."""
        parameter = self._by_name[name]
        kind = MAV_PARAM_TYPES[parameter.type]
        if self.integers_bytewise and parameter.type != "float":
            return struct.unpack("<f", struct.pack("<i", int(parameter.value)))[0], kind
        return parameter.value, kind

    def store_wire_value_if_accepted(self, name: str, param_value: float, param_type: int) -> bool:
        """Store a PARAM_SET; False if it is refused (the stored value then stays)."""
        parameter = self._by_name[name]
        if self.integers_bytewise:
            if param_type != MAV_PARAM_TYPES[parameter.type]:
                return False
            if parameter.type != "float":
                self.set(name, struct.unpack("<i", struct.pack("<f", param_value))[0])
                return True
        if not math.isfinite(param_value):
            return False
        self.set(name, param_value)
        return True

    def checksum(self) -> int:
        """A checksum over names and values, for PX4's _HASH_CHECK."""
        crc = 0
        for parameter in self._by_name.values():
            crc = zlib.crc32(parameter.name.encode(), crc)
            if parameter.type == "float":
                crc = zlib.crc32(struct.pack("<f", parameter.value), crc)
            else:
                crc = zlib.crc32(struct.pack("<i", int(parameter.value)), crc)
        return crc

    def checksum_bits_as_float(self) -> float:
        """The checksum's four bytes as a float's, as PX4 sends it."""
        return struct.unpack("<f", struct.pack("<I", self.checksum()))[0]
