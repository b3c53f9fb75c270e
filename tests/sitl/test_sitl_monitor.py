"""A pack at 80 % of its capacity that is stated as new: the monitor alerts its operator."""

import math

import msgspec
import pytest

from companion.adapters.files.monitor_file import read_service_record, write_service_record
from companion.adapters.files.params import read_airframe
from companion.app.flight.monitor_keeper import MonitorKeeper
from companion.core.mission.actions import Finished
from companion.core.monitor.corrections import monitor_corrections_for_pack
from companion.core.monitor.flight_evidence import FlightEvidence, LogRatio

pytestmark = pytest.mark.sitl

CHARGE = {"vehicle": {"charge_frac": 0.8}}
AGED = {"vehicle": {"charge_frac": 0.8, "battery_health_frac": 0.8}}


def flown_before(folder, flights):
    """Write a record of flights of the pack with the figures of one at 80 %, without an alarm."""
    airframe = read_airframe("m100")
    for number in range(flights):
        keeper = MonitorKeeper.read_or_create(folder, "", airframe, "old", "earlier")
        pack = LogRatio(-math.log(0.8), 0.10)
        told = FlightEvidence(LogRatio(0.0, 0.028), pack)
        ended = Finished("SUC", True, "home", takeoff_s=float(number), flight_statistics=told)
        keeper.record_flight_and_get_new_findings(ended, lambda deed: deed())
    service = read_service_record(folder / "m100.json")
    assert service is not None
    assert service.packs["old"].alarm_flight is None, "the flight is to bring the alarm"
    return service


def fly_with(fly_case, short_flight, tmp_path, truth, folder):
    """Fly on the true pack, with a companion whose flight file does not state its age."""
    stated = tmp_path / "stated.toml"
    stated.write_bytes(msgspec.toml.encode(short_flight(CHARGE)))
    arguments = (f"--mission={stated}", "--pack=old", f"--monitor={folder}")
    return fly_case("ardupilot", truth, companion_arguments=arguments)


@pytest.mark.sample
def test_a_pack_at_80_percent_is_told_to_the_operator_and_the_next_flight_doubts_it(
    fly_case, short_flight, tmp_path
):
    folder = tmp_path / "monitor"
    flown_before(folder, 12)
    flown = fly_with(fly_case, short_flight, tmp_path, AGED, folder)
    assert flown.row["home"], flown.row
    assert "monitor: pack old has" in flown.said
    assert "companion monitor reset old" in flown.said
    service = read_service_record(folder / "m100.json")
    assert service is not None
    assert service.flights == 13
    assert monitor_corrections_for_pack(service, "old").capacity_frac < 0.85


@pytest.mark.sample
def test_a_new_pack_is_no_reason_for_an_alarm(fly_case, short_flight, tmp_path):
    folder = tmp_path / "monitor"
    write_service_record(folder / "m100.json", flown_before(folder, 12))
    flown = fly_with(fly_case, short_flight, tmp_path, CHARGE, folder)
    assert "monitor: pack" not in flown.said
