"""Steps of the reports that no vehicle makes; the wind's error is against a made world.

The world is Newton's law with the airframe's published drag (`synthetic_flight`), in 5 m/s of wind.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.core.wind.estimator import WindEstimator
from companion.core.wind.observation import WindObservation
from companion.core.wind.step_watch import HEADING, StepDetector
from sim_bridge.app.trials.synthetic_flight import MASS_KG, build_square_flight

AIRFRAME = read_airframe("m100")
MOST_TURN_RPS = math.radians(45.0)  # PX4's MPC_YAWRAUTO_MAX
STEP_S = 60.0


def slowly_turned(world):
    """The made flight, which turns at a corner at once, turning as an autopilot does.

    The thrust's direction over ground stays; of it follow roll and pitch about the new heading.
    """
    courses = np.unwrap(world.yaw_rad)
    yaw = np.empty(courses.size)
    yaw[0] = courses[0]
    most = MOST_TURN_RPS * np.diff(world.t_s, prepend=0.0)
    for k in range(1, yaw.size):
        yaw[k] = yaw[k - 1] + np.clip(courses[k] - yaw[k - 1], -most[k], most[k])
    forward = -np.tan(world.pitch_rad)
    right = np.tan(world.roll_rad) / np.cos(world.pitch_rad)
    cos, sin = np.cos(courses - yaw), np.sin(courses - yaw)
    pitch = -np.arctan(cos * forward - sin * right)
    roll = np.arctan((sin * forward + cos * right) * np.cos(pitch))
    return replace(world, roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw)


WORLD = slowly_turned(build_square_flight())
RATES = np.gradient(WORLD.yaw_rad, WORLD.t_s)
TILT_RATES = np.gradient(np.stack([WORLD.roll_rad, WORLD.pitch_rad], axis=1), WORLD.t_s, axis=0)
DIRECTION = np.array([0.6, -0.8, 0.0])


def observations(
    heading_off, *, rated=True, lost=lambda t_s: False, other_off=lambda t_s: 0.0, of=""
):
    """Return the observations of the simulated flight with heading error `heading_off(t_s)`, and
    `other_off(t_s)` of "tilt" (rad) or "velocity" (m/s).
    """
    for k, t_s in enumerate(WORLD.t_s.tolist()):
        known = not lost(t_s)
        yaw = math.remainder(WORLD.yaw_rad[k] + heading_off(t_s), math.tau)
        tilt, speed = (other_off(t_s) if of == one else 0.0 for one in ("tilt", "velocity"))
        yield WindObservation(
            t_s=t_s,
            airborne=bool(WORLD.flying[k]) and bool(WORLD.pos_ned_m[k, 2] < -2.0),
            mass_kg=MASS_KG,
            vel_ned_mps=tuple((WORLD.vel_ned_mps[k] + speed * DIRECTION).tolist()),
            roll_rad=float(WORLD.roll_rad[k]) + 0.6 * tilt if known else None,
            pitch_rad=float(WORLD.pitch_rad[k]) - 0.8 * tilt if known else None,
            yaw_rad=yaw if known else None,
            height_m=float(-WORLD.pos_ned_m[k, 2]),
            yaw_rate_rps=float(RATES[k]) if rated else None,
            tilt_rates_rps=tuple(TILT_RATES[k].tolist()) if rated else (None, None),
            armed=bool(WORLD.flying[k]),
        )


def flown(seen, estimator=None):
    """Rows of (t_s, sigmas of the worse axis, valid), and the warnings."""
    estimator = estimator or WindEstimator(AIRFRAME)
    rows, said = [], []
    for one in seen:
        said += [(one.t_s, words) for words in estimator.update(one)]
        if one.airborne:
            belief = estimator.belief(one.t_s)
            error = belief.mean_to_ne_mps - np.array(WORLD.wind_to_ne_mps)
            sigmas = np.abs(error) / np.sqrt(np.diag(belief.cov_ne_m2ps2))
            rows.append((one.t_s, sigmas.max(), belief.valid))
    return np.array(rows), said


def during(deg, begin_s, end_s):
    return lambda t_s: math.radians(deg) if begin_s <= t_s < end_s else 0.0


@pytest.mark.sample
@pytest.mark.parametrize("rated", [True, False])
@pytest.mark.parametrize("deg", [160.0, -160.0, 180.0, 90.0, -45.0, 30.0])
def test_a_heading_that_steps_and_steps_back_does_not_become_wind(deg, rated):
    off = during(deg, STEP_S, STEP_S + 8.0)
    rows, said = flown(observations(off, rated=rated))
    t_s, sigmas, valid = rows.T
    steps = [at for at, words in said if "heading stepped" in words]
    assert steps[0] == pytest.approx(STEP_S, abs=0.15)
    assert len(steps) == 1
    assert not valid[(t_s > STEP_S + 0.2) & (t_s < STEP_S + 8.0)].any()
    assert sigmas[t_s > STEP_S].max() < 3.0
    assert valid[(t_s > STEP_S + 14.0) & (t_s < 150.0)].all()


@pytest.mark.sample
@pytest.mark.parametrize("for_s", [3.0, 8.0, math.inf])
@pytest.mark.parametrize(
    ("of", "size", "rated"),
    [("velocity", 5.0, True), ("velocity", -10.0, False), ("velocity", 7.0, True)]
    + [("tilt", math.radians(deg), True) for deg in (15.0, -25.0)]
    + [("tilt", math.radians(35.0), False)],
)
def test_a_velocity_or_tilt_that_steps_does_not_become_wind(of, size, rated, for_s):
    off = during(math.degrees(size), STEP_S, STEP_S + for_s)
    rows, said = flown(observations(lambda t_s: 0.0, rated=rated, other_off=off, of=of))
    t_s, sigmas, valid = rows.T
    steps = [at for at, words in said if f"{of} stepped" in words]
    assert steps[0] == pytest.approx(STEP_S, abs=0.15)
    assert len(steps) == 1
    assert sigmas[t_s > STEP_S].max() < 3.0
    assert not valid[(t_s > STEP_S + 0.2) & (t_s < STEP_S + for_s)].any()
    assert valid[(t_s > STEP_S + for_s + 14.0) & (t_s < 150.0)].all()


@pytest.mark.parametrize(("of", "size"), [("heading", 45.0), ("velocity", 5.0)])
def test_a_step_before_the_estimator_takes_measurements_is_seen_at_once(of, size):
    """Below 2 m no measurement enters, and a vehicle turns or accelerates there no faster."""
    at_s = WORLD.t_s[np.flatnonzero(WORLD.flying)[0]] + 0.2
    off = during(size if of == "heading" else math.degrees(size), at_s, at_s + 8.0)
    turned, other = (off, lambda t_s: 0.0) if of == "heading" else (lambda t_s: 0.0, off)
    seen = list(observations(turned, other_off=other, of=of))
    assert not any(one.airborne for one in seen if one.t_s <= at_s + 0.1)
    rows, said = flown(seen)
    t_s, sigmas, valid = rows.T
    assert next(at for at, words in said if "stepped" in words) == pytest.approx(at_s, abs=0.15)
    assert not valid[t_s < at_s + 8.0].any()
    assert sigmas.max() < 3.0
    assert valid[(t_s > at_s + 22.0) & (t_s < 150.0)].all()


@pytest.mark.parametrize("of", ["velocity", "tilt"])
def test_reports_that_a_step_corrects_are_known_again_by_drag(of):
    """They drift by 8 m/s or 20 degrees, too slowly to be seen, and step back at once."""
    most = 8.0 if of == "velocity" else math.radians(20.0)

    def off(t_s):
        return most * (t_s - STEP_S) / 2.0 if STEP_S <= t_s < STEP_S + 2.0 else 0.0

    rows, said = flown(observations(lambda t_s: 0.0, other_off=off, of=of))
    t_s, sigmas, valid = rows.T
    assert [words for _, words in said if "stepped" in words]
    assert valid[(t_s > STEP_S + 60.0) & (t_s < 150.0)].all()
    assert sigmas[t_s > STEP_S + 7.0].max() < 3.0


@pytest.mark.parametrize("deg", [160.0, -100.0, 45.0])
def test_a_heading_that_stays_wrong_never_becomes_a_confident_wind(deg):
    rows, _ = flown(observations(during(deg, STEP_S, math.inf)))
    t_s, sigmas, valid = rows.T
    assert sigmas[t_s > STEP_S].max() < 3.0
    assert not valid[t_s > STEP_S + 0.2].any()


def test_repeated_steps_are_one_fault_and_the_last_step_back_ends_it():
    def off(t_s):
        if not STEP_S <= t_s < STEP_S + 20.0:
            return 0.0
        return math.radians((120.0, -90.0, 60.0, -150.0)[int((t_s - STEP_S) // 5.0)])

    rows, said = flown(observations(off))
    t_s, sigmas, valid = rows.T
    assert sigmas[t_s > STEP_S].max() < 3.0
    assert not valid[(t_s > STEP_S + 0.2) & (t_s < STEP_S + 20.0)].any()
    assert valid[(t_s > STEP_S + 26.0) & (t_s < 150.0)].all()
    assert sum("known again" in words for _, words in said) == 1


def test_a_heading_that_is_right_after_wrong_ones_is_found_right_by_drag_over_ground():
    """It is off by 150 degrees, then right, but for a drift that hides the step back."""

    def off(t_s):
        if not STEP_S <= t_s < STEP_S + 16.0:
            return 0.0
        return math.radians(150.0 - 12.0 * (t_s - STEP_S)) if t_s < STEP_S + 12.0 else 0.0

    rows, said = flown(observations(off, rated=False))
    t_s, sigmas, valid = rows.T
    assert sum("heading stepped" in words for _, words in said) == 1
    assert not valid[(t_s > STEP_S + 0.2) & (t_s < STEP_S + 10.0)].any()
    assert sigmas[t_s > STEP_S].max() < 3.0
    assert valid[(t_s > STEP_S + 30.0) & (t_s < 150.0)].all()


def test_a_turn_during_a_gap_is_no_step_and_a_step_is_one():
    # The squares' corner at 65 s turns by 90 degrees.
    def gap(t_s):
        return 65.2 < t_s < 66.8

    rows, said = flown(observations(lambda t_s: 0.0, lost=gap))
    assert not any("heading" in words for _, words in said)
    rows, said = flown(observations(during(-170.0, 66.0, 74.0), lost=gap))
    t_s, sigmas, valid = rows.T
    assert any("heading stepped" in words for _, words in said)
    assert not valid[(t_s > 67.0) & (t_s < 74.0)].any()
    assert sigmas[t_s > 66.0].max() < 3.0


def test_an_unchanged_heading_is_no_step():
    for rated in (True, False):
        _, said = flown(observations(lambda t_s: 0.0, rated=rated))
        assert not said


def watched(yaw_deg, rate_hz, rate_dps=None):
    """Steps (degrees) that the watch finds in a heading given over time."""
    watch, found = StepDetector(HEADING, [0.0]), []
    for k in range(round(60.0 * rate_hz)):
        t_s = k / rate_hz
        yaw = math.remainder(math.radians(yaw_deg(t_s)), math.tau)
        rates = None if rate_dps is None else [math.radians(rate_dps)]
        step = watch.update_and_detect_step(t_s, [yaw], rates, [yaw, t_s])
        found += [math.degrees(step)] if step else []
    return found


@pytest.mark.parametrize("rated", [True, False])
@pytest.mark.parametrize("rate_hz", [50.0, 20.0, 10.0, 5.0])
@pytest.mark.parametrize("turn_dps", [90.0, -90.0, 45.0, -180.0])
def test_a_spin_over_all_headings_is_no_step(turn_dps, rate_hz, rated):
    if rate_hz == 5.0 and abs(turn_dps) > 90.0 and not rated:
        pytest.skip("36 degrees from one report to the next, and no rate")
    assert watched(lambda t_s: turn_dps * t_s, rate_hz, turn_dps if rated else None) == []


@pytest.mark.parametrize("rate_hz", [50.0, 10.0, 4.0, 1.0])
@pytest.mark.parametrize("deg", [160.0, -100.0, 180.0])
def test_a_step_is_found_at_slow_rates_and_across_south(deg, rate_hz):
    found = watched(lambda t_s: 170.0 + (deg if t_s >= 30.0 else 0.0), rate_hz, 0.0)
    assert [abs(one) for one in found] == pytest.approx([abs(deg)])


def test_a_repeated_report_says_nothing_of_a_turn_at_the_next():
    watch = StepDetector(HEADING, [0.0])
    for k in range(40):  # 10 Hz ticks on reports of 1 Hz that turn by 45 degrees each
        assert watch.update_and_detect_step(float(k // 10), [math.radians(45.0 * (k // 10))]) == 0.0


def test_a_restart_while_the_heading_is_unknown_keeps_it_unknown():
    seen = list(observations(during(160.0, STEP_S, STEP_S + 8.0)))
    before = WindEstimator(AIRFRAME)
    cut = next(k for k, one in enumerate(seen) if one.t_s > STEP_S + 3.0)
    flown(seen[:cut], before)
    after = WindEstimator(AIRFRAME)
    after.restore(before.snapshot())
    rows, _ = flown(seen[cut:], after)
    t_s, sigmas, valid = rows.T
    assert not valid[t_s < STEP_S + 8.0].any()
    assert sigmas.max() < 3.0
    assert valid[(t_s > STEP_S + 14.0) & (t_s < 150.0)].all()
