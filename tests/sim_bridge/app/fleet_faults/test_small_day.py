"""The day of the fleet's rows fits its plan, which promises both drones one stop."""

from ground_station.app.desk.active_plan import check_plan
from sim_bridge.app.fleet_faults.small_day import day_data, plan_of


def test_the_plan_fits_the_day():
    data = day_data()
    check_plan(data, plan_of(data))


def test_both_fly_from_one_stop_to_another_in_layers_of_their_own():
    sorties = plan_of(day_data()).sorties
    assert {(s.vehicle, s.launch, s.home) for s in sorties} == {
        ("d1", "stop-1", "stop-2"),
        ("d2", "stop-1", "stop-2"),
    }
    low, high = sorted(s.outbound_height_m for s in sorties)
    assert high - low >= 12.0
