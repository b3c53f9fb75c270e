"""Without any monitor that measures the pack nothing takes off, on both autopilots."""

import pytest

from sim_bridge.app.faults.fault import FaultCase, FaultTask
from sim_bridge.app.faults.packs import report_monitor_without_pack
from sim_bridge.app.faults.runner import fly_case
from sim_bridge.app.faults.verdict import check_no_takeoff
from sim_bridge.app.world.flight_phase import FlightPhase

pytestmark = pytest.mark.sitl


@pytest.mark.night  # it waits minutes for an operator
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_without_a_measured_pack_nothing_takes_off_and_the_reason_is_given(tmp_path, autopilot):
    play = report_monitor_without_pack((100,), has_pack=False)
    flight, asks = {"vehicle": {"charge_frac": 0.9}}, (check_no_takeoff,)
    case = FaultCase(77, "monitor-0", "energy", "monitor 0 has no pack", play, asks, flight=flight)
    row = fly_case(case, FaultTask(case.name, autopilot, FlightPhase.READY, 1, tmp_path))
    assert row.passed, (row.failure_text, row.messages)
    assert any("no battery voltage: received" in text for text in row.messages), row.messages
