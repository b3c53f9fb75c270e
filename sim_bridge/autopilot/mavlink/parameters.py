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
    """A wrong parameter file or setting: says where, what, and what was expected."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its storage type and its value, in the autopilot's own units."""

    name: str
    type: str
    value: float

    def with_value(self, value: float) -> "Parameter":
        """The same parameter holding `value`, as its type can hold it."""
        return replace(self, value=_stored(self.type, value))


def _stored(type_name: str, value: float) -> float:
    """`value` as it is stored: a 32-bit float, or an integer within the type's range."""
    if type_name == "float":
        return struct.unpack("<f", struct.pack("<f", value))[0]
    low, high = _INT_RANGES[type_name]
    return float(min(high, max(low, math.floor(value + 0.5))))


def _parameter(path: Path, name: str, entry: Any) -> Parameter:
    where = f"{path.name}: parameters.{name}"
    if len(name) > 16:
        raise ParameterError(f"{where}: a name has at most 16 characters")
    if not isinstance(entry, dict) or entry.keys() != {"type", "default"}:
        raise ParameterError(f"{where}: expected a table with type and default")
    if entry["type"] not in MAV_PARAM_TYPES:
        raise ParameterError(f"{where}.type: expected one of {', '.join(MAV_PARAM_TYPES)}")
    if not isinstance(entry["default"], int | float):
        raise ParameterError(f"{where}.default: expected a number")
    return Parameter(name, entry["type"], _stored(entry["type"], float(entry["default"])))


def read_parameters(
    path: Path,
    settings: Mapping[str, float] | None = None,
    *,
    names: str = "4.6",
) -> dict[str, Parameter]:
    """The parameters of a file such as `params/autopilots/px4.toml`, with `settings` on top.

    `settings` are values by name, in the units of the names served. `names="4.7"` serves
    ArduCopter 4.7's new names with their new units; the autopilot understands both.
    Raises ParameterError naming the key that is wrong.
    """
    tables = tomllib.loads(path.read_text())
    unknown = tables.keys() - {"format", "autopilot", "flavour", "parameters", "renamed_in_4_7"}
    if unknown or tables.get("format") != _FORMAT:
        raise ParameterError(f"{path.name}: expected format {_FORMAT}, unknown: {sorted(unknown)}")
    parameters = {
        name: _parameter(path, name, entry) for name, entry in tables["parameters"].items()
    }
    if names == "4.7":
        parameters = _renamed(parameters, tables.get("renamed_in_4_7", {}))
    elif names != "4.6":
        raise ParameterError(f"names = {names!r}: expected 4.6 or 4.7")
    for name, value in (settings or {}).items():
        if name not in parameters:
            raise ParameterError(f"{name}: {path.name} has no such parameter")
        parameters[name] = parameters[name].with_value(float(value))
    return parameters


def _renamed(
    parameters: dict[str, Parameter], renames: Mapping[str, tuple[str, float]]
) -> dict[str, Parameter]:
    renamed = {}
    for name, parameter in parameters.items():
        new_name, factor = renames.get(name, (name, 1.0))
        kind = parameter.type if factor == 1.0 else "float"
        renamed[new_name] = Parameter(new_name, kind, _stored(kind, parameter.value * factor))
    return renamed


_IN_CENTIMETRES = {
    "RTL_ALT": "RTL_ALT_M",
    "RTL_ALT_FINAL": "RTL_ALT_FINAL_M",
    "RTL_CLIMB_MIN": "RTL_CLIMB_MIN_M",
    "RTL_SPEED": "RTL_SPEED_MS",
    "WPNAV_SPEED": "WP_SPD",
    "WPNAV_SPEED_UP": "WP_SPD_UP",
    "WPNAV_SPEED_DN": "WP_SPD_DN",
    "WPNAV_RADIUS": "WP_RADIUS_M",
    "WPNAV_ACCEL": "WP_ACC",
    "WPNAV_ACCEL_Z": "WP_ACC_Z",
    "LAND_SPEED": "LAND_SPD_MS",
    "LAND_SPEED_HIGH": "LAND_SPD_HIGH_MS",
    "LAND_ALT_LOW": "LAND_ALT_LOW_M",
    "LOIT_SPEED": "LOIT_SPEED_MS",
    "PILOT_SPEED_UP": "PILOT_SPD_UP",
    "PILOT_SPEED_DN": "PILOT_SPD_DN",
    "ANGLE_MAX": "ATC_ANGLE_MAX",
}


class ParameterStore:
    """The parameters in the order of their indices, and their wire encoding.

    ArduPilot casts any value to float and back; PX4 puts an integer's four bytes into the float
    field and checks the type that it is given.
    """

    def __init__(self, kind: AutopilotKind, parameters: Mapping[str, Parameter]) -> None:
        is_px4 = kind is AutopilotKind.PX4
        self.integers_bytewise = is_px4
        """Whether an integer's bytes are put into the float field, as PX4 does."""
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

    def metres(self, name: str) -> float:
        """An ArduCopter length or speed in metres (or degrees), under its 4.6 or 4.7 name."""
        if name in self._by_name:
            return self._by_name[name].value * 0.01
        return self._by_name[_IN_CENTIMETRES[name]].value

    def value(self, name: str, other: str, default: float = 0.0) -> float:
        """The value of whichever of two names is served."""
        parameter = self._by_name.get(name) or self._by_name.get(other)
        return default if parameter is None else parameter.value

    def set(self, name: str, value: float) -> None:
        """Store a value as the type can hold it; an unknown name is a KeyError."""
        self._by_name[name] = self._by_name[name].with_value(value)
        self.revision += 1

    def name_at(self, index: int) -> str | None:
        """Name of the parameter with this index, if there is one."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index_of(self, name: str) -> int:
        """Index of a parameter that exists."""
        return self._names.index(name)

    def wire(self, name: str) -> tuple[float | int, int]:
        """PARAM_VALUE's param_value and param_type."""
        parameter = self._by_name[name]
        kind = MAV_PARAM_TYPES[parameter.type]
        if self.integers_bytewise and parameter.type != "float":
            return struct.unpack("<f", struct.pack("<i", int(parameter.value)))[0], kind
        return parameter.value, kind

    def accept(self, name: str, param_value: float, param_type: int) -> bool:
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

    def digest(self) -> int:
        """A checksum over names and values, for PX4's _HASH_CHECK."""
        crc = 0
        for parameter in self._by_name.values():
            crc = zlib.crc32(parameter.name.encode(), crc)
            if parameter.type == "float":
                crc = zlib.crc32(struct.pack("<f", parameter.value), crc)
            else:
                crc = zlib.crc32(struct.pack("<i", int(parameter.value)), crc)
        return crc

    def digest_as_float(self) -> float:
        """The checksum's four bytes as a float's, as PX4 sends it."""
        return struct.unpack("<f", struct.pack("<I", self.digest()))[0]
