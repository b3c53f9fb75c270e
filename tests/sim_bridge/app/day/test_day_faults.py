"""The faults of a day are drawn as requested, and counted when they occur."""

from dataclasses import replace

import numpy as np

from sim_bridge.app.day import faults as kinds
from sim_bridge.app.day.faults import DayWorldOptions, draw_faults

WISH = DayWorldOptions(companion_kills=2, ground_kills=1, network_cuts=2, take_overs=1)


def test_kinds_that_were_added_leave_a_day_of_before_as_it_was():
    before = draw_faults(WISH, np.random.default_rng(4))
    after = draw_faults(replace(WISH, store_outages=2, member_cuts=2), np.random.default_rng(4))
    for kind in (kinds.DESK_KILLS, kinds.COMPANION_KILLS, kinds.NETWORK_CUTS, kinds.TAKE_OVERS):
        assert before.drawn[kind] == after.drawn[kind]
    assert len(after.drawn[kinds.STORE_OUTAGES]) == len(after.drawn[kinds.MEMBER_CUTS]) == 2


def test_each_lasts_as_long_as_its_kind_does_and_no_cut_is_shorter_than_wished():
    wish = DayWorldOptions(network_cuts=50, store_outages=50, member_cuts=50, least_cut_s=61.0)
    faults = draw_faults(wish, np.random.default_rng(1))
    assert min(for_s for _, for_s in faults.drawn[kinds.NETWORK_CUTS]) >= 61.0
    for kind, (low_s, high_s) in (
        (kinds.STORE_OUTAGES, kinds.STORE_OUTAGE_RANGE_S),
        (kinds.MEMBER_CUTS, kinds.MEMBER_CUT_RANGE_S),
    ):
        assert all(low_s <= for_s <= high_s for _, for_s in faults.drawn[kind])


def test_a_fault_that_has_not_come_when_the_day_is_over_does_not_count():
    faults = draw_faults(replace(WISH, store_outages=1), np.random.default_rng(2))
    faults.schedule_drawn_faults(1000.0)
    assert not any(faults.injected_count_by_kind.values())
    faults.remove_and_log_injected_fault(kinds.STORE_OUTAGES, 900.0, "the store is locked")
    faults.remove_and_log_injected_fault(kinds.NETWORK_CUTS, 900.0, "network cut")
    assert faults.injected_count_by_kind == {
        "desk_kills": 0,
        "companion_kills": 0,
        "store_outages": 1,
        "network_cuts": 1,
        "member_cuts": 0,
        "take_overs": 0,
    }
