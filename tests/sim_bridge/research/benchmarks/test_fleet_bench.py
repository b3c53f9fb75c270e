"""The benchmark of fleets counts what its members did, also when each desk is killed half way."""

import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.research.benchmarks.fleet_bench import bench as fleet_bench
from sim_bridge.research.benchmarks.fleet_bench.bench import Asked, bench

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
