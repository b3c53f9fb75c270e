"""A flight of ten seconds counts as a flight: armed, airborne by the land detector, landed."""

import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.adapters.logs.open_log import read_log_of_any_format
from companion.app.cli.main import app
from companion.core.mission.events import GroundState, VehicleLandedState

SHARED = Path(__file__).parents[3] / "shared" / "data" / "sample_px4_events.ulg"
NAME = "sample_px4_events.ulg"


def of_pyulog() -> Path | None:
    """Return PX4's own short flight from the tests of pyulog's repository, if present next to the
    installed package or under ../shared/data.
    """
    found = find_spec("pyulog")
    beside = Path(found.origin).parent if found and found.origin else Path()
    places = (beside / NAME, beside / "test" / NAME, SHARED)
    return next((path for path in places if path.is_file()), None)


def in_air_s(path: Path) -> float:
    """Return the seconds between the log's "in the air" and "on the ground" (else its end)."""
    changes = [
        event for event in read_log_of_any_format(path).events if isinstance(event, GroundState)
    ]
    up = next(event.t_s for event in changes if event.ground is VehicleLandedState.IN_AIR)
    down = [
        event.t_s
        for event in changes
        if event.ground is VehicleLandedState.ON_GROUND and event.t_s > up
    ]
    return (down[0] if down else changes[-1].t_s) - up


def replayed_air_s(path: Path) -> float:
    """Return the flight time printed by `companion replay`."""
    done = CliRunner().invoke(app, ["replay", str(path)])
    assert done.exit_code == 0, done.output
    found = re.search(r"(\d+) s in the air", done.output)
    assert found is not None, done.output
    return float(found[1])


def test_a_hop_of_ten_seconds_is_told_as_long_as_the_log_says(make, tmp_path):
    world = make.build_square_flight()
    hop = world.select_rows(world.t_s < 31.0)
    flying = (hop.t_s > 12.0) & (hop.t_s <= 22.0)
    still = replace(hop, flying=flying, vel_ned_mps=np.where(flying[:, None], hop.vel_ned_mps, 0.0))
    path = make.ulog(tmp_path / "hop.ulg", still)
    assert in_air_s(path) == pytest.approx(10.0, abs=0.2)
    assert replayed_air_s(path) == pytest.approx(10.0, abs=1.0)


def test_a_log_that_never_left_the_ground_has_no_time_in_the_air(make, tmp_path):
    world = make.build_square_flight()
    rest = world.select_rows(world.t_s < 8.0)
    path = make.ulog(tmp_path / "rest.ulg", rest)
    assert replayed_air_s(path) == 0.0


def test_pyulogs_own_short_flight_is_no_flight_of_0_s():
    path = of_pyulog()
    if path is None:
        pytest.skip(f"{NAME} of PX4/pyulog's tests is neither beside pyulog nor at {SHARED}")
    assert in_air_s(path) == pytest.approx(10.0, abs=2.0)
    assert replayed_air_s(path) == pytest.approx(in_air_s(path), abs=1.0)
