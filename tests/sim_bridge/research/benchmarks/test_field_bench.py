"""The benchmark of the fleet's wind times what it says: every telling, with a front and without."""

import pytest

from companion.core.wind_field.field_belief import FieldBelief
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.tellings import TELLING_S, WindTelling
from sim_bridge.research.benchmarks.field_bench import DRONES, ROUNDS, WARM, measured, sheet


@pytest.mark.parametrize("front", [False, True])
def test_each_round_after_the_warm_ones_is_timed(
    front: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[str, float]] = []
    fronts_s: list[float] = []
    tell, expect_front = FieldBelief.tell, FieldBelief.expect_front

    def telling(field: FieldBelief, one: WindTelling, now_s: float) -> object:
        told.append((one.member, now_s))
        return tell(field, one, now_s)

    def expecting(field: FieldBelief, one: FrontAhead | None) -> None:
        fronts_s.extend([one.noticed_s] if one else [])
        expect_front(field, one)

    monkeypatch.setattr(FieldBelief, "tell", telling)
    monkeypatch.setattr(FieldBelief, "expect_front", expecting)
    cost = measured(3, 1, front=front)
    rounds_s = [TELLING_S * k for k in range(ROUNDS)]
    assert told == [(f"d{k}", now_s) for now_s in rounds_s for k in range(3)]
    assert fronts_s == (rounds_s if front else [])
    assert cost.update.n == cost.forecast.n == ROUNDS - WARM
    assert cost.update.least > 0.0
    assert cost.forecast.least > 0.0


def test_the_sheet_has_a_row_for_each_count_and_says_where_a_front_passes() -> None:
    table = sheet([measured(1, 1), measured(2, 1, front=True)])
    assert [row[0] for row in table.rows] == ["1", "2, a front"]
    assert max(DRONES) == 100
