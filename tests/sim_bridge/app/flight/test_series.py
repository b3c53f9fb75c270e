"""A series keeps its flights by autopilot, seed and gate under the same settings."""

from dataclasses import replace
from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import ItemDone, ItemLost
from sim_bridge.app.flight import series
from sim_bridge.app.flight.fly import FlyOptions
from sim_bridge.app.flight.series import (
    SeriesFile,
    compute_flight_inputs_digest,
    fly_missing_flights,
    list_flights,
)


@pytest.fixture
def base(tmp_path) -> FlyOptions:
    flight = tmp_path / "flight.toml"
    flight.write_text("# one wind\n")
    return FlyOptions(flight_file=flight)


def test_flights_are_known_again_by_autopilot_seed_and_gate(base, tmp_path):
    flights = list_flights(
        base, seeds=[1, 2], autopilots=["px4", "ardupilot"], gate_states=[True, False]
    )
    path = tmp_path / "rows.json"
    file = SeriesFile.open_with_matching_rows(path, "settings")
    file.store_flight_and_write_file(flights[5], [{"outcome": "SUC"}])
    again = SeriesFile.open_with_matching_rows(path, "settings")
    assert [again.has_flight(options) for options in flights] == [k == 5 for k in range(8)]
    (row,) = again.rows_of(flights)
    assert (row["outcome"], row["flavours"], row["seed"], row["gate"]) == ("SUC", "px4", 2, False)
    assert not SeriesFile.open_with_matching_rows(path, "other settings").has_flight(flights[5])


def test_settings_change_with_the_flight_file_and_the_recording_and_not_with_where_rows_go(base):
    settings = compute_flight_inputs_digest(base)
    assert (
        compute_flight_inputs_digest(
            replace(base, seed=7, run_root=Path("elsewhere"), picture=False)
        )
        == settings
    )
    base.flight_file.write_text("# another wind\n")
    assert compute_flight_inputs_digest(base) != settings
    recording = base.flight_file.with_name("wind.csv")
    recording.write_text("1")
    before = compute_flight_inputs_digest(replace(base, wind_log=recording))
    recording.write_text("2")
    assert compute_flight_inputs_digest(replace(base, wind_log=recording)) != before != settings


def test_a_file_of_something_else_is_not_overwritten(base, tmp_path):
    path = tmp_path / "rows.json"
    path.write_text('{"rows": []}')
    with pytest.raises(LeewayError, match="expected the JSON of a series"):
        SeriesFile.open_with_matching_rows(path, compute_flight_inputs_digest(base))


def one_is_lost(work, do, workers, say):
    """Replaces workers of which one was killed twice, by the flight of seed 2."""
    for index, options in enumerate(work):
        if options.seed == 2:
            yield ItemLost(index, options, "SIGKILL")
        else:
            yield ItemDone(index, [{"outcome": "SUC"}])


def test_a_flight_whose_worker_is_killed_is_named_and_all_others_are_kept(
    base, tmp_path, monkeypatch
):
    monkeypatch.setattr(series, "run_parallel", one_is_lost)
    flights = list_flights(base, seeds=[1, 2, 3], autopilots=["px4"], gate_states=[True])
    run = fly_missing_flights(
        flights,
        SeriesFile.open_with_matching_rows(tmp_path / "rows.json", "settings"),
        worker_count=2,
    )
    assert [row["seed"] for row in run.rows] == [1, 3]
    (words,) = run.lost_flights
    assert words == "px4, seed 2, gate on: SIGKILL"
    again = SeriesFile.open_with_matching_rows(tmp_path / "rows.json", "settings")
    assert [again.has_flight(options) for options in flights] == [True, False, True]
