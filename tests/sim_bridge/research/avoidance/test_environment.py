"""The environment of row 10: observations, actions, rewards, and equal seeds."""

import statistics

import numpy as np
import pytest

from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance import policies
from sim_bridge.research.avoidance.compared_policies import StraightPolicy
from sim_bridge.research.avoidance.environment import (
    AvoidanceEnvironment,
    PaperReward,
    SwiftReward,
    action_headings_rad,
    observe_all_agents,
)
from sim_bridge.research.avoidance.evaluation import (
    FlightResults,
    evaluation_world,
    mean_and_ci95_half_width_by_episode,
    run_episodes,
)
from sim_bridge.research.avoidance.obstacle_paths import build_obstacle_paths
from sim_bridge.research.avoidance.scenes import CELL_M, Scene, draw_random_scene
from sim_bridge.research.avoidance.world import AvoidanceWorld

SIDE = 624  # cells of a raster: 800 m, and half a view's diagonal around it


def open_ground(*boxes: tuple[float, float, float, float]) -> Scene:
    """Return a scene with only these boxes (south, west, north, east); the truck in the middle."""
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
    """Return one windless episode with drones at these positions, reported without error."""
    world = AvoidanceWorld([scene], len(starts), wind=False)
    world.start_random_episodes([0])
    world.pos_m[0, :, :2], world.goal_ne_m[0] = starts, goals
    world.report_error_m[:] = 0.0
    world.returning[:] = False
    world.report_queue = [(world.pos_m.copy(), world.vel_mps.copy())] * len(world.report_queue)
    return world


def test_the_view_shows_walls_neighbours_and_their_goals_where_they_are() -> None:
    """Goal north, thus up: a wall 40 to 60 m north, a neighbour 50 m east, its goal 80 m south."""
    scene = open_ground((40.0, -20.0, 60.0, 20.0))
    world = placed(scene, [(0.0, 0.0), (0.0, 50.0)], [(300.0, 0.0), (-80.0, 0.0)])
    walls, near, goals = observe_all_agents(world).view[0, 0]
    rows, columns = np.nonzero(walls)
    assert 77 - rows.max() == pytest.approx(40.0 / CELL_M, abs=1)
    assert 77 - rows.min() == pytest.approx(60.0 / CELL_M, abs=1)
    assert abs(columns - 77).max() == pytest.approx(20.0 / CELL_M, abs=1)
    assert np.argwhere(near).mean(axis=0) == pytest.approx([77.0, 77.0 + 25.0])
    assert np.argwhere(goals).mean(axis=0) == pytest.approx([77.0 + 40.0, 77.0])


def test_with_the_goal_up_the_same_place_is_seen_turned() -> None:
    """The goal is east: a neighbour north of the drone is to the left."""
    world = placed(open_ground(), [(0.0, 0.0), (60.0, 0.0)], [(0.0, 300.0), (0.0, 300.0)])
    seen = observe_all_agents(world)
    assert np.argwhere(seen.view[0, 0, 1]).mean(axis=0) == pytest.approx([77.0, 77.0 - 30.0])
    assert seen.vectors_m[0, 0, :2] == pytest.approx([300.0, 0.0], abs=1e-3)
    assert action_headings_rad(world, np.zeros((1, 2, 2)))[0, 0] == pytest.approx(np.pi / 2)


def test_the_trucks_vector_is_nothing_while_a_customer_is_the_goal() -> None:
    world = placed(open_ground(), [(30.0, 0.0), (60.0, 0.0)], [(200.0, 0.0), (0.0, 0.0)])
    world.returning[0, 1] = True
    vectors = observe_all_agents(world).vectors_m[0]
    assert vectors[0] == pytest.approx([170.0, 0.0, 0.0, 0.0])
    assert vectors[1] == pytest.approx([60.0, 0.0, 60.0, 0.0], abs=1e-3)


def test_the_papers_reward_is_paid_as_it_is_written() -> None:
    """IV-B by hand: two hover at 30 m distance; -0.2, no progress, -400 / (900 + 50)."""
    world = placed(open_ground(), [(0.0, 0.0), (30.0, 0.0)], [(200.0, 0.0), (-200.0, 0.0)])
    env = AvoidanceEnvironment(world, PaperReward())
    hover = np.array([[[0.0, -1.0], [0.0, -1.0]]])
    assert env.fly_decision_and_return_rewards(hover)[0] == pytest.approx(
        [-0.2 - 400.0 / 950.0] * 2, abs=0.01
    )


def test_arriving_pays_twenty_and_ends_the_flight() -> None:
    world = placed(open_ground(), [(0.0, 0.0), (0.0, 390.0)], [(25.0, 0.0), (0.0, -390.0)])
    env = AvoidanceEnvironment(world, PaperReward())
    paid = env.fly_decision_and_return_rewards(np.array([[[0.0, 1.0], [-0.5, -1.0]]]))
    assert paid[0, 0] == pytest.approx(20.0 - 0.2 + 0.02 * 6.0, abs=0.1)
    assert not world.active[0, 0]
    assert env.fly_decision_and_return_rewards(np.zeros((1, 2, 2)))[0, 0] == 0.0


