"""Two vehicles, one of each autopilot, head on in one layer, each with its real companion.

Separation is judged by truth. `sim-bridge cross` flies the whole scene
(docs/explanation/avoidance.md).
"""

import contextlib

import pytest

from sim_bridge.app.crossing.crossing import Crossing, CrossOptions
from sim_bridge.app.crossing.judge import Nearest, find_minimum_separation
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.mission.executor import Phase

SHORT = {
    "vehicles": 2,
    "ring_radius_m": 40.0,
    "customer_distance_m": 60.0,
    "customer_bearing_spread_rad": 0.0,  # nose to nose
    "cruise_height_m": 20.0,
}
ASIDE_S = 5.0


@pytest.fixture
def make_scene(tmp_path):
    with contextlib.ExitStack() as stack:

        def make(**wish) -> Crossing:
            scene = Crossing(CrossOptions(seed=4, **SHORT, **wish), tmp_path)
            stack.callback(scene.stop_companions)
            return scene

        yield make


def nearest(scene: Crossing) -> Nearest | None:
    return find_minimum_separation([c.build_vehicle_track() for c in scene.crossers])


def on_for(scene: Crossing, seconds: float) -> None:
    end_s = scene.clock.t_s + seconds
    while scene.clock.t_s < end_s:
        scene.advance_one_step()


@pytest.mark.sample
def test_both_autopilots_keep_apart_and_go_home_or_on_when_their_companions_die(make_scene):
    scene = make_scene()
    while min(c.setpoint_time_s for c in scene.crossers) < ASIDE_S:
        scene.advance_one_step()
        assert scene.clock.t_s < 90.0, [c.setpoint_time_s for c in scene.crossers]
    px4, ardupilot = (c.drone.power_cycle.autopilot for c in scene.crossers)
    assert px4.mode is Mode.GUIDED
    assert ardupilot.mode is Mode.AUTO
    assert ardupilot.executor.leg.phase is Phase.GUIDED
    kept = nearest(scene)
    assert kept is not None
    assert kept.separations >= 1.0

    for number in range(2):  # permanently, in the middle of the encounter
        scene.kill_companion(number)
    on_for(scene, 3.0)
    assert px4.mode is Mode.RTL
    on_for(scene, 9.0)
    assert ardupilot.mode is Mode.AUTO
    assert ardupilot.executor.leg.phase is not Phase.GUIDED  # it continues its mission


@pytest.mark.sample
def test_the_same_without_the_filter_breaks_the_separation(make_scene):
    scene = make_scene(separation_filter=False)
    near = None
    while scene.clock.t_s < 90.0:
        on_for(scene, 1.0)
        near = nearest(scene)
        if near is not None and near.separations < 1.0:
            break
    assert near is not None
    assert near.separations < 1.0
    assert min(c.setpoint_time_s for c in scene.crossers) > 0.0


@pytest.mark.night
@pytest.mark.parametrize("neighbours", [True, False], ids=["kept apart", "canary: deaf"])
def test_two_fleets_whose_vehicles_have_one_name_keep_apart(make_scene, neighbours):
    """Nose to nose, each on its own fleet's network; both are named d1."""
    scene = make_scene(fleets=2, neighbours=neighbours)
    assert [c.drone.name for c in scene.crossers] == ["d1", "d1"]
    broken = False
    while not broken and not all(c.has_ended_on_ground for c in scene.crossers):
        on_for(scene, 1.0)
        near = nearest(scene)
        broken = near is not None and near.separations < 1.0
        assert scene.clock.t_s < 240.0
    assert broken is not neighbours
    assert all((c.setpoint_time_s > ASIDE_S) is neighbours for c in scene.crossers)
