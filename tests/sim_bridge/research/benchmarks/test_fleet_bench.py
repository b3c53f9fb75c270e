"""The benchmark of fleets counts what its members did, also when each desk is killed half way."""

import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.research.benchmarks.fleet_bench import bench as fleet_bench
from sim_bridge.research.benchmarks.fleet_bench.bench import Asked, bench
from sim_bridge.research.benchmarks.fleet_bench.start_bench import bench as bench_start
from sim_bridge.research.benchmarks.fleet_bench.track_bench import bench as bench_tracks
from sim_bridge.research.benchmarks.fleet_bench.track_flights import TrackFlights

SHORT = {"minutes": 0.15, "order_every_s": 6.0, "flight_s": (0.5, 1.0)}


@pytest.mark.timeout(120)
@pytest.mark.parametrize(("desks", "routers", "tls"), [(1, 0, False), (2, 1, False), (2, 0, True)])
def test_every_order_of_a_small_fleet_is_delivered_once_though_each_desk_dies(desks, routers, tls):
    found = bench(Asked(4, desks=desks, routers=routers, kill_desk=True, tls=tls, **SHORT))
    assert (found["desks"], found["routers"], found["store"]) == (desks, routers, "sqlite")
    assert found["orders"] >= 6  # 4 members, 9 s, one in 6 s each; what came while nobody listened
    assert found["delivered"] >= 4  # a desk that dies on a busy machine is away for long
    assert (found["twice"], found["lost"], found["false_gone"]) == (0, 0, 0)
    assert found["present_at_end"] == found["joined_in_180_s"] == 4
    assert found["commands"] >= 2 * found["delivered"]  # each is assigned and launched
    assert found["unanswered"] == 0
    assert 0.0 < found["ack_ms_p50"] <= found["ack_ms_p99"]
    assert found["desk_back_s"] > 0.0
    assert found["desk_rss_mb"] > 20.0


@pytest.mark.night
@pytest.mark.timeout(300)
def test_nothing_is_lost_where_routers_die_members_are_cut_off_and_each_desk_dies(monkeypatch):
    monkeypatch.setattr(fleet_bench, "A_PROCESS", 1)  # members of both desks at both routers
    longer = SHORT | {"minutes": 1.6}  # cut off for 14 s: a lease is 10 s
    found = bench(Asked(4, desks=2, routers=2, faults=True, **longer))
    assert found["orders"] >= 12
    assert found["delivered"] >= 4
    assert (found["twice"], found["lost"], found["unanswered"]) == (0, 0, 0)
    assert found["present_at_end"] == 4
    assert found["desk_back_s"] > 0.0
    assert found["gone_under_faults"] >= 1


def test_desks_do_not_share_a_store_and_a_store_is_empty(tmp_path):
    with pytest.raises(LeewayError, match="leave out --store"):
        bench(Asked(4, desks=2, store=f"sqlite:///{tmp_path / 'x.db'}", **SHORT))
    with pytest.raises(LeewayError, match="at most one for each vehicle"):
        bench(Asked(1, desks=2, **SHORT))
    with pytest.raises(LeewayError, match="leave out --routers"):
        bench(Asked(4, routers=1, tls=True, **SHORT))
    with pytest.raises(LeewayError, match="expected --routers"):
        bench(Asked(4, faults=True, **SHORT))


@pytest.mark.timeout(120)
def test_a_desk_of_a_small_day_begins_and_gives_each_drone_an_order():
    begun = bench_start(8, 2, seed=1, busy_s=3.0)
    assert (begun.orders, begun.drones, begun.assigned) == (8, 2, 2)
    assert 0.0 < begun.first_s <= begun.taken_s
    assert begun.import_s > 0.0


@pytest.mark.timeout(120)
def test_by_cell_drones_hear_all_who_are_near_and_few_others():
    everybody, near = bench_tracks(TrackFlights(drones=6, across_m=6000.0, seed=4), seconds=2.0)
    assert (everybody.by, near.by) == ("all", "cell")
    assert everybody.messages_hz == pytest.approx(5 * 5.0)  # five others, 5 Hz each
    assert near.messages_hz < 0.5 * everybody.messages_hz
    assert near.near_hz == everybody.near_hz > 0.0
    assert near.near_frac == everybody.near_frac == 1.0
    assert near.bytes_hz < 0.5 * everybody.bytes_hz


@pytest.mark.timeout(120)
def test_of_two_fleets_by_cell_both_are_heard_and_without_neighbours_ones_own_only():
    flights = TrackFlights(drones=6, across_m=6000.0, seed=4, fleets=2)
    _, both, own = bench_tracks(flights, seconds=2.0)
    assert (both.by, own.by) == ("cell", "cell, own fleet")
    assert both.near_frac == 1.0
    assert 0.0 <= own.near_frac < 1.0
    assert own.messages_hz < both.messages_hz
