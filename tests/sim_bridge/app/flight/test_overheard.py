"""Data of a live view from the stream of a vehicle that is not simulated here."""

import math
from pathlib import Path

import pytest

from sim_bridge.app.flight.overheard import STAMP, StreamMonitor
from sim_bridge.autopilot.mavlink.codec import Encoder, Message


@pytest.fixture
def autopilot() -> Encoder:
    return Encoder(1, 1)


def tell(path: Path, autopilot: Encoder, lat_deg: float, lon_deg: float, up_m: float) -> None:
    message = Message(
        "GLOBAL_POSITION_INT",
        time_boot_ms=1000,
        lat=round(lat_deg * 1e7),
        lon=round(lon_deg * 1e7),
        alt=0,
        relative_alt=round(1000.0 * up_m),
        vx=0,
        vy=0,
        vz=0,
        hdg=0,
    )
    with path.open("ab") as file:
        file.write(STAMP.pack(0) + autopilot.encode_next_frame(message))


def test_0_north_0_east_is_no_place_to_have_stood(tmp_path, autopilot):
    path = tmp_path / "stream.tlog"
    tell(path, autopilot, 0.0, 0.0, 0.0)
    tell(path, autopilot, 55.0, 8.0, 1.0)
    tell(path, autopilot, 55.001, 8.0, 20.0)
    heard = StreamMonitor(path)
    heard.read_new_frames_and_update_state()
    assert heard.distance_m == pytest.approx(math.radians(0.001) * 6_378_137.0, rel=0.01)
    assert heard.up_m == 20.0
