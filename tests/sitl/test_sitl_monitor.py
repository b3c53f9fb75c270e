"""A pack at 80 % of its capacity that is stated as new: the monitor tells its operator."""

import math

import msgspec
import pytest

from companion.adapters.files.monitor_file import read_service, write_service
from companion.adapters.files.params import read_airframe
from companion.app.flight.monitor_keeper import MonitorKeeper
from companion.core.mission.actions import Finished
from companion.core.monitor.doubts import doubts_of
from companion.core.monitor.figures import FlightFigures, LogRatio

pytestmark = pytest.mark.sitl

CHARGE = {"vehicle": {"charge_frac": 0.8}}
AGED = {"vehicle": {"charge_frac": 0.8, "battery_health_frac": 0.8}}


def flown_before(folder, flights):
    """A record of so many flights of the pack, which told what one at 80 % tells, and no alarm."""
    airframe = read_airframe("m100")
    for number in range(flights):
        keeper = MonitorKeeper.open(folder, "", airframe, "old", "earlier")
        pack = LogRatio(-math.log(0.8), 0.10)
        told = FlightFigures(LogRatio(0.0, 0.028), pack)
        ended = Finished("SUC", True, "home", took_off_s=float(number), figures=told)
        keeper.take(ended, lambda deed: deed())
    service = read_service(folder / "m100.json")
    assert service is not None
    assert service.packs["old"].alarm_flight is None, "the flight is to bring the alarm"
    return service


def fly_with(fly_case, short_flight, tmp_path, truth, folder):
    """Fly on the true pack, with a companion whose flight file says nothing of its age."""
    stated = tmp_path / "stated.toml"
    stated.write_bytes(msgspec.toml.encode(short_flight(CHARGE)))
    arguments = (f"--mission={stated}", "--pack=old", f"--monitor={folder}")
    return fly_case("ardupilot", truth, companion_arguments=arguments)


def test_a_pack_at_80_percent_is_told_to_the_operator_and_the_next_flight_doubts_it(
    fly_case, short_flight, tmp_path
):
    folder = tmp_path / "monitor"
    flown_before(folder, 12)
    flown = fly_with(fly_case, short_flight, tmp_path, AGED, folder)
    assert flown.row["home"], flown.row
    assert "monitor: pack old has" in flown.said
    assert "companion monitor reset old" in flown.said
    service = read_service(folder / "m100.json")
    assert service is not None
    assert service.flights == 13
    assert doubts_of(service, "old").capacity_frac < 0.85


def test_a_new_pack_is_no_reason_for_an_alarm(fly_case, short_flight, tmp_path):
    folder = tmp_path / "monitor"
    write_service(folder / "m100.json", flown_before(folder, 12))
    flown = fly_with(fly_case, short_flight, tmp_path, CHARGE, folder)
    assert "monitor: pack" not in flown.said
