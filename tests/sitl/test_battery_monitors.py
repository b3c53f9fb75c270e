"""A battery monitor without a pack next to the pack's own, in flights of both autopilots.

Monitor 0 has no pack: no voltage, no current, but a stated charge (reported of PX4 and ArduPilot
with a second power module). The real pack is monitor 1.
"""

import pytest

from sim_bridge.app.faults.fault import SAFETY_RULES, FaultCase, FaultTask
from sim_bridge.app.faults.runner import fly_case
from sim_bridge.app.faults.verdict import check_delivered, check_no_takeoff
from sim_bridge.app.link.tap import message_with_changed_fields
from sim_bridge.app.world.flight_phase import FlightPhase

pytestmark = pytest.mark.sitl

UNKNOWN = 65535
EMPTY = {
    "BATTERY_STATUS": {"voltages": (UNKNOWN,) * 10, "current_battery": -1, "current_consumed": -1,
                       "energy_consumed": -1},
    "SYS_STATUS": {"voltage_battery": UNKNOWN, "current_battery": -1},
}  # fmt: skip
"""Unknown values, by MAVLink's common.xml."""


def monitor_0_has_no_pack(charge_pct, *, with_pack=True):
    def play(stage):
        def change(message):
            empty = EMPTY.get(message.msg_name)
            if empty is None:
                return None
            told = [message_with_changed_fields(message, **empty, battery_remaining=charge_pct)]
            if message.msg_name == "BATTERY_STATUS" and with_pack:
                told.append(message_with_changed_fields(message, id=1))
            return told

        stage.tap.to_companion = change
        stage.record_fault_start()
        yield

    return play


def flown(tmp_path, autopilot, seed, play, asks, charge_frac):
    flight = {"vehicle": {"charge_frac": charge_frac}}
    case = FaultCase(25, "monitor-0", "energy", "monitor 0 has no pack", play, asks, flight=flight)
    return fly_case(case, FaultTask(case.name, autopilot, FlightPhase.READY, seed, tmp_path))


@pytest.mark.sample
@pytest.mark.drawn(keep=1, of="seed")
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_pack_is_found_beside_a_monitor_without_one(tmp_path, autopilot, seed):
    charge_pct = (100, 0, 55)[seed - 1]
    row = flown(
        tmp_path,
        autopilot,
        seed,
        monitor_0_has_no_pack(charge_pct),
        (*SAFETY_RULES, check_delivered),
        0.9,
    )
    assert row.passed, (row.failure_text, row.messages)


@pytest.mark.sample
@pytest.mark.drawn(keep=1, of="seed")
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_an_empty_pack_stays_down_whatever_a_monitor_without_one_states(tmp_path, autopilot, seed):
    row = flown(tmp_path, autopilot, seed, monitor_0_has_no_pack(100), (check_no_takeoff,), 0.09)
    assert row.passed, (row.failure_text, row.messages)


@pytest.mark.night  # it waits minutes for an operator
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_without_a_measured_pack_nothing_takes_off_and_the_reason_is_given(tmp_path, autopilot):
    play = monitor_0_has_no_pack(100, with_pack=False)
    row = flown(tmp_path, autopilot, 1, play, (check_no_takeoff,), 0.9)
    assert row.passed, (row.failure_text, row.messages)
    assert any("no battery voltage: received" in text for text in row.messages), row.messages
