"""The meter counts the parts of a flight, and leaves them as it found them."""

import pytest

from sim_bridge.adapters.wall_clock import cpu_s
from sim_bridge.research.benchmarks.hot_meter import COMPANION, SIMULATOR, WHOLE, metered

BUSY_S = 0.05


class Part:
    """Something that computes for a while."""

    def work(self, for_s: float) -> str:
        until_s = cpu_s() + for_s
        while cpu_s() < until_s:
            pass
        return "done"

    def breaks(self) -> None:
        raise ValueError("broken")


HERE = f"{__name__}:Part"


def test_calls_and_their_cpu_are_counted_and_answers_kept() -> None:
    before = Part.work
    with metered({"part": f"{HERE}.work"}) as spent:
        assert [Part().work(BUSY_S), Part().work(for_s=BUSY_S)] == ["done", "done"]
    assert spent["part"].calls == 2
    assert 2 * BUSY_S <= spent["part"].cpu_s <= spent[WHOLE].cpu_s
    assert Part.work is before


def test_a_call_that_raises_is_counted_too() -> None:
    with metered({"part": f"{HERE}.breaks"}) as spent, pytest.raises(ValueError, match="broken"):
        Part().breaks()
    assert spent["part"].calls == 1


def test_every_part_of_a_flight_is_there_to_be_counted() -> None:
    with metered(SIMULATOR | COMPANION) as spent:
        pass
    assert all(spent[part].calls == 0 for part in SIMULATOR | COMPANION)


def test_a_part_that_is_not_there_is_an_error() -> None:
    with pytest.raises(AttributeError, match="rest"), metered({"part": f"{HERE}.rest"}):
        pass
