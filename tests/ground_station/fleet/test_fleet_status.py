"""The desk's fleet status: presence, availability, and doubtful members."""

from pathlib import Path
from typing import Any

import pytest

from companion.core.vehicle.airframe import Airframe
from companion.fleet.messages import State
from ground_station.adapters.files.day_files import read_day
from ground_station.core.fleet.fleet_status import FleetStatus

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


def a_state(**more: Any) -> State:
    fields: dict[str, Any] = {
        "vehicle": "d1", "instance_id": "x", "uptime_s": 10.0, "epoch_us": 0, "airframe": "m100",
        "max_payload_kg": 1.0, "phase": "standby", "log": "l", "last_seq": 0,
    }  # fmt: skip
    return State(**{**fields, **more})


def heard(*states: State, airframes: dict[str, Airframe] | None = None) -> FleetStatus:
    status = FleetStatus(DAY.airframes if airframes is None else airframes)
    status.record_liveliness_change("d1", "x", has_joined=True)
    for number, state in enumerate(states):
        status.record_state_and_new_doubts(state, float(number), 0)
    return status


FLYING = {"assignment": "o.1", "armed": True, "phase": "outbound"}


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ([a_state(energy_left_wh=400.0)], "more energy than its pack"),
        ([a_state(voltage_v=5.0)], "no pack of"),
        ([a_state(airframe="octo8")], "not in the day's fleet"),
        (
            [
                a_state(**FLYING, energy_left_wh=60.0),
                a_state(**FLYING, energy_left_wh=90.0, uptime_s=11.0),
            ],
            "rose in flight",
        ),
    ],
)
def test_a_vehicle_that_lies_about_itself_gets_no_work(states: list[State], words: str):
    seen = heard(*states).status_of("d1")
    assert any(words in doubt for doubt in seen.doubts)
    assert not seen.can_take_assignment(1.0)


def test_a_vehicle_is_free_while_it_is_heard_and_stands_by():
    assert heard(a_state(voltage_v=25.0, armed=False)).status_of("d1").can_take_assignment(1.0)
    assert not heard(a_state()).status_of("d1").can_take_assignment(60.0)
    assert not heard(a_state(armed=True)).status_of("d1").can_take_assignment(1.0)
    assert not heard(a_state(phase="outbound")).status_of("d1").can_take_assignment(1.0)


def test_a_clock_that_is_off_is_said_once_and_costs_nothing():
    status = FleetStatus(DAY.airframes)
    status.record_liveliness_change("d1", "x", has_joined=True)
    off = a_state(epoch_us=3_600_000_000)
    assert "off by 3600 s" in status.record_state_and_new_doubts(off, 0.0, 0)[0]
    assert status.record_state_and_new_doubts(off, 1.0, 0) == []
    assert status.status_of("d1").can_take_assignment(1.0)


def test_old_states_of_a_life_that_is_gone_do_not_take_the_place_of_the_one_that_is_there():
    status = heard(a_state())
    status.record_state_and_new_doubts(
        a_state(instance_id="gone", uptime_s=900.0, armed=True), 2.0, 0
    )
    assert status.status_of("d1").state == a_state()
    assert status.status_of("d1").received_s == 0.0
    status.record_liveliness_change("d1", "gone", has_joined=True)  # canary: it is present
    status.record_state_and_new_doubts(
        a_state(instance_id="gone", uptime_s=900.0, armed=True), 3.0, 0
    )
    assert status.status_of("d1").state == a_state(instance_id="gone", uptime_s=900.0, armed=True)


def test_a_vehicle_that_restarts_is_heard_in_its_new_life():
    status = heard(a_state())
    status.record_liveliness_change("d1", "new", has_joined=True)
    status.record_liveliness_change("d1", "x", has_joined=False)
    status.record_state_and_new_doubts(a_state(instance_id="new", uptime_s=1.0), 2.0, 0)
    assert status.status_of("d1").state == a_state(instance_id="new", uptime_s=1.0)
