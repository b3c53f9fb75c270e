"""The benchmark of fleets counts the members' work, also when each desk is killed half way."""

import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.research.benchmarks.fleet_bench.bench import BenchRequest, run_fleet_benchmark

SHORT = {"minutes": 0.15, "order_interval_s": 6.0, "flight_s": (0.5, 1.0)}


@pytest.mark.sample
@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    ("desks", "routers", "tls"),
    [
        (1, 0, False),
        pytest.param(2, 1, False, marks=pytest.mark.night),
        pytest.param(2, 0, True, marks=pytest.mark.night),
    ],
)
def test_every_order_of_a_small_fleet_is_delivered_once_though_each_desk_dies(desks, routers, tls):
    found = run_fleet_benchmark(
        BenchRequest(4, desks=desks, routers=routers, kill_desk=True, tls=tls, **SHORT)
    )
    assert (found["desks"], found["routers"], found["store"]) == (desks, routers, "sqlite")
    assert found["orders"] >= 6  # 4 members, 9 s, an order in 6 s each, without those of the outage
    assert found["delivered"] >= 4  # a killed desk is away for long on a busy machine
    assert (found["twice"], found["lost"], found["false_gone"]) == (0, 0, 0)
    assert found["present_at_end"] == found["joined_in_180_s"] == 4
    assert found["commands"] >= 2 * found["delivered"]  # each is assigned and launched
    assert found["unanswered"] == 0
    assert 0.0 < found["ack_ms_p50"] <= found["ack_ms_p99"]
    assert found["desk_back_s"] > 0.0
    assert found["desk_rss_mb"] > 20.0


def test_desks_do_not_share_a_store_and_a_store_is_empty(tmp_path):
    with pytest.raises(LeewayError, match="leave out --store"):
        run_fleet_benchmark(
            BenchRequest(4, desks=2, store=f"sqlite:///{tmp_path / 'x.db'}", **SHORT)
        )
    with pytest.raises(LeewayError, match="at most one for each vehicle"):
        run_fleet_benchmark(BenchRequest(1, desks=2, **SHORT))
    with pytest.raises(LeewayError, match="leave out --routers"):
        run_fleet_benchmark(BenchRequest(4, routers=1, tls=True, **SHORT))
