"""Dataflash logs before 2015: milliseconds, hundredths of volts and amperes, GPS only."""

import math
import struct
from pathlib import Path

import pytest

from companion.adapters.logs.open_log import read_log_of_any_format
from companion.core.base.errors import LeewayError
from companion.core.mission.events import Attitude, Battery, Position

HEAD = b"\xa3\x95"
FORMATS = {  # number, name, format of the fields, labels, struct
    130: ("ATT", "Iccccff", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw", "<Ihhhhff"),
    131: ("CURR", "IhIhhhf", "TimeMS,ThrOut,ThrInt,Volt,Curr,Vcc,CurrTot", "<IhIhhhf"),
    132: (
        "GPS",
        "BIHBcLLeeEefI",
        "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T",
        "<BIHBhiiiiIifI",
    ),
}


def record(kind: int, *values: float) -> bytes:
    return HEAD + bytes([kind]) + struct.pack(FORMATS[kind][3], *values)


def write_log(path: Path) -> None:
    raw = b""
    fmt = ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    for kind, (name, form, labels, packed) in {128: (*fmt, "<BB4s16s64s"), **FORMATS}.items():
        length = 3 + struct.calcsize(packed)
        texts = (text.encode() for text in (name, form, labels))
        raw += HEAD + b"\x80" + struct.pack("<BB4s16s64s", kind, length, *texts)
    for t_ms in range(90_000, 100_000, 100):
        raw += record(130, t_ms, 0, -200, 0, -800, 90.0, 90.0)
        raw += record(131, t_ms, 500, 0, 2400, 1500, 5000, 12.5)
        place = (500_000_000, 100_000_000, 2000, 14_000, 500, 9000, 0.0)
        raw += record(132, 3, 56_000_000 + t_ms, 1777, 12, 120, *place, t_ms)
    path.write_bytes(raw)


def test_times_angles_heights_and_the_battery_are_in_si_units(tmp_path: Path) -> None:
    write_log(tmp_path / "old.bin")
    events = read_log_of_any_format(tmp_path / "old.bin").events
    attitude = next(one for one in events if isinstance(one, Attitude))
    battery = next(one for one in events if isinstance(one, Battery))
    position = next(one for one in events if isinstance(one, Position))
    angles_deg = math.degrees(attitude.roll_rad), math.degrees(attitude.pitch_rad)
    assert angles_deg == pytest.approx((-2.0, -8.0))
    assert (battery.voltage_v, battery.current_a) == pytest.approx((24.0, 15.0))
    assert (position.height_rel_m, position.alt_amsl_m) == pytest.approx((20.0, 140.0))
    assert (position.vel_n_mps, position.vel_e_mps) == pytest.approx((0.0, 5.0), abs=1e-9)
    assert math.isclose(events[-1].t_s - events[0].t_s, 9.9)


@pytest.mark.parametrize("head", ["FMT, 128, 89, FMT\n", "ArduCopter V3.1\n\nFMT, 128, 89\n"])
def test_a_text_log_is_named_as_one(tmp_path: Path, head: str) -> None:
    (tmp_path / "old.log").write_text(head)
    with pytest.raises(LeewayError, match="ArduPilot text log"):
        read_log_of_any_format(tmp_path / "old.log")
