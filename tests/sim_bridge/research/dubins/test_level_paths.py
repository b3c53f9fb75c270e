"""Level Dubins paths in wind, against closed forms, brute force, integration and OMPL."""

import math

import numpy as np
import pytest

from sim_bridge.research.dubins.level_paths import FlightLimits, fastest_dubins_paths

V, R = 15.0, 60.0
LIMITS = FlightLimits(V, R)


def poses(random, count, side_m=400.0):
    return np.column_stack(
        [
            random.uniform(-side_m, side_m, (count, 2)),
            random.uniform(0.0, 2.0 * np.pi, count),
        ]
    )


def winds(random, count, speed_mps):
    angle = random.uniform(0.0, 2.0 * np.pi, count)
    return speed_mps * np.column_stack([np.cos(angle), np.sin(angle)])


def length_m(start, goal, **more):
    return float(fastest_dubins_paths(start, goal, LIMITS, **more).air_length_m[0])


@pytest.mark.parametrize(
    ("goal", "expected_m"),
    [
        ((500.0, 0.0, 0.0), 500.0),  # straight on
        ((0.0, 2 * R, math.pi), math.pi * R),  # half a circle to the right
        ((R, R, math.pi / 2), 0.5 * math.pi * R),  # a quarter
        ((0.0, 4 * R, 0.0), 2.0 * math.pi * R),  # parallel offset: half a circle each way
        # Same position, opposite heading: three turns, 7/3 pi R (Shkel & Lumelsky 2001).
        ((0.0, 0.0, math.pi), 7.0 / 3.0 * math.pi * R),
    ],
)
def test_lengths_in_calm_air_are_those_of_the_closed_forms(goal, expected_m):
    assert length_m((0.0, 0.0, 0.0), goal) == pytest.approx(expected_m, abs=1e-6)


def test_reversed_and_mirrored_problems_are_as_long():
    random = np.random.default_rng(3)
    start, goal = poses(random, 300), poses(random, 300)
    plain = fastest_dubins_paths(start, goal, LIMITS).air_length_m
    back = [p + np.array([0.0, 0.0, np.pi]) for p in (goal, start)]
    assert fastest_dubins_paths(*back, LIMITS).air_length_m == pytest.approx(plain, abs=1e-6)
    mirrored = [p * [1, -1, -1] for p in (start, goal)]
    assert fastest_dubins_paths(*mirrored, LIMITS).air_length_m == pytest.approx(plain, abs=1e-6)


@pytest.mark.parametrize("wind_mps", [0.0, 4.0, 9.0, 14.0])
def test_flying_the_turns_in_the_wind_step_by_step_arrives_at_the_goal(wind_mps):
    random = np.random.default_rng([7, int(wind_mps)])
    count = 36
    start, goal = poses(random, count), poses(random, count)
    wind = winds(random, count, wind_mps)
    paths = fastest_dubins_paths(start, goal, LIMITS, wind)
    # Independent integration of the kinematics: x' = V cos(gamma) u(psi) + w, psi' = +-V/R.
    for i in range(count):
        pose = start[i].copy()
        for turn, metres in zip(paths.turn[i], paths.length_m[i], strict=True):
            steps = 400
            dt = metres / V / steps
            rate = turn * V / R
            for _ in range(steps):
                middle = pose[2] + 0.5 * rate * dt
                pose[0] += (V * math.cos(middle) + wind[i, 0]) * dt
                pose[1] += (V * math.sin(middle) + wind[i, 1]) * dt
                pose[2] += rate * dt
        assert pose[:2] == pytest.approx(goal[i, :2], abs=0.05)
        assert math.cos(pose[2] - goal[i, 2]) == pytest.approx(1.0, abs=1e-9)


def scanned_s(start, goal, wind, latest_s):
    """Brute force: every word at every time on a fine grid, full circles included."""
    time = np.linspace(0.0, latest_s, 20_001)
    full, best = 2.0 * np.pi, np.inf

    def normal(angle):
        return np.array([-math.sin(angle), math.cos(angle)])

    def look(length):
        nonlocal best
        spare = (V * time - length) / (full * R)
        level = np.floor(spare)
        cross = (level[1:] != level[:-1]) & (np.abs(np.diff(spare)) < 0.3)
        cross &= np.maximum(level[1:], level[:-1]) >= 0
        if cross.any():
            best = min(best, time[np.argmax(cross)])

    with np.errstate(invalid="ignore"):
        for a in (-1, 1):
            for b in (-1, 1):
                c = goal[:2] + R * b * normal(goal[2]) - start[:2] - R * a * normal(start[2])
                c = c - time[:, None] * wind
                far, course = np.hypot(*c.T), np.arctan2(c[:, 1], c[:, 0])
                straight = far if a == b else np.sqrt(far**2 - 4 * R * R)
                way = course if a == b else course + a * np.arctan2(2 * R, straight)
                turns = np.mod(a * (way - start[2]), full) + np.mod(b * (goal[2] - way), full)
                look(R * turns + straight)
                if a != b:
                    continue
                for wide in (1, -1):
                    lean = a * (wide * np.arccos(far / (4 * R)) + np.pi / 2)
                    into, out = course + lean, course - lean
                    turns = np.mod(a * (into - start[2]), full) + np.mod(a * (into - out), full)
                    look(R * (turns + np.mod(a * (goal[2] - out), full)))
    return best


@pytest.mark.night
@pytest.mark.parametrize("wind_mps", [3.0, 9.0, 13.0])
def test_no_word_gets_there_sooner_in_wind(wind_mps):
    random = np.random.default_rng([11, int(wind_mps)])
    start, goal = poses(random, 20, 300.0), poses(random, 20, 300.0)
    wind = winds(random, 20, wind_mps)
    took = fastest_dubins_paths(start, goal, LIMITS, wind).time_s
    for i in range(20):
        scanned = scanned_s(start[i], goal[i], wind[i], took[i] * 1.001 + 0.1)
        assert took[i] <= scanned + 0.02 + 0.002 * took[i]


def test_as_long_as_ompl_says_in_calm_air_and_never_longer_in_wind():
    base = pytest.importorskip("ompl.base", reason="ompl is not installed: pip install ompl")
    random = np.random.default_rng(5)
    start, goal = poses(random, 150), poses(random, 150)
    for wind_mps in (0.0, 6.0):
        ours = fastest_dubins_paths(start, goal, LIMITS, (wind_mps, 0.0)).air_length_m
        space = (
            base.TrochoidStateSpace(R, wind_mps / V, 0.0) if wind_mps else base.DubinsStateSpace(R)
        )
        bounds = base.RealVectorBounds(2)
        bounds.setLow(-1e5)
        bounds.setHigh(1e5)
        space.setBounds(bounds)
        theirs = [_ompl_m(space, a, b) for a, b in zip(start, goal, strict=True)]
        assert (ours <= np.array(theirs) + 1e-3).all()
        assert np.mean(np.abs(ours - theirs) < 1e-3) > 0.98


def _ompl_m(space, a, b):
    states = []
    for pose in (a, b):
        state = space.allocState()
        state.setX(pose[0])
        state.setY(pose[1])
        state.setYaw(pose[2])
        states.append(state)
    return space.distance(*states)


def test_a_radius_follows_from_the_bank_limit():
    # 15 m/s at 45 degrees: V^2 / g.
    assert FlightLimits.from_bank(15.0, math.pi / 4).turn_radius_m == pytest.approx(
        225.0 / 9.80665, rel=1e-4
    )
