"""A second ground station really does to an autopilot what its row says."""

from types import SimpleNamespace

import numpy as np
import pytest

from companion.core.base.place import Place
from sim_bridge.app.faults.people import Station, dragged, foreign
from sim_bridge.app.faults.stage import Stage
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mission.items import MissionItem
from tests.sim_bridge.autopilot.conftest import HOME, Rig

RELATIVE = 6
PLACES = [(554700000 + 1000 * k, 84500000) for k in range(5)]


def items() -> list[MissionItem]:
    """Home's place, a take-off and three waypoints."""
    take_off = MissionItem(22, RELATIVE, x=PLACES[1][0], y=PLACES[1][1], z=30.0)
    ways = [MissionItem(16, RELATIVE, x=x, y=y, z=30.0) for x, y in PLACES[2:]]
    return [MissionItem(16, RELATIVE, x=PLACES[0][0], y=PLACES[0][1], z=0.0), take_off, *ways]


class Craft:
    """A rig with what a station needs of a craft."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.number = rig, 1
        self.autopilot: Autopilot = rig.ap
        self.depot = Place(lat_deg=HOME[0], lon_deg=HOME[1], alt_amsl_m=HOME[2])
        self.others: dict[int, object] = {}


@pytest.fixture(params=list(AutopilotKind), ids=lambda kind: kind.value)
def stage(request):
    rig = Rig(request.param)
    return Stage(Craft(rig), np.random.default_rng(1), SimpleNamespace(), "outbound")


def play(stage: Stage, steps) -> None:
    """Let a play go on, 0.1 s at a time, as a flight does."""
    craft = stage.craft
    for _ in steps:
        for _ in range(5):
            craft.rig.ap.step(craft.rig.vehicle.step(craft.rig.ap.actuation, 0.02), 0.02)
        for link, frame in craft.rig.ap.take_outbox():
            if link in craft.others:
                craft.others[link](stage.t_s, frame)
        stage.t_s += 0.1


def waypoints(stage: Stage) -> list[int]:
    return [item.y for item in stage.craft.autopilot.store.mission if item.command == 16][-3:]


def test_an_edit_of_the_same_length_moves_one_waypoint_and_no_other(stage):
    station = Station(stage)
    play(stage, station.upload(items()))
    before = waypoints(stage)
    assert before == [84500000] * 3
    play(stage, station.upload(dragged(items(), 2, 1500.0)))
    moved = [after != was for after, was in zip(waypoints(stage), before, strict=True)]
    assert moved == [False, True, False]
    east_m = (waypoints(stage)[1] - before[1]) / 1e7 * 111_195.0 * np.cos(np.radians(55.47))
    assert east_m == pytest.approx(1500.0, rel=0.001)


def test_a_foreign_upload_is_as_long_and_lies_elsewhere(stage):
    station = Station(stage)
    play(stage, station.upload(items()))
    before, length = waypoints(stage), len(stage.craft.autopilot.store.mission)
    play(stage, station.upload(foreign(items(), 3000.0)))
    assert len(stage.craft.autopilot.store.mission) == length
    assert all(after != was for after, was in zip(waypoints(stage), before, strict=True))


def test_an_upload_that_is_cut_leaves_an_atomic_autopilot_as_it_was(stage):
    station = Station(stage)
    play(stage, station.upload(items()))
    before = waypoints(stage)
    play(stage, station.upload(foreign(items(), 3000.0), stop_after=2))
    play(stage, iter(range(20)))
    assert waypoints(stage)[-1] == before[-1]


def test_a_cleared_mission_is_gone(stage):
    station = Station(stage)
    play(stage, station.upload(items()))
    station.clear()
    play(stage, iter(range(10)))
    assert not [item for item in stage.craft.autopilot.store.mission if item.command == 22]


def test_home_is_set_where_the_row_says(stage):
    station = Station(stage)
    play(stage, iter(range(50)))
    before = stage.craft.autopilot.state.home_ned_m
    station.set_home(north_m=3000.0, up_m=-20.0)
    play(stage, iter(range(10)))
    moved = np.subtract(stage.craft.autopilot.state.home_ned_m, before)
    assert moved == pytest.approx([3000.0, 0.0, 20.0], abs=8.0)
