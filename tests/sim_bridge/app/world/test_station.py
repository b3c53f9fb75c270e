"""A second ground station affects an autopilot as its row states."""

from collections.abc import Iterable

import numpy as np
import pytest

from companion.core.base.location import Location
from sim_bridge.app.world.companion_link import CompanionLink
from sim_bridge.app.world.station import Station, shift_mission_east, shift_next_waypoint_east
from sim_bridge.app.world.vehicle_host import STEPS_PER_EXCHANGE, Home
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mission.items import MissionItem
from tests.sitl.served import on_the_ground

RELATIVE = 6
HOME = Home()
DEPOT = Location(lat_deg=HOME.lat_deg, lon_deg=HOME.lon_deg, alt_amsl_m=HOME.alt_amsl_m)
PLACES = [(554700000 + 1000 * k, 84500000) for k in range(5)]


def items() -> list[MissionItem]:
    """Return the home position, a take-off and three waypoints."""
    take_off = MissionItem(22, RELATIVE, x=PLACES[1][0], y=PLACES[1][1], z=30.0)
    ways = [MissionItem(16, RELATIVE, x=x, y=y, z=30.0) for x, y in PLACES[2:]]
    return [MissionItem(16, RELATIVE, x=PLACES[0][0], y=PLACES[0][1], z=0.0), take_off, *ways]


@pytest.fixture(params=list(AutopilotKind))
def station(request) -> Station:
    return Station(CompanionLink(on_the_ground(request.param, boot_age_s=60.0), 1))


def play(station: Station, steps: Iterable[object]) -> None:
    """Run a procedure in steps of 0.1 s, as a flight does."""
    for _ in steps:
        station.companion_link.host.advance(STEPS_PER_EXCHANGE)
        station.companion_link.discard_companion_frames()


def onboard(station: Station) -> list[MissionItem]:
    return list(station.companion_link.host.autopilot.store.mission)


def waypoints(station: Station) -> list[int]:
    return [item.y for item in onboard(station) if item.command == 16][-3:]


def test_an_edit_of_the_same_length_moves_one_waypoint_and_no_other(station):
    play(station, station.upload_mission(items()))
    before = waypoints(station)
    assert before == [84500000] * 3
    play(station, station.upload_mission(shift_next_waypoint_east(items(), 2, 1500.0)))
    moved = [after != was for after, was in zip(waypoints(station), before, strict=True)]
    assert moved == [False, True, False]
    east_m = (waypoints(station)[1] - before[1]) / 1e7 * 111_195.0 * np.cos(np.radians(55.47))
    assert east_m == pytest.approx(1500.0, rel=0.001)


def test_a_foreign_upload_is_as_long_and_lies_elsewhere(station):
    play(station, station.upload_mission(items()))
    before, length = waypoints(station), len(onboard(station))
    play(station, station.upload_mission(shift_mission_east(items(), 3000.0)))
    assert len(onboard(station)) == length
    assert all(after != was for after, was in zip(waypoints(station), before, strict=True))


def test_an_upload_that_is_cut_leaves_an_atomic_autopilot_as_it_was(station):
    play(station, station.upload_mission(items()))
    before = waypoints(station)
    play(station, station.upload_mission(shift_mission_east(items(), 3000.0), stop_after_items=2))
    play(station, iter(range(20)))
    assert waypoints(station)[-1] == before[-1]


def test_a_cleared_mission_is_gone(station):
    play(station, station.upload_mission(items()))
    station.send_mission_clear_all()
    play(station, iter(range(10)))
    assert not [item for item in onboard(station) if item.command == 22]


def test_home_is_set_where_the_row_says(station):
    play(station, iter(range(50)))
    before = station.companion_link.host.autopilot.state.home_ned_m
    station.send_set_home_at_offset(DEPOT, north_m=3000.0, up_m=-20.0)
    play(station, iter(range(10)))
    moved = np.subtract(station.companion_link.host.autopilot.state.home_ned_m, before)
    assert moved == pytest.approx([3000.0, 0.0, 20.0], abs=8.0)
