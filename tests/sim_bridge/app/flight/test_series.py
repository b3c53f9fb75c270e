"""What a series keeps: a flight is known by autopilot, seed and gate under the same settings."""

from dataclasses import replace
from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.app.flight.fly import FlyOptions
from sim_bridge.app.flight.series import SeriesFile, planned, settings_of


@pytest.fixture
def base(tmp_path) -> FlyOptions:
    flight = tmp_path / "flight.toml"
    flight.write_text("# one wind\n")
    return FlyOptions(flight_file=flight)


def test_flights_are_known_again_by_autopilot_seed_and_gate(base, tmp_path):
    flights = planned(base, seeds=[1, 2], autopilots=["px4", "ardupilot"], gates=[True, False])
    path = tmp_path / "rows.json"
    file = SeriesFile.open(path, "settings")
    file.add(flights[5], [{"outcome": "SUC"}])
    again = SeriesFile.open(path, "settings")
    assert [again.has(options) for options in flights] == [k == 5 for k in range(8)]
    (row,) = again.rows_of(flights)
    assert (row["outcome"], row["flavours"], row["seed"], row["gate"]) == ("SUC", "px4", 2, False)
    assert not SeriesFile.open(path, "other settings").has(flights[5])


def test_settings_change_with_the_flight_file_and_the_recording_and_not_with_where_rows_go(base):
    settings = settings_of(base)
    assert settings_of(replace(base, seed=7, run_root=Path("elsewhere"), picture=False)) == settings
    base.flight_file.write_text("# another wind\n")
    assert settings_of(base) != settings
    recording = base.flight_file.with_name("wind.csv")
    recording.write_text("1")
    before = settings_of(replace(base, wind_log=recording))
    recording.write_text("2")
    assert settings_of(replace(base, wind_log=recording)) != before != settings


def test_a_file_of_something_else_is_not_overwritten(base, tmp_path):
    path = tmp_path / "rows.json"
    path.write_text('{"rows": []}')
    with pytest.raises(LeewayError, match="not the JSON of a series"):
        SeriesFile.open(path, settings_of(base))
