"""What each state is worth: the flights' figures, and what the table makes of them."""

from pathlib import Path

import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from sim_bridge.research.wind.ablation import ABLATIONS
from sim_bridge.research.wind.envelope_flight import Condition, drag_deviates, fly_envelope
from sim_bridge.research.wind.envelope_score import judged
from sim_bridge.research.wind.states_bench import (
    WHOLE,
    StatesJob,
    StatesRow,
    fly_states,
    states_sheet,
)
from sim_bridge.truth.params import load_airframe

TRUTH = Path(__file__).parents[4] / "params" / "truth" / "m100.toml"


def made(**squares: list[float]) -> StatesRow:
    others = {name: [1.0] * 4 for name in ABLATIONS}
    all_of = {WHOLE: [1.0, 2.0, 1.0, 2.0], **others} | {
        k.replace("_", " "): v for k, v in squares.items()
    }
    return StatesRow("a condition", all_of, {name: [2.0] * 4 for name in all_of})


def cell(row: StatesRow, name: str) -> str:
    sheet = states_sheet([row], 1)
    return dict(zip(sheet.head, sheet.rows[0], strict=True))[f"{name}, %"]


def test_a_fifth_more_error_in_every_flight_is_sure() -> None:
    worse = [1.44 * square for square in (1.0, 2.0, 1.0, 2.0)]
    assert cell(made(without_trims=worse), "without trims") == "+20 ± 0"


def test_more_in_one_flight_and_less_in_another_is_not() -> None:
    found = cell(made(without_trims=[3.0, 1.0, 0.5, 2.1]), "without trims")
    more, half = (float(word) for word in found.split(" ± "))
    # By hand: ratio 6.6 / 6; left over 1.9, -1.2, -0.6, -0.1, their deviation 1.33 of mean 1.5.
    assert more == pytest.approx(100.0 * (1.1**0.5 - 1.0), abs=0.5)
    assert half == pytest.approx(100.0 * 1.96 * 0.5 * (1.33 / 1.5) / 2.0 / 1.1**0.5, abs=2.0)


def test_every_variant_hears_the_same_flight_and_the_whole_is_the_estimator_as_it_flies() -> None:
    truth, airframe = load_airframe(TRUTH), read_airframe("m100")
    condition = Condition(18.0, 0.0)
    row = fly_states(StatesJob(0, condition, 2, 5, truth, airframe))
    assert set(row.squares_m2ps2) == {WHOLE, *ABLATIONS}
    drags = drag_deviates(2, np.random.default_rng([5, 0]))
    flown = fly_envelope(truth, condition, np.random.default_rng([5, 0, 1]), drags[1])
    errors = judged(flown, airframe)
    square = float(np.mean(np.sum(errors.error_ne_mps**2, axis=1)))
    assert row.squares_m2ps2[WHOLE][1] == pytest.approx(square)
    # Drag that is 5 % off, and taken as known, is 0.5 m/s at 18 m/s.
    without = row.squares_m2ps2["without drag gains"]
    assert sum(without) > 1.2 * sum(row.squares_m2ps2[WHOLE])
