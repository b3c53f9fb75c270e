"""Mean trim of flights by the world of `test_airframe_fit`, with an attitude offset."""

import math
from dataclasses import replace
from pathlib import Path
from runpy import run_path

import msgspec
import pytest

from companion.analysis.calibration.airframe_fit import fit_airframe_to_flights
from companion.analysis.calibration.drag import fit_drag
from companion.analysis.calibration.trim import trim_quantities

WORLD = run_path(str(Path(__file__).parent / "test_airframe_fit.py"))
LEANS_RAD = (0.02, -0.012)  # reported minus true pitch and roll


def leaning(seed, *, held=None):
    """Return a square flight whose attitude is reported with a total offset of LEANS_RAD."""
    sides = WORLD["square"]((12.6, 4.9, 8.4), heading=held)
    record = WORLD["fly"](sides, seed=seed, name=f"s{seed}")
    pitch = record.pitch_rad + 0.004 + LEANS_RAD[0]  # without the world's own offset
    return WORLD["blocks"](
        replace(record, pitch_rad=pitch, roll_rad=record.roll_rad - 0.005 + LEANS_RAD[1])
    )


@pytest.fixture(scope="module")
def flights():
    return [leaning(seed) for seed in (11, 12, 13)]


def started(forward_deg=0.0, right_deg=0.0):
    start = WORLD["wrong_start"]()
    drag = msgspec.structs.replace(
        start.drag, trim_forward_deg=forward_deg, trim_right_deg=right_deg
    )
    return msgspec.structs.replace(start, drag=drag)


@pytest.mark.sample
def test_the_lean_of_the_reported_attitude_comes_back_and_stands_in_the_airframe(flights):
    drag = fit_airframe_to_flights(flights, started(), measure_holdout_error=False).airframe.drag
    # Pitch is reported 0.02 rad too high: true thrust is tilted further forward by that much.
    assert drag.trim_forward_deg == pytest.approx(math.degrees(LEANS_RAD[0]), abs=0.2)
    assert drag.trim_right_deg == pytest.approx(-math.degrees(LEANS_RAD[1]), abs=0.2)


@pytest.mark.sample
def test_a_start_that_states_the_lean_is_not_leaned_twice(flights):
    start = started(math.degrees(LEANS_RAD[0]), -math.degrees(LEANS_RAD[1]))
    forward, right = trim_quantities(flights, start, fit_drag(flights, start))
    assert forward.value == pytest.approx(start.drag.trim_forward_deg, abs=0.2)
    assert right.value == pytest.approx(start.drag.trim_right_deg, abs=0.2)


@pytest.mark.sample
def test_two_flights_or_one_heading_tell_no_trim_and_the_start_stays(flights):
    start = started(0.4)
    for few in (flights[:2], [leaning(seed, held=0.3) for seed in (14, 15, 16)]):
        done = fit_airframe_to_flights(few, start, measure_holdout_error=False)
        assert done.airframe.drag.trim_forward_deg == 0.4
        assert any("trim forward: not identified" in words for words in done.notes)
