"""The environment of row 10: what is seen, done and paid, and whose seeds are the same."""

import statistics
from pathlib import Path

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance import avoid_table
from sim_bridge.research.avoidance.environment import (
    AvoidEnvironment,
    PaperReward,
    SwiftReward,
    ViewFrame,
    heading_of,
    observe,
)
from sim_bridge.research.avoidance.evaluation import by_episode, evaluation_world, fly, upper95
from sim_bridge.research.avoidance.kept_flights import Evaluation, flights_of
from sim_bridge.research.avoidance.scenes import CELL_M, Scene, make_scene
from sim_bridge.research.avoidance.ways_around import ways_around
from sim_bridge.research.avoidance.world import AvoidanceWorld
from sim_bridge.research.avoidance.yardsticks import StraightOn

SIDE = 624  # cells of a raster: 800 m, and half a view's diagonal about it


def open_ground(*boxes: tuple[float, float, float, float]) -> Scene:
    """Nothing but these boxes (south, west, north, east); the truck in the middle."""
    obstacle = np.zeros((SIDE, SIDE), dtype=np.uint8)
    clearance = np.full((SIDE, SIDE), 500.0, dtype=np.float32)
    for south, west, north, east in boxes:
        rows = slice(int(south / CELL_M) + SIDE // 2, int(north / CELL_M) + SIDE // 2)
        columns = slice(int(west / CELL_M) + SIDE // 2, int(east / CELL_M) + SIDE // 2)
        obstacle[rows, columns] = 1
    return Scene(obstacle, clearance, np.array(boxes).reshape(-1, 4), np.zeros(2))


def placed(
    scene: Scene, starts: list[tuple[float, float]], goals: list[tuple[float, float]]
) -> AvoidanceWorld:
    """One still, windless episode with drones just there, reported without error."""
    world = AvoidanceWorld([scene], len(starts), wind=False)
    world.reset([0])
    world.pos_m[0, :, :2], world.goal_ne_m[0] = starts, goals
    world.report_error_m[:] = 0.0
    world.returning[:] = False
    world.published = [(world.pos_m.copy(), world.vel_mps.copy())] * len(world.published)
    return world


def test_the_view_shows_walls_neighbours_and_their_goals_where_they_are() -> None:
    """North up: a wall 40 to 60 m north, a neighbour 50 m east, its goal 80 m south."""
    scene = open_ground((40.0, -20.0, 60.0, 20.0))
    world = placed(scene, [(0.0, 0.0), (0.0, 50.0)], [(300.0, 0.0), (-80.0, 0.0)])
    walls, near, goals = observe(world, ViewFrame.NORTH).view[0, 0]
    rows, columns = np.nonzero(walls)
    assert 77 - rows.max() == pytest.approx(40.0 / CELL_M, abs=1)
    assert 77 - rows.min() == pytest.approx(60.0 / CELL_M, abs=1)
    assert abs(columns - 77).max() == pytest.approx(20.0 / CELL_M, abs=1)
    assert np.argwhere(near).mean(axis=0) == pytest.approx([77.0, 77.0 + 25.0])
    assert np.argwhere(goals).mean(axis=0) == pytest.approx([77.0 + 40.0, 77.0])


def test_with_the_goal_up_the_same_place_is_seen_turned() -> None:
    """The goal is east: a neighbour north of the drone is to the left."""
    world = placed(open_ground(), [(0.0, 0.0), (60.0, 0.0)], [(0.0, 300.0), (0.0, 300.0)])
    seen = observe(world, ViewFrame.GOAL)
    assert np.argwhere(seen.view[0, 0, 1]).mean(axis=0) == pytest.approx([77.0, 77.0 - 30.0])
    assert seen.vectors_m[0, 0, :2] == pytest.approx([300.0, 0.0], abs=1e-3)
    assert heading_of(world, np.zeros((1, 2, 2)), ViewFrame.GOAL)[0, 0] == pytest.approx(np.pi / 2)


def test_the_trucks_vector_is_nothing_while_a_customer_is_the_goal() -> None:
    world = placed(open_ground(), [(30.0, 0.0), (60.0, 0.0)], [(200.0, 0.0), (0.0, 0.0)])
    world.returning[0, 1] = True
    vectors = observe(world, ViewFrame.NORTH).vectors_m[0]
    assert vectors[0] == pytest.approx([170.0, 0.0, 0.0, 0.0])
    assert vectors[1] == pytest.approx([-60.0, 0.0, -60.0, 0.0])


def test_the_papers_reward_is_paid_as_it_is_written() -> None:
    """IV-B by hand: two hover 30 m apart; -0.2, no progress, -400 / (900 + 50)."""
    world = placed(open_ground(), [(0.0, 0.0), (30.0, 0.0)], [(200.0, 0.0), (-200.0, 0.0)])
    env = AvoidEnvironment(world, PaperReward())
    hover = np.array([[[0.0, -1.0], [0.0, -1.0]]])
    assert env.step(hover)[0] == pytest.approx([-0.2 - 400.0 / 950.0] * 2, abs=0.01)


def test_arriving_pays_twenty_and_ends_the_flight() -> None:
    world = placed(open_ground(), [(0.0, 0.0), (0.0, 390.0)], [(25.0, 0.0), (0.0, -390.0)])
    env = AvoidEnvironment(world, PaperReward())
    paid = env.step(np.array([[[0.0, 1.0], [-0.5, -1.0]]]))
    assert paid[0, 0] == pytest.approx(20.0 - 0.2 + 0.02 * 6.0, abs=0.1)
    assert not world.active[0, 0]
    assert env.step(np.zeros((1, 2, 2)))[0, 0] == 0.0


def test_an_action_is_a_heading_and_a_speed() -> None:
    """Half a turn to the right of north is east; the middle of [-1, 1] is half the speed."""
    world = placed(open_ground(), [(0.0, 0.0)], [(300.0, 0.0)])
    env = AvoidEnvironment(world, PaperReward())
    for _ in range(5):
        env.step(np.array([[[0.5, 0.0]]]))
    assert world.vel_mps[0, 0] == pytest.approx([0.0, 7.5, 0.0], abs=0.01)


def test_an_episode_follows_from_its_seed_whoever_flies_beside_it() -> None:
    scenes = [make_scene(np.random.default_rng(k)) for k in range(2)]
    alone, among = AvoidanceWorld(scenes, 3), AvoidanceWorld(scenes, 3)
    alone.reset([7])
    among.reset([3, 7])
    for _ in range(20):
        for world in (alone, among):
            world.tick(StraightOn().wanted(world, 0))
    assert among.true_pos_m[1] == pytest.approx(alone.true_pos_m[0])


def test_who_flies_straight_at_each_other_collides_by_truth_unless_filtered() -> None:
    """Eight drones, one town; what is judged are true places, not reports."""
    world, seeds = evaluation_world(8, wind=True), [106]
    bare = fly(world, StraightOn(), None, seeds)
    kept = fly(world, StraightOn(), SeparationFilter(), seeds)
    assert bare.hit_drone.any()
    assert bare.hit_building.any()
    assert not kept.hit_drone.any()
    assert not kept.hit_building.any()
    assert kept.apart.min() >= 1.0


def test_the_upper_bound_of_no_collisions_is_the_rule_of_three() -> None:
    """Hanley and Lippman-Hand, JAMA 249, 1983: 3 / n."""
    assert upper95(0, 4000) == pytest.approx(3.0 / 4000, rel=0.01)
    assert upper95(5, 5) == 1.0


def test_drones_that_share_a_fate_count_once_in_an_interval() -> None:
    """Four drones alike in each of six episodes: the interval of six numbers, by `statistics`."""
    each = [1.1, 1.3, 1.2, 1.6, 1.15, 1.25]
    mean, half = by_episode(np.repeat(each, 4), 4)
    assert mean == pytest.approx(statistics.mean(each))
    assert half == pytest.approx(1.96 * statistics.stdev(each) / 6**0.5)
    assert by_episode(np.full(8, np.nan), 4) == (None, None)


def test_the_table_joins_kept_episodes_up_to_the_first_gap(tmp_path: Path) -> None:
    """Counts by hand: two drones, 25 episodes kept from 0 on, and 25 after a gap."""
    asked = Evaluation("none", 2, 7, True)
    (few,) = flights_of(asked, 2, evaluation_world(2, wind=True), StraightOn(), None, tmp_path)
    asked.path(tmp_path, 0, 2).rename(asked.path(tmp_path, 0, 25))
    asked.path(tmp_path, 50, 25).write_bytes(asked.path(tmp_path, 0, 25).read_bytes())
    (row,) = avoid_table.rows_of(tmp_path)
    assert (row.policy, row.agents, row.episodes) == ("none", 2, 25)
    assert row.flights.arrived.tolist() == few.arrived.tolist()
    (tmp_path / "other.npz").touch()
    with pytest.raises(LeewayError, match=r"other\.npz"):
        avoid_table.rows_of(tmp_path)


def test_it_is_a_parallel_environment_by_pettingzoos_own_test() -> None:
    pytest.importorskip("pettingzoo", reason="needs leeway-uas[train]")
    from pettingzoo.test import parallel_api_test

    from sim_bridge.research.avoidance.parallel_env import AvoidParallelEnv

    parallel_api_test(AvoidParallelEnv(agents=3, scenes=1), num_cycles=30)


def test_the_shortest_way_round_a_box_bends_at_its_nearer_corner() -> None:
    """By hand: a wall from 60 m left to 20 m right, 40 m ahead; the goal 100 m ahead, behind it.

    The box is grown by 8.5 m, so the way leads over (31.5, 28.5) and (68.5, 28.5).
    """
    ways = ways_around([open_ground((40.0, -60.0, 60.0, 20.0))])
    scene, here, goal = np.array([0]), np.zeros((1, 2)), np.array([[100.0, 0.0]])
    bearing, length = ways.next_leg(scene, here, goal, ways.from_corners_m(scene, goal))
    assert length[0] == pytest.approx(2.0 * np.hypot(31.5, 28.5) + 37.0, abs=0.1)
    assert bearing[0] == pytest.approx(np.arctan2(28.5, 31.5), abs=0.01)


def test_the_swift_reward_is_what_a_decision_cost_in_seconds() -> None:
    """Hovering costs its 2 s; flying along the way at full speed, once fast, costs nothing."""
    world = placed(open_ground(), [(0.0, 0.0), (200.0, 0.0)], [(390.0, 0.0), (200.0, 390.0)])
    env = AvoidEnvironment(world, SwiftReward(), ways=ways_around(world.scenes))
    act = np.array([[[0.0, 1.0], [0.0, -1.0]]])
    for _ in range(4):
        env.step(act)
    assert env.step(act)[0] == pytest.approx([0.0, -2.0], abs=0.02)


def test_flights_that_are_kept_are_not_flown_again(tmp_path: Path) -> None:
    asked, world = Evaluation("none", 2, 9, wind=True), evaluation_world(2, wind=True)
    (first,) = flights_of(asked, 2, world, StraightOn(), None, tmp_path)
    (again,) = flights_of(asked, 2, AvoidanceWorld([], 2), StraightOn(), None, tmp_path)
    assert again.time_ratio == pytest.approx(first.time_ratio, nan_ok=True)
    assert [f.suffix for f in tmp_path.iterdir()] == [".npz"]
