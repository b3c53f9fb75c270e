"""`companion certify` on synthetic flights in the M100 layout, and flights under a certificate."""

import json
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.adapters.files.airframe_toml import write_airframe
from companion.adapters.files.certificate_file import certificate_path, read_certificate
from companion.adapters.files.params import flight_file_path, read_airframe
from companion.app.cli.check_report import check_report_lines_and_is_ready
from companion.app.cli.main import app
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions
from companion.core.base.errors import LeewayError

WORLD = Path(__file__).parents[2].joinpath("sim_bridge", "research", "real_flights")
MADE = run_path(str(WORLD / "test_real_flights.py"))
OF_DAY = {"2026-05-01": 1.04, "2026-05-02": 0.98, "2026-05-03": 1.01, "2026-05-04": 1.00}


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """Two flights on each of four days; each day has its own factor on power."""
    folder = tmp_path_factory.mktemp("flights")
    rng = np.random.default_rng(4)
    rows = ["flight,speed,payload,altitude,date,local_time,route,temperature_c"]
    for number in range(8):
        date, factor = list(OF_DAY.items())[number // 2]
        MADE["write_flight"](folder / f"{number}.csv", 8.0, 0.5, factor, (2.0, -1.0), rng)
        rows.append(f"{number},8,500,24,{date},{9 + number % 2}:00,R1,{18 + number // 2}")
    (folder / "parameters.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.fixture
def airframe(tmp_path):
    path = tmp_path / "mine.toml"
    write_airframe(path, read_airframe("m100"), ["by hand"], {})
    return path


def certify(airframe, logs, *words):
    asked = ["certify", *map(str, logs), "--airframe", str(airframe), *words]
    return CliRunner().invoke(app, asked, catch_exceptions=True)


def logs_of(folder):
    return [folder / f"{number}.csv" for number in range(8)]


@pytest.mark.sample
def test_days_are_told_apart_and_the_certificate_lies_beside_the_airframe(flights, airframe):
    done = certify(airframe, logs_of(flights))
    assert done.exit_code == 0, done.output
    found = read_certificate(airframe, read_airframe(str(airframe)))
    assert found is not None
    worst = [day.worst_ratio for day in found.days]
    told = [ratio / worst[3] for ratio in worst]
    assert told == pytest.approx(list(OF_DAY.values()), abs=0.01)
    assert found.envelope.payload_kg == 0.5
    assert found.envelope.air_temperature_c == (19.0, 20.0)
    assert 7.5 < found.envelope.airspeed_mps < 8.0 + np.hypot(2.0, 1.0) + 1.0
    points = sum(day.decision_points for day in found.days)
    # A flight has 86 to 134 s between power on and its last descent.
    assert 8 * 60 < points < 8 * 140
    assert f"exchangeable with these 4 (8 flights, {points:,} decision points)" in done.output
    assert "1 % needs 99 days" in done.output


@pytest.mark.sample
def test_a_log_that_ends_in_the_air_is_left_out_by_name(flights, airframe, tmp_path):
    for path in flights.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    rows = (tmp_path / "3.csv").read_text().splitlines()
    (tmp_path / "3.csv").write_text("\n".join(rows[:450]) + "\n")
    done = certify(airframe, logs_of(tmp_path))
    assert done.exit_code == 0, done.output
    assert "excluded: 3.csv: cut off in flight" in done.output
    found = json.loads(certificate_path(airframe).read_text())
    assert [day["flights"] for day in found["days"]] == [2, 1, 2, 2]
    assert found["left_out"][0].startswith("3.csv: cut off in flight")


@pytest.mark.sample
def test_days_that_the_airframe_was_fitted_to_do_not_count(flights, airframe):
    fitted = "Fitted by `companion calibrate` to: 2.csv (file of 2026-05-02, 0.5 kg); air at 20 C."
    write_airframe(airframe, read_airframe("m100"), [fitted], {})
    done = certify(airframe, logs_of(flights))
    assert done.exit_code == 0, done.output
    for name in ("2.csv", "3.csv"):
        assert f"excluded: {name}: the airframe was fitted to flights of 2026-05-02" in done.output
    found = json.loads(certificate_path(airframe).read_text())
    assert [day["date"] for day in found["days"]] == [d for d in OF_DAY if d != "2026-05-02"]


def test_what_cannot_be_used_is_said_and_nothing_is_written(flights, airframe):
    logs = logs_of(flights)
    for words, said in (
        (["--dates", "2026-05-01"], "8 days as YYYY-MM-DD expected, one for each log"),
        (["--dates", "May," * 7 + "May"], "days as YYYY-MM-DD with commas expected"),
        (["--payload-kg", "0,-1,0,0,0,0,0,0"], "loads in kg with commas expected"),
        (["--max-loss", "1.5"], "expected more than 0 and less than 1"),
    ):
        done = certify(airframe, logs, *words)
        assert done.exit_code == 2, done.output
        assert said in " ".join(str(done.exception or done.output).split()) + done.output
    done = certify(airframe, logs[:4])
    assert "2 days, at least 3 expected" in done.output
    assert "an airframe file (.toml) expected" in certify("m100", logs).output
    assert not certificate_path(airframe).exists()


def test_a_log_whose_day_nobody_knows_is_refused(flights, airframe, tmp_path):
    alone = tmp_path / "0.csv"
    alone.write_bytes((flights / "0.csv").read_bytes())
    done = certify(airframe, [alone])
    assert done.exit_code == 2
    assert "unknown day" in done.output


def options(airframe, tmp_path):
    return RunOptions(
        "udp:127.0.0.1:0", str(airframe), flight_file_path("default"), tmp_path / "run"
    )


@pytest.mark.sample
def test_a_flight_reads_the_certificate_and_the_check_states_it(flights, airframe, tmp_path):
    assert certify(airframe, logs_of(flights)).exit_code == 0
    loaded = LoadedFlight.read_and_validate(options(airframe, tmp_path))
    pilot = loaded.build_pilot(None)
    assert pilot.certificate is not None
    said = "\n".join(check_report_lines_and_is_ready(pilot)[0])
    assert f"ok       certificate: {pilot.certificate.summary_text}" in said
    assert "WARNING  accepted" not in said
    assert "(coast, 22 returns) and 8 certified flights on 4 days" in said


@pytest.mark.sample
def test_a_certificate_of_other_numbers_or_half_a_file_stops_the_flight_before_it_begins(
    flights, airframe, tmp_path
):
    assert certify(airframe, logs_of(flights)).exit_code == 0
    m100 = read_airframe("m100")
    import msgspec

    other = msgspec.structs.replace(
        m100, mass=msgspec.structs.replace(m100.mass, empty_kg=m100.mass.empty_kg + 0.1)
    )
    write_airframe(airframe, other, ["heavier"], {})
    with pytest.raises(
        LeewayError, match=r"issued for other parameters than mine\.toml's: run companion certify"
    ):
        LoadedFlight.read_and_validate(options(airframe, tmp_path))
    path = certificate_path(airframe)
    path.write_text(path.read_text()[:100])
    with pytest.raises(LeewayError, match=r"certificate\.json: not JSON"):
        LoadedFlight.read_and_validate(options(airframe, tmp_path))
