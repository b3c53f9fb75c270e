"""The monitor's stored record through flights, kills, torn files and changed certificates."""

import math

import msgspec
import pytest
from typer.testing import CliRunner

from companion.adapters.files.monitor_file import read_service_record
from companion.adapters.files.params import (
    params_dir,
    read_airframe,
    read_flight,
    read_wind_process,
)
from companion.app.cli.main import app
from companion.app.flight.monitor_keeper import MonitorKeeper
from companion.core.mission.actions import Finished
from companion.core.monitor.corrections import NO_CORRECTIONS, MonitorCorrections
from companion.core.monitor.flight_evidence import FlightEvidence, LogRatio
from companion.core.pilot.estimates import FlightEstimates
from companion.core.routing.leg_energy import RouteEnergy

AIRFRAME = read_airframe("m100")
DAY_S = 86400.0


def at_once(deed):
    deed()


def ended(draw, took_off_s):
    told = FlightEvidence(LogRatio(math.log(draw), 0.028))
    return Finished("SUC", True, "home", takeoff_s=took_off_s, flight_statistics=told)


class Service:
    """A vehicle whose companion is a new process for each flight."""

    def __init__(self, folder):
        self.folder, self.flights = folder, 0

    def open(self, airframe=AIRFRAME):
        keeper = MonitorKeeper.read_or_create(self.folder, "d1", airframe, "A", "digest")
        keeper.epoch_s = lambda: self.flights // 10 * DAY_S + self.flights % 10 * 1800.0
        keeper.replace_damaged_record(at_once)
        return keeper

    def fly(self, draw, flights=1):
        said = []
        for _ in range(flights):
            self.flights += 1
            said += self.open().record_flight_and_get_new_findings(
                ended(draw, float(self.flights)), at_once
            )[1]
        return said


@pytest.fixture
def service(tmp_path):
    return Service(tmp_path)


def test_an_alarm_comes_once_and_outlives_the_companion(service):
    assert service.fly(1.0, 30) == []
    said = service.fly(1.15, 30)
    assert len(said) == 1
    assert "companion monitor reset draw" in said[0]
    assert service.open().corrections.draw_log == pytest.approx(math.log(1.15), abs=0.01)


def test_a_companion_that_is_killed_before_its_record_is_written_loses_no_earlier_flight(service):
    service.fly(1.0, 3)
    service.open().record_flight_and_get_new_findings(ended(1.0, 99.0), lambda deed: None)
    assert service.open().service.flights == 3
    # After the restart it sees the same landing, and the disk accepts it; then twice.
    for _ in range(2):
        service.open().record_flight_and_get_new_findings(ended(1.0, 99.0), at_once)
    assert service.open().service.flights == 4


def torn(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def garbage(path):
    path.write_bytes(b"\xff\x00 no json")


def foreign(path):
    path.write_text('{"crc32": 1, "content": "{}"}')


@pytest.mark.parametrize("break_it", [torn, garbage, foreign])
def test_a_torn_record_says_so_and_begins_anew_with_the_careful_belief(service, break_it):
    service.fly(1.0, 3)
    path = service.folder / "d1.json"
    break_it(path)
    broken = path.read_bytes()
    keeper = service.open()
    assert "record reset" in keeper.error_text
    assert str(path) in keeper.error_text
    assert keeper.corrections.draw_log == pytest.approx(math.log(1.1))
    assert path.with_suffix(".broken").read_bytes() == broken
    again = service.open()  # a companion killed right after that is equally cautious
    assert again.error_text == ""
    assert again.corrections == keeper.corrections


def test_a_flight_that_never_was_is_not_counted(service):
    keeper = service.open()
    grounded = Finished("ABRT", False, "never took off", home=True)
    assert keeper.record_flight_and_get_new_findings(grounded, at_once) == (grounded, ())
    assert not (service.folder / "d1.json").exists()


def test_another_airframe_file_begins_the_draw_anew_on_record(service):
    service.fly(1.15, 30)
    power = msgspec.structs.replace(AIRFRAME.power_rotor, drive_efficiency=0.8)
    keeper = service.open(msgspec.structs.replace(AIRFRAME, power_rotor=power))
    assert keeper.corrections == NO_CORRECTIONS
    assert keeper.service.resets[-1].reason == "the airframe file has changed"


def test_the_command_shows_an_alarm_and_a_person_resets_it_by_name(service):
    def monitor(*words):
        return CliRunner().invoke(app, ["monitor", *words, "--monitor", str(service.folder)])

    service.fly(1.15, 30)
    shown = monitor("status")
    assert shown.exit_code == 0
    assert "ALARM  draw: 30 flights" in shown.output
    asked = ["reset", "draw", "--by", "Kim"]
    assert monitor(*asked).exit_code == 2, "without a reason"
    assert monitor(*asked, "--why", "new propellers").exit_code == 0
    kept = read_service_record(service.folder / "d1.json")
    assert kept is not None
    assert kept.draw.alarm_flight is None
    after = monitor("status").output
    assert "nothing is in doubt" in after
    assert "draw reset after flight 30 by Kim: new propellers" in after


def estimates(doubts):
    flight = read_flight(params_dir() / "flights" / "default.toml")
    process = read_wind_process("coast")
    return FlightEstimates(
        flight, AIRFRAME, RouteEnergy(AIRFRAME), process, monitor_corrections=doubts
    )


def test_what_is_in_doubt_enters_the_estimates_and_nothing_else_does():
    usual, untroubled = (
        estimates(NO_CORRECTIONS).snapshot(),
        estimates(MonitorCorrections()).snapshot(),
    )
    assert usual == untroubled
    doubted = estimates(
        MonitorCorrections(draw_log=0.1, draw_std=0.03, capacity_frac=0.8, wind_variance=2.0)
    )
    kept = doubted.snapshot()
    assert kept["ledger"]["usable_full_wh"] == pytest.approx(
        0.8 * usual["ledger"]["usable_full_wh"]
    )
    assert kept["scale"]["log"] == 0.1
    assert kept["scale"]["variance"] == pytest.approx(usual["scale"]["variance"] + 0.03**2)
    assert kept["outlook"]["cov"][0][0] == pytest.approx(2.0 * usual["outlook"]["cov"][0][0])
