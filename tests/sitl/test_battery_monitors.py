"""A battery monitor without a pack beside the pack's own, in flights of both simulated autopilots.

Monitor 0 has no pack: no voltage, no current, and a charge that it states all the same (reported
of PX4 and ArduPilot with a second power module). The real pack answers as monitor 1.
"""

import pytest

from sim_bridge.app.faults.case import SAFE, FaultCase
from sim_bridge.app.faults.fault_row import FaultTask
from sim_bridge.app.faults.runner import fly_flight_fault
from sim_bridge.app.faults.verdict import delivers, stays_down
from sim_bridge.app.link.tap import with_fields

pytestmark = pytest.mark.sitl

UNKNOWN = 65535
EMPTY = {
    "BATTERY_STATUS": {"voltages": (UNKNOWN,) * 10, "current_battery": -1, "current_consumed": -1,
                       "energy_consumed": -1},
    "SYS_STATUS": {"voltage_battery": UNKNOWN, "current_battery": -1},
}  # fmt: skip
"""As MAVLink's common.xml says unknown."""


def monitor_0_has_no_pack(charge_pct, *, with_pack=True):
    def play(stage):
        def change(message):
            empty = EMPTY.get(message.msg_name)
            if empty is None:
                return None
            told = [with_fields(message, **empty, battery_remaining=charge_pct)]
            if message.msg_name == "BATTERY_STATUS" and with_pack:
                told.append(with_fields(message, id=1))
            return told

        stage.tap.to_companion = change
        stage.begin()
        yield

    return play


def flown(tmp_path, autopilot, seed, play, asks, charge_frac):
    flight = {"vehicle": {"charge_frac": charge_frac}}
    case = FaultCase(25, "monitor-0", "energy", "monitor 0 has no pack", play, asks, flight=flight)
    return fly_flight_fault(case, FaultTask(case.name, autopilot, "ready", seed, tmp_path))


@pytest.mark.drawn(keep=1, of="seed")
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_pack_is_found_beside_a_monitor_without_one(tmp_path, autopilot, seed):
    charge_pct = (100, 0, 55)[seed - 1]
    row = flown(
        tmp_path, autopilot, seed, monitor_0_has_no_pack(charge_pct), (*SAFE, delivers), 0.9
    )
    assert row.held, (row.why, row.said)


@pytest.mark.drawn(keep=1, of="seed")
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_an_empty_pack_stays_down_whatever_a_monitor_without_one_states(tmp_path, autopilot, seed):
    row = flown(tmp_path, autopilot, seed, monitor_0_has_no_pack(100), (stays_down,), 0.09)
    assert row.held, (row.why, row.said)


@pytest.mark.night  # it waits minutes for an operator
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_without_a_measured_pack_nothing_takes_off_and_the_reason_is_given(tmp_path, autopilot):
    play = monitor_0_has_no_pack(100, with_pack=False)
    row = flown(tmp_path, autopilot, 1, play, (stays_down,), 0.9)
    assert row.held, (row.why, row.said)
    assert any("no battery voltage: received" in text for text in row.said), row.said
