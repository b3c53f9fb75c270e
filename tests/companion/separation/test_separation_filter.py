"""The safety filter against adversaries; the vehicles are this file's own double integrators."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.base.errors import LeewayError
from companion.core.separation.separation_filter import FilterAction, SeparationFilter
from companion.core.separation.stopping_paths import Neighbours, SeparationParams
from companion.core.separation.traffic_tracks import (
    INCONSISTENCY_DECAY_S,
    TRACK_LIFETIME_S,
    NeighbourReport,
    NeighbourTracks,
)

TICK_S, LATE_TICKS = 0.2, 1
FASTEST_MPS, ACCEL_MPS2, CLIMB_ACCEL_MPS2 = 15.0, 3.0, 2.0
HORIZONTAL_M, VERTICAL_M = 5.0, 4.0  # docs/reference/benchmarks.md, avoidance
STD_M = 2.0
Arrays = np.ndarray


def neighbours_of(
    pos: Arrays, vel: Arrays, age_s: float = TICK_S, std_m: float = STD_M
) -> Neighbours:
    shape = pos.shape[:2]
    return Neighbours(
        pos,
        vel,
        np.full(shape, age_s),
        np.full(shape, std_m),
        np.full(shape, 0.5),
        np.full(shape, 0.1),
        np.ones(shape, dtype=bool),
    )


def limited(velocity: Arrays, wanted: Arrays) -> Arrays:
    """Return the velocity that the vehicle can reach in a tick for any command."""
    change = wanted - velocity
    flat = np.linalg.norm(change[:, :2], axis=1, keepdims=True)
    change[:, :2] *= np.minimum(1.0, ACCEL_MPS2 * TICK_S / np.maximum(flat, 1e-9))
    change[:, 2] = np.clip(change[:, 2], -CLIMB_ACCEL_MPS2 * TICK_S, CLIMB_ACCEL_MPS2 * TICK_S)
    return velocity + change


def flown(
    pos: Arrays,
    wanted: Callable[[Arrays, int], Arrays],
    error: Callable[[Arrays, int], Arrays],
    filtered: bool = True,
    ticks: int = 150,
    std_m: float = STD_M,
) -> float:
    """Return the least separation, in cylinders, for these commands and report errors."""
    count, velocity = len(pos), np.zeros_like(pos)
    others = np.array([[j for j in range(count) if j != i] for i in range(count)])
    layers = 8.0 * (np.arange(count) % 3 - 1.0)
    published = [(pos, velocity)] * (LATE_TICKS + 1)
    least = np.inf
    for tick in range(ticks):
        told = wanted(pos, tick)
        if filtered:
            said_pos, said_vel = published[0]
            said = (said_pos + error(pos, tick))[others]
            heard = neighbours_of(said, said_vel[others], std_m=std_m)
            told = (
                SeparationFilter()
                .nearest_safe_velocities(pos, velocity, told, heard, layers)
                .vel_ned_mps
            )
        new = limited(velocity, told)
        for share in np.linspace(0.1, 1.0, 10):
            here = pos + TICK_S * (velocity * share + 0.5 * (new - velocity) * share**2)
            away = here[:, None] - here[None]
            flat = np.hypot(away[..., 0], away[..., 1]) / HORIZONTAL_M
            apart = np.maximum(flat, np.abs(away[..., 2]) / VERTICAL_M)
            least = min(least, float(apart[~np.eye(count, dtype=bool)].min()))
        pos, velocity = here, new
        published = [*published[1:], (pos, velocity)]
    return least


def towards(points: Arrays, targets: Arrays) -> Arrays:
    way = targets - points
    return FASTEST_MPS * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)


def spread_out(count: int, seed: int) -> Arrays:
    random = np.random.default_rng(seed)
    angle = 2.0 * np.pi * (np.arange(count) + random.uniform(0.0, 0.5, count)) / count
    return np.stack([60.0 * np.cos(angle), 60.0 * np.sin(angle), np.zeros(count)], axis=-1)


def worst_error(pos: Arrays, random: np.random.Generator) -> Arrays:
    """Three sigma, drawn each tick: half of the time all vehicles seem farther from the middle."""
    if random.random() < 0.5:
        away = pos - pos.mean(axis=0)
    else:
        away = random.standard_normal(pos.shape)
    away[:, 2] = 0.0
    return 3.0 * STD_M * away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(count=st.integers(2, 5), seed=st.integers(0, 10_000), hunts=st.booleans())
def test_separation_holds_whatever_everybody_wants_and_however_wrong_the_reports_are(
    count: int, seed: int, hunts: bool
) -> None:
    random = np.random.default_rng(seed)

    def wanted(pos: Arrays, tick: int) -> Arrays:
        if hunts:
            return towards(pos, np.roll(pos, 1 + tick // 40, axis=0))
        wish = random.uniform(-1.0, 1.0, pos.shape) * [FASTEST_MPS, FASTEST_MPS, 3.0]
        return np.where(random.random((count, 1)) < 0.2, wish, towards(pos, 0.0 * pos))

    least = flown(spread_out(count, seed), wanted, lambda p, _: worst_error(p, random), ticks=80)
    assert least >= 1.0


@pytest.mark.parametrize("count", [2, 4])
def test_without_the_filter_the_same_wishes_collide(count: int) -> None:
    start = spread_out(count, 1)
    least = flown(start, lambda p, _: towards(p, -start), lambda p, _: 0.0 * p, filtered=False)
    assert least < 1.0


def test_a_filter_told_that_reports_are_exact_is_broken_by_their_errors() -> None:
    """The canary of the margin: the same adversary, an error that is not allowed for."""
    start = np.array([[-40.0, 0.0, 0.0], [40.0, 0.0, 0.0]])

    def farther(pos: Arrays, _: int) -> Arrays:
        return 6.0 * STD_M * np.sign(start)

    hunting = lambda p, _: towards(p, p[::-1])  # noqa: E731
    assert flown(start, hunting, farther, std_m=0.01) < 1.0


def test_a_wish_that_disturbs_nobody_is_passed_unchanged() -> None:
    pos, vel = np.zeros((1, 3)), np.array([[10.0, 0.0, 0.0]])
    behind = neighbours_of(np.array([[[-60.0, 0.0, 0.0]]]), np.array([[[-5.0, 0.0, 0.0]]]))
    wanted = np.array([[10.5, 0.0, 0.0]])
    found = SeparationFilter().nearest_safe_velocities(pos, vel, wanted, behind, np.array([8.0]))
    assert found.verdict[0] == FilterAction.PASSED
    assert found.vel_ned_mps == pytest.approx(wanted)


def test_two_that_meet_head_on_are_bent_before_their_braking_ways_meet() -> None:
    """At 15 m/s and 3 m/s2 braking takes 37.5 m: 75 m, 5 m and the errors are too near."""
    pos, vel = np.zeros((1, 3)), np.array([[15.0, 0.0, 0.0]])
    verdicts = [
        SeparationFilter()
        .nearest_safe_velocities(
            pos,
            vel,
            vel,
            neighbours_of(np.array([[[away, 0.0, 0.0]]]), np.array([[[-15.0, 0.0, 0.0]]])),
            np.array([8.0]),
        )
        .verdict[0]
        for away in (150.0, 80.0)
    ]
    assert verdicts[0] == FilterAction.PASSED
    assert verdicts[1] != FilterAction.PASSED


def test_many_vehicles_at_once_are_filtered_as_each_alone() -> None:
    random = np.random.default_rng(5)
    pos, vel = random.normal(0.0, 30.0, (12, 3)), random.normal(0.0, 5.0, (12, 3))
    pos[:, 2], vel[:, 2] = 0.0, 0.0
    wanted = random.normal(0.0, 8.0, (12, 3))
    their_pos = random.normal(0.0, 60.0, (12, 6, 3))
    heard = neighbours_of(their_pos, random.normal(0.0, 6.0, (12, 6, 3)) * [1.0, 1.0, 0.0])
    layers = np.linspace(-8.0, 8.0, 12)
    together = SeparationFilter().nearest_safe_velocities(pos, vel, wanted, heard, layers)
    for k in range(12):
        row = np.array([k])
        alone = SeparationFilter().nearest_safe_velocities(
            pos[row], vel[row], wanted[row], heard.select_by_index(row), layers[row]
        )
        assert alone.vel_ned_mps[0] == pytest.approx(together.vel_ned_mps[k], abs=1e-6)
        assert alone.verdict[0] == together.verdict[k]


def test_no_one_flies_into_a_wall_that_stands_in_the_way() -> None:
    """A wall from 60 m north on; the vehicle wants through at full speed."""
    pos, vel = np.zeros((1, 3)), np.zeros((1, 3))
    nobody = neighbours_of(np.zeros((1, 0, 3)), np.zeros((1, 0, 3)))
    wanted = np.array([[FASTEST_MPS, 0.0, 0.0]])
    farthest = 0.0
    for _ in range(120):
        found = SeparationFilter().nearest_safe_velocities(
            pos, vel, wanted, nobody, np.zeros(1), lambda points, _: 60.0 - points[..., 0]
        )
        new = limited(vel, found.vel_ned_mps)
        pos, vel = pos + 0.5 * TICK_S * (vel + new), new
        farthest = max(farthest, float(pos[0, 0]))
    assert 40.0 < farthest <= 60.0 - SeparationParams().obstacle_m


def test_a_wish_that_is_no_number_brakes() -> None:
    vel = np.array([[6.0, 0.0, 0.0]])
    nobody = neighbours_of(np.zeros((1, 0, 3)), np.zeros((1, 0, 3)))
    found = SeparationFilter().nearest_safe_velocities(
        np.zeros((1, 3)), vel, np.full((1, 3), np.nan), nobody, np.zeros(1)
    )
    assert found.vel_ned_mps[0] == pytest.approx([6.0 - ACCEL_MPS2 * TICK_S, 0.0, 0.0])


def test_a_silent_neighbour_is_given_more_room_the_longer_it_is_silent() -> None:
    pos, vel = np.zeros((1, 3)), np.array([[5.0, 0.0, 0.0]])
    place, still = np.array([[[32.0, 0.0, 0.0]]]), np.zeros((1, 1, 3))
    fresh, old = (
        SeparationFilter().nearest_safe_velocities(
            pos, vel, vel, neighbours_of(place, still, age), np.array([8.0])
        )
        for age in (0.2, 2.0)
    )
    assert fresh.verdict[0] == FilterAction.PASSED
    assert old.verdict[0] != FilterAction.PASSED


def test_one_that_does_not_give_way_is_dodged_though_nothing_is_promised() -> None:
    """It flies straight at a vehicle that hovers: 0 m without the filter."""
    pos, vel = np.zeros((1, 3)), np.zeros((1, 3))
    theirs, speed = np.array([[[-90.0, 0.0, 0.0]]]), np.array([[[12.0, 0.0, 0.0]]])
    least = np.inf
    for _ in range(75):
        heard = neighbours_of(theirs - TICK_S * speed, speed)
        found = SeparationFilter().nearest_safe_velocities(
            pos, vel, np.zeros((1, 3)), heard, np.array([-8.0])
        )
        new = limited(vel, found.vel_ned_mps)
        pos, vel, theirs = pos + 0.5 * TICK_S * (vel + new), new, theirs + TICK_S * speed
        away = pos - theirs[0]
        flat = np.hypot(away[0, 0], away[0, 1]) / HORIZONTAL_M
        least = min(least, max(flat, abs(away[0, 2]) / VERTICAL_M))
    assert least > 1.0


@pytest.mark.parametrize("beside_m", [9.0, 10.0, 12.0])
def test_backing_out_from_one_neighbour_never_leads_towards_another(beside_m: float) -> None:
    """Found in flight: at rest between two, both too near to be certain, one of them nearer."""
    pos, still = np.zeros((1, 3)), np.zeros((1, 3))
    two = np.array([[[8.0, 0.0, 0.0], [-beside_m, 0.0, 0.0]]])
    heard = neighbours_of(two, np.zeros_like(two))
    wish = np.array([[-15.0, 0.0, 0.0]])
    both = SeparationFilter().nearest_safe_velocities(pos, still, wish, heard, np.array([0.0]))
    assert abs(float(both.vel_ned_mps[0, 0])) < 0.02
    alone = neighbours_of(two[:, :1], np.zeros((1, 1, 3)))
    away = SeparationFilter().nearest_safe_velocities(pos, still, wish, alone, np.array([0.0]))
    assert float(away.vel_ned_mps[0, 0]) < -0.5


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    flat_m=st.floats(0.5, 11.0),
    down_m=st.floats(-5.0, 5.0),
    towards_rad=st.floats(0.0, 6.28),
    seed=st.integers(0, 10_000),
)
def test_who_stands_too_near_to_be_certain_comes_nearer_to_no_place_where_the_other_may_be(
    flat_m: float, down_m: float, towards_rad: float, seed: int
) -> None:
    """Found in flight: one climbed away from a neighbour and drifted over it while it did so."""
    random = np.random.default_rng(seed)
    pos, still = np.zeros((1, 3)), np.zeros((1, 3))
    said = np.array([[[flat_m, 0.0, down_m]]])
    wish = FASTEST_MPS * np.array([[np.cos(towards_rad), np.sin(towards_rad), 0.0]])
    heard = neighbours_of(said, np.zeros_like(said))
    vel = (
        SeparationFilter()
        .nearest_safe_velocities(pos, still, wish, heard, np.array([8.0]))
        .vel_ned_mps[0]
    )
    stop_s = np.linalg.norm(vel[:2]) / ACCEL_MPS2, abs(vel[2]) / CLIMB_ACCEL_MPS2
    moved = 0.5 * TICK_S * vel + 0.5 * vel * [stop_s[0], stop_s[0], stop_s[1]]
    angle, reach = random.uniform(0.0, 2.0 * np.pi, 400), 3.0 * STD_M * random.random(400) ** 0.5
    error = np.stack([reach * np.cos(angle), reach * np.sin(angle), 0.0 * angle], axis=-1)
    error[:, 2] = 1.5 * random.uniform(-1.0, 1.0, 400)
    true = said[0] + error

    def apart(away: Arrays) -> Arrays:
        flat = np.hypot(away[:, 0], away[:, 1]) / HORIZONTAL_M
        return np.maximum(flat, np.abs(away[:, 2]) / VERTICAL_M)

    began = apart(true)
    assert (apart(true - moved)[began >= 1.0] >= 1.0 - 1e-6).all()


def test_params_that_are_not_above_zero_are_refused_by_name() -> None:
    with pytest.raises(LeewayError, match="accel_mps2"):
        SeparationParams(accel_mps2=0.0)


REPORT = NeighbourReport("b", 10.0, (100.0, 0.0, 0.0), (5.0, 0.0, 0.0))


def spread(tracks: NeighbourTracks, t_s: float) -> float:
    return float(tracks.to_separation_filter_input(t_s).pos_std_m[0, 0])


def test_a_neighbour_that_flies_as_it_says_is_taken_at_its_word() -> None:
    tracks = NeighbourTracks().copy_with_report_if_newer(REPORT, 10.2)
    later = replace(REPORT, t_s=12.0, pos_ned_m=(110.0, 1.0, 0.0))
    tracks = tracks.copy_with_report_if_newer(later, 12.2)
    assert spread(tracks, 12.2) == pytest.approx(2.0)
    assert tracks.to_separation_filter_input(12.2).age_s[0, 0] == pytest.approx(0.2)


def test_a_jump_is_believed_and_doubted_by_as_far_as_it_went_for_a_while() -> None:
    jumped = replace(REPORT, t_s=10.2, pos_ned_m=(300.0, 0.0, 0.0))
    tracks = (
        NeighbourTracks()
        .copy_with_report_if_newer(REPORT, 10.2)
        .copy_with_report_if_newer(jumped, 10.4)
    )
    k = SeparationParams().error_sigmas
    assert 2.0 + 150.0 / k < spread(tracks, 10.4) < 2.0 + 200.0 / k
    assert spread(tracks, 10.2 + INCONSISTENCY_DECAY_S) == pytest.approx(2.0)


def test_a_position_that_stands_while_its_velocity_does_not_is_doubted_ever_more() -> None:
    tracks, before = NeighbourTracks().copy_with_report_if_newer(REPORT, 10.2), 2.0
    for k in range(1, 6):
        tracks = tracks.copy_with_report_if_newer(replace(REPORT, t_s=10.0 + k), 10.2 + k)
        now = spread(tracks, 10.0 + k)
        assert now > before
        before = now


def test_a_speed_that_nobody_can_fly_is_cut_and_doubted() -> None:
    liar = replace(REPORT, vel_ned_mps=(60.0, 0.0, 0.0))
    heard = NeighbourTracks().copy_with_report_if_newer(liar, 10.2).to_separation_filter_input(10.2)
    assert heard.vel_ned_mps[0, 0] == pytest.approx([15.0, 0.0, 0.0])
    assert heard.vel_std_mps[0, 0] == pytest.approx(0.1 + 45.0 / 3.0)


@pytest.mark.parametrize(
    "bad",
    [
        replace(REPORT, t_s=9.0),
        replace(REPORT, t_s=99.0),
        replace(REPORT, t_s=10.1, pos_ned_m=(float("nan"), 0.0, 0.0)),
        replace(REPORT, t_s=10.1, vel_ned_mps=(float("inf"), 0.0, 0.0)),
        replace(REPORT, t_s=10.1, pos_std_m=-1.0),
    ],
)
def test_reports_that_are_old_early_or_mangled_change_nothing(bad: NeighbourReport) -> None:
    tracks = NeighbourTracks().copy_with_report_if_newer(REPORT, 10.2)
    assert tracks.copy_with_report_if_newer(bad, 10.4) == tracks


def test_a_neighbour_that_vanished_is_named_and_let_go() -> None:
    tracks = NeighbourTracks().copy_with_report_if_newer(REPORT, 10.2)
    assert tracks.copy_without_silent_and_removed_names(10.0 + TRACK_LIFETIME_S)[1] == ()
    kept, lost = tracks.copy_without_silent_and_removed_names(10.1 + TRACK_LIFETIME_S)
    assert lost == ("b",)
    assert kept.to_separation_filter_input(50.0).present.shape == (1, 0)
