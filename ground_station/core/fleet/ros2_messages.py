"""ROS 2 messages of a vehicle's state in CDR (little endian); type hashes of Iron and later.

Types are standard ones, so that no package has to be built: `geometry_msgs`, `std_msgs`,
`diagnostic_msgs`. The format is OMG's CDR as rmw implementations use it: alignment is counted from
the end of the 4-byte encapsulation header.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec

from companion.fleet.messages import State

TWIST = "geometry_msgs::msg::dds_::TwistWithCovarianceStamped_"
FLOAT64 = "std_msgs::msg::dds_::Float64_"
DIAGNOSTICS = "diagnostic_msgs::msg::dds_::DiagnosticArray_"
TYPE_HASHES = {
    TWIST: "RIHS01_77b67434531e6529b7a0091357b186b6ebdb17fd9ffd3e0c7ce9d3fb11a44563",
    FLOAT64: "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    DIAGNOSTICS: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
"""REP 2011 type hashes."""

FRAME_ID = "map"
OK, WARN, ERROR, STALE = range(4)
"""Levels of `diagnostic_msgs/DiagnosticStatus`."""

VALUE_TOPICS = ("margin_wh", "p_home", "p_success", "energy_left_wh")
"""Fields of the state that are published as `std_msgs/Float64`."""

DIAGNOSTIC_FIELDS = ("phase", "order", "assignment", "voltage_v", *VALUE_TOPICS)


@dataclass(frozen=True, slots=True)
class RosMessage:
    """One message. `topic` has no leading slash."""

    topic: str
    type_name: str
    cdr: bytes


def topic_name_of(vehicle: str) -> str:
    """Return a vehicle's name as a part of a topic: letters, digits and underscores."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", vehicle)
    return f"v{name}" if name[:1].isdigit() else name


def vehicle_messages(state: State, epoch_us: int) -> Iterator[RosMessage]:
    """Yield wind and values of one state, stamped with the time of its arrival. Unknown values are
    not published.
    """
    prefix = f"leeway/{topic_name_of(state.vehicle)}"
    if state.wind_to_n_mps is not None and state.wind_to_e_mps is not None:
        yield RosMessage(f"{prefix}/wind", TWIST, _encode_wind(state, epoch_us))
    for name in VALUE_TOPICS:
        value = getattr(state, name)
        if value is not None:
            cdr = CdrWriter()
            cdr.write_doubles(value)
            yield RosMessage(f"{prefix}/{name}", FLOAT64, cdr.to_bytes())


def diagnostics_message(
    states: dict[str, tuple[State, bool]], epoch_us: int, max_loss: float
) -> RosMessage:
    """Return one status per vehicle. `states`: newest state, and whether it is outdated."""
    cdr = CdrWriter()
    cdr.write_header(epoch_us, "")
    cdr.write_uint32(len(states))
    for vehicle, (state, is_stale) in sorted(states.items()):
        level, message = _level_and_text(state, max_loss)
        cdr.write_byte(STALE if is_stale else level)
        for text in (f"leeway: {vehicle}", "no recent state" if is_stale else message, vehicle):
            cdr.write_string(text)
        values = {name: getattr(state, name) for name in DIAGNOSTIC_FIELDS}
        known = {name: value for name, value in values.items() if value is not None}
        cdr.write_uint32(len(known))
        for name, value in known.items():
            cdr.write_string(name)
            cdr.write_string(f"{value:.4g}" if isinstance(value, float) else str(value))
    return RosMessage("diagnostics", DIAGNOSTICS, cdr.to_bytes())


def _level_and_text(state: State, max_loss: float) -> tuple[int, str]:
    if state.p_home is not None and state.p_home < 1.0 - max_loss:
        return ERROR, f"P(home) {state.p_home:.3f} below {1.0 - max_loss:g}; {state.phase}"
    if state.margin_wh is not None and state.margin_wh <= 0.0:
        return WARN, f"margin {state.margin_wh:.1f} Wh; {state.phase}"
    return OK, state.phase


def _encode_wind(state: State, epoch_us: int) -> bytes:
    """Encode the wind by REP 103: x east, y north, the direction that the air moves TO."""
    cdr = CdrWriter()
    cdr.write_header(epoch_us, FRAME_ID)
    cdr.write_doubles(state.wind_to_e_mps, state.wind_to_n_mps, 0.0, 0.0, 0.0, 0.0)
    covariance = [0.0] * 36
    if state.wind_cov_m2ps2 is not msgspec.UNSET:
        nn, ne, ee = state.wind_cov_m2ps2
        covariance[0], covariance[1], covariance[6], covariance[7] = ee, ne, ne, nn
    cdr.write_doubles(*covariance)
    return cdr.to_bytes()


class CdrWriter:
    """Writes values in order, each aligned to its size."""

    def __init__(self) -> None:
        self._body = bytearray()

    def to_bytes(self) -> bytes:
        """Return the encapsulation header (CDR_LE) and the values."""
        return b"\0\1\0\0" + bytes(self._body)

    def write_byte(self, value: int) -> None:
        self._body.append(value)

    def write_uint32(self, value: int) -> None:
        self._align_and_append(4, struct.pack("<I", value))

    def write_doubles(self, *values: float | None) -> None:
        self._align_and_append(8, struct.pack(f"<{len(values)}d", *values))

    def write_string(self, text: str) -> None:
        encoded = text.replace("\0", "").encode() + b"\0"
        self.write_uint32(len(encoded))
        self._body += encoded

    def write_header(self, epoch_us: int, frame_id: str) -> None:
        """Write `std_msgs/Header`."""
        seconds, part_us = divmod(epoch_us, 1_000_000)
        self._align_and_append(4, struct.pack("<iI", seconds, 1000 * part_us))
        self.write_string(frame_id)

    def _align_and_append(self, size: int, raw: bytes) -> None:
        self._body += bytes(-len(self._body) % size)
        self._body += raw
