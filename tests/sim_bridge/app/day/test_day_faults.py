"""The faults of a day are drawn from its wish, and counted as they come."""

from dataclasses import replace

import numpy as np

from sim_bridge.app.day.faults import MEMBER_CUT_S, STORE_AWAY_S, DayWish, draw_faults

WISH = DayWish(companion_kills=2, ground_kills=1, network_cuts=2, take_overs=1)


def test_kinds_that_were_added_leave_a_day_of_before_as_it_was():
    before = draw_faults(WISH, np.random.default_rng(4))
    after = draw_faults(replace(WISH, store_outages=2, member_cuts=2), np.random.default_rng(4))
    assert before.ground_kills == after.ground_kills
    assert before.companion_kills == after.companion_kills
    assert before.network_cuts == after.network_cuts
    assert before.take_overs == after.take_overs
    assert len(after.store_outages) == len(after.member_cuts) == 2


def test_each_lasts_as_long_as_its_kind_does_and_no_cut_is_shorter_than_wished():
    wish = DayWish(network_cuts=50, store_outages=50, member_cuts=50, least_cut_s=61.0)
    faults = draw_faults(wish, np.random.default_rng(1))
    assert min(for_s for _, for_s in faults.network_cuts) >= 61.0
    for drawn, (low_s, high_s) in (
        (faults.store_outages, STORE_AWAY_S),
        (faults.member_cuts, MEMBER_CUT_S),
    ):
        assert all(low_s <= for_s <= high_s for _, for_s in drawn)


def test_a_fault_that_has_not_come_when_the_day_is_over_does_not_count():
    faults = draw_faults(replace(WISH, store_outages=1), np.random.default_rng(2))
    faults.spread_over(1000.0)
    assert not any(faults.came.values())
    faults.store_outages_s.pop()
    faults.network_cuts_s.pop(0)
    assert faults.came == {
        "desk_kills": 0,
        "companion_kills": 0,
        "store_outages": 1,
        "network_cuts": 1,
        "member_cuts": 0,
        "take_overs": 0,
    }
