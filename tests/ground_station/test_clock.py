"""The ground station's clock."""

import time

from ground_station.adapters.clock import WallClock
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.app.options.desk_options import DeskOptions
from tests.ground_station.store.test_order_store import an_order


def test_a_wall_clock_that_is_set_does_not_move_the_running_desks_stamps(monkeypatch):
    clock = WallClock()
    before_us = clock.epoch_us()
    assert abs(before_us - time.time_ns() / 1000) < 1e6
    now_ns = time.time_ns()
    monkeypatch.setattr("time.time_ns", lambda: now_ns - 7200 * 10**9)
    assert 0 <= clock.epoch_us() - before_us < 60e6


def test_a_wall_clock_that_is_set_does_not_move_the_stamps_of_a_store_that_a_desk_has_open(
    tmp_path, monkeypatch
):
    store = DeskOptions(f"sqlite:///{tmp_path}/desk.db").open_store(create=True)
    now_ns = time.time_ns()
    monkeypatch.setattr("time.time_ns", lambda: now_ns + 3600 * 10**9)
    store.add_orders_unless_conflict([an_order("o1")])
    rows, _ = read_audit_rows_and_head(store.database)
    store.close()
    assert 0 <= rows[0].entry.at_us - now_ns / 1000 < 60e6
