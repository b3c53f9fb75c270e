"""The ground station's clock."""

import time

from ground_station.adapters.clock import WallClock


def test_a_wall_clock_that_is_set_does_not_move_the_running_desks_stamps(monkeypatch):
    clock = WallClock()
    before_us = clock.epoch_us()
    assert abs(before_us - time.time_ns() / 1000) < 1e6
    now_ns = time.time_ns()
    monkeypatch.setattr("time.time_ns", lambda: now_ns - 7200 * 10**9)
    assert 0 <= clock.epoch_us() - before_us < 60e6