def test_an_action_is_a_heading_and_a_speed() -> None:
    """Half a turn to the right of north is east; the middle of [-1, 1] is half the speed."""
    world = placed(open_ground(), [(0.0, 0.0)], [(1e6, 0.0)])
    env = AvoidanceEnvironment(world, PaperReward())
    for _ in range(5):
        env.fly_decision_and_return_rewards(np.array([[[0.5, 0.0]]]))
    assert world.vel_mps[0, 0] == pytest.approx([0.0, 7.5, 0.0], abs=0.01)


def test_an_episode_follows_from_its_seed_whoever_flies_beside_it() -> None:
    scenes = [draw_random_scene(np.random.default_rng(k)) for k in range(2)]
    alone, among = AvoidanceWorld(scenes, 3), AvoidanceWorld(scenes, 3)
    alone.start_random_episodes([7])
    among.start_random_episodes([3, 7])
    for _ in range(20):
        for world in (alone, among):
            world.tick(StraightPolicy().choose_velocities_mps(world, 0))
    assert among.true_pos_m[1] == pytest.approx(alone.true_pos_m[0])


@pytest.mark.sample
def test_who_flies_straight_at_each_other_collides_by_truth_unless_filtered() -> None:
    """Eight drones, one town; true positions are judged, not reports."""
    world, seeds = evaluation_world(8, has_wind=True), [106]
    bare = run_episodes(world, StraightPolicy(), None, seeds)
    kept = run_episodes(world, StraightPolicy(), SeparationFilter(), seeds)
    assert bare.hit_drone.any()
    assert bare.hit_obstacle.any()
    assert not kept.hit_drone.any()
    assert not kept.hit_obstacle.any()
    assert kept.min_separation.min() >= 1.0


def test_drones_that_share_a_fate_count_once_in_an_interval() -> None:
    """Four equal drones in each of six episodes: the interval of six numbers, by `statistics`."""
    each = [1.1, 1.3, 1.2, 1.6, 1.15, 1.25]
    mean, half = mean_and_ci95_half_width_by_episode(np.repeat(each, 4), 4)
    assert mean == pytest.approx(statistics.mean(each))
    assert half == pytest.approx(1.96 * statistics.stdev(each) / 6**0.5)
    assert mean_and_ci95_half_width_by_episode(np.full(8, np.nan), 4) == (None, None)


def test_a_policys_flights_are_joined_and_counted() -> None:
    """Two episodes of two drones by hand; the last flight of the other policy did not arrive."""
    cases = [
        policies.Episodes(name, 2, 7, True, "x", "", k, 1)
        for name in ("maddpg", "none_filtered")
        for k in (0, 1)
    ]
    end = (True, False, False, 1.5, 1.25, 2.0)
    late = (False, False, True, None, None, 1.5)
    parts = [[end, end], [end, end], [end, (True, True, False, 1.25, 1.25, 0.5)], [end, late]]
    names = FlightResults.__dataclass_fields__
    told = [
        policies.EpisodesFlown(
            {name: [flight[k] for flight in part] for k, name in enumerate(names)}, [10.0, 30.0]
        )
        for part in parts
    ]
    found = policies.make_report(cases, told)
    ours, theirs = found.document["rows"]
    assert (ours["flights"], ours["goals"], ours["drone_collisions"]) == (4, 4, 0)
    assert (theirs["goals"], theirs["drone_collisions"], theirs["building_collisions"]) == (3, 1, 1)
    assert theirs["time_ratio_mean"] == pytest.approx((1.5 + 1.25 + 1.5) / 3.0)
    assert theirs["separation_min_m"] == 2.5
    assert theirs["decision_us_median"] == 20.0
    assert [str(cell) for cell in found.sheets["avoid"].rows[1][:5]] == [
        "2, 2", "`none_filtered`", "75.0%", "1 of 4 (< 75.14%)", "1"
    ]  # fmt: skip
    assert policies.make_report(cases[:2], told[:2]).document == ours


def test_the_shortest_way_round_a_box_bends_at_its_nearer_corner() -> None:
    """By hand: a wall from 60 m left to 20 m right, 40 m in front; the goal 100 m in front, behind
    it.

    The box is grown by 8.5 m, so the path leads over (31.5, 28.5) and (68.5, 28.5)."""
    ways = build_obstacle_paths([open_ground((40.0, -60.0, 60.0, 20.0))])
    scene, here, goal = np.array([0]), np.zeros((1, 2)), np.array([[100.0, 0.0]])
    bearing, length = ways.initial_bearing_and_path_length(
        scene, here, goal, ways.shortest_corner_to_goal_lengths_m(scene, goal)
    )
    assert length[0] == pytest.approx(2.0 * np.hypot(31.5, 28.5) + 37.0, abs=0.1)
    assert bearing[0] == pytest.approx(np.arctan2(28.5, 31.5), abs=0.01)


def test_the_swift_reward_is_what_a_decision_cost_in_seconds() -> None:
    """Hovering costs its 2 s; flying along the path at full speed, once fast, costs nothing."""
    world = placed(open_ground(), [(0.0, 0.0), (200.0, 0.0)], [(390.0, 0.0), (200.0, 390.0)])
    env = AvoidanceEnvironment(
        world, SwiftReward(), obstacle_paths=build_obstacle_paths(world.scenes)
    )
    act = np.array([[[0.0, 1.0], [0.0, -1.0]]])
    for _ in range(4):
        env.fly_decision_and_return_rewards(act)
    assert env.fly_decision_and_return_rewards(act)[0] == pytest.approx([0.0, -2.0], abs=0.02)
