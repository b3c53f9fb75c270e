"""The pace of simulated time on a scripted wall clock."""

import pytest

from sim_bridge.adapters.realtime import Pacer


class WaitingEndpoints:
    """Replaces an EndpointSet on which data arrives occasionally."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.arrivals_s: list[float] = []

    def poll(self, timeout_s: float) -> list[tuple[int, bytes]]:
        until_s = self.now_s + timeout_s
        if self.arrivals_s and self.arrivals_s[0] <= until_s:
            self.now_s = max(self.now_s, self.arrivals_s.pop(0))
            return [(0, b"x")]
        self.now_s = until_s
        return []


def test_simulated_time_passes_at_the_chosen_multiple() -> None:
    endpoints = WaitingEndpoints()
    pacer = Pacer(10.0, clock_s=lambda: endpoints.now_s)
    for step in range(101):
        pacer.receive_until_due(7.0 + step * 0.1, endpoints)  # type: ignore[arg-type]
    assert endpoints.now_s == pytest.approx(101.0)
    assert pacer.slipped_s == 0.0


def test_what_arrives_meanwhile_is_kept_and_does_not_hurry_time() -> None:
    endpoints = WaitingEndpoints()
    endpoints.arrivals_s = [100.0, 100.2, 100.4, 101.5]
    pacer = Pacer(1.0, clock_s=lambda: endpoints.now_s)
    assert len(pacer.receive_until_due(0.0, endpoints)) == 1  # type: ignore[arg-type]
    assert len(pacer.receive_until_due(1.0, endpoints)) == 2  # type: ignore[arg-type]
    assert endpoints.now_s == pytest.approx(101.0)


def test_a_host_that_fell_far_behind_does_not_race_to_catch_up() -> None:
    endpoints = WaitingEndpoints()
    pacer = Pacer(1.0, clock_s=lambda: endpoints.now_s)
    pacer.receive_until_due(0.0, endpoints)  # type: ignore[arg-type]
    endpoints.now_s += 10.0
    pacer.receive_until_due(1.0, endpoints)  # type: ignore[arg-type]
    assert pacer.slipped_s == pytest.approx(9.0)
    pacer.receive_until_due(2.0, endpoints)  # type: ignore[arg-type]
    assert endpoints.now_s == pytest.approx(111.0)


def test_a_small_delay_is_made_good() -> None:
    endpoints = WaitingEndpoints()
    pacer = Pacer(1.0, clock_s=lambda: endpoints.now_s)
    pacer.receive_until_due(0.0, endpoints)  # type: ignore[arg-type]
    endpoints.now_s += 1.3
    pacer.receive_until_due(1.0, endpoints)  # type: ignore[arg-type]
    pacer.receive_until_due(2.0, endpoints)  # type: ignore[arg-type]
    assert endpoints.now_s == pytest.approx(102.0)


@pytest.mark.parametrize("speedup", [0.0, -1.0, float("nan")])
def test_time_does_not_stand_still_or_run_back(speedup: float) -> None:
    with pytest.raises(ValueError, match="speedup"):
        Pacer(speedup)
