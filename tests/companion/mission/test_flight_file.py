"""flight/1 files: the shipped ones load, and format errors are reported in one line."""

import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from companion.core.base.location import Location
from companion.core.mission.flight_file import Flight
from sim_bridge.app.flight.scenario import read_faults, read_or_draw_true_wind

FLIGHTS = sorted((Path(__file__).parents[3] / "params" / "flights").glob("*.toml"))
MINIMAL = {
    "format": "flight/1",
    "site": {"customer": {"east_m": 100.0, "north_m": 0.0}},
    "vehicle": {"airframe": "m100"},
}


def flight(**changes) -> Flight:
    return msgspec.convert(MINIMAL | changes, Flight)


@pytest.mark.parametrize("path", FLIGHTS, ids=lambda p: p.stem)
def test_shipped_flights_load_with_their_wind_and_faults(path):
    loaded = msgspec.convert(tomllib.loads(path.read_text()), Flight)
    _, mean = read_or_draw_true_wind(loaded, path, np.random.default_rng(1))
    assert all(np.isfinite(mean.to_ne_mps(t)).all() for t in (0.0, 300.0))
    assert [f.at_s for f in read_faults(loaded, path)] == sorted(f["at_s"] for f in loaded.faults)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"frmat": 1}, "frmat"),
        ({"mission": {"max_loss": 0.9}}, "mission.max_loss"),
        ({"mission": {"reserve_frac": float("nan")}}, "mission.reserve_frac"),
        ({"mission": {"cruise_hight_m": 40.0}}, "cruise_hight_m"),
        ({"vehicle": {"airframe": "m100", "payload_kg": -1.0}}, "vehicle.payload_kg"),
        ({"site": {"customer": {"east_m": 1.0}}}, "east_m and north_m"),
        ({"site": {"customer": {"lat_deg": 99.0, "lon_deg": 0.0, "alt_amsl_m": 0.0}}}, "lat_deg"),
        (
            {"site": {"customer": {"east_m": 1.0, "north_m": 1.0}, "depot": {"east_m": 0.0}}},
            "expected lat_deg",
        ),
    ],
)
def test_a_broken_flight_file_is_refused_and_the_key_is_named(changes, named):
    with pytest.raises((LeewayError, msgspec.ValidationError), match=named.replace(".", r"\.")):
        flight(**changes)


@pytest.mark.parametrize(
    ("wind", "named"),
    [
        ({"kind": "steady", "speed_mps": 5.0}, "from_deg"),
        ({"kind": "steady", "speed_mps": -5.0, "from_deg": 0.0}, "speed_mps"),
        ({"kind": "gale"}, "gale"),
        ({"kind": "points", "points": []}, "points"),
        (
            {
                "kind": "points",
                "points": [
                    {"t_s": 5.0, "speed_mps": 1.0, "from_deg": 0.0},
                    {"t_s": 5.0, "speed_mps": 1.0, "from_deg": 0.0},
                ],
            },
            "ris",
        ),
        ({"kind": "log", "log": "x.csv", "start_s": [0.0, 1.0, 2.0]}, "start_s"),
    ],
)
def test_a_broken_wind_table_is_refused_and_the_place_is_named(wind, named):
    with pytest.raises((LeewayError, msgspec.ValidationError), match=named):
        read_or_draw_true_wind(flight(wind=wind), Path("f.toml"), np.random.default_rng(1))


def test_a_recording_is_started_where_the_seed_says_and_fits_the_mission(tmp_path):
    log = tmp_path / "w.csv"
    rows = "".join(f"{t},5.0,{t / 10}\n" for t in range(2001))
    log.write_text("t_s,wind_speed_mps,wind_from_deg\n" + rows)
    starts = [
        read_or_draw_true_wind(flight(), tmp_path / "f.toml", np.random.default_rng(seed), log)[
            0
        ].start_s
        for seed in (1, 1, 2, 3, 4, 5, 6, 7)
    ]
    assert starts[0] == starts[1]
    assert len(set(starts)) == 7
    assert min(starts) >= 0.0
    assert max(starts) <= 2000.0 - 1800.0  # the default time limit


def test_an_unknown_fault_is_refused_with_its_index():
    with pytest.raises(LeewayError, match=r"faults\[1\]"):
        read_faults(flight(faults=[{"kind": "gnss_lost"}, {"kind": "gremlins"}]), Path("f.toml"))


def test_a_home_that_moves_to_no_stop_of_the_flight_is_refused_with_its_index():
    stop = {"name": "stop-2", "east_m": 300.0, "north_m": 0.0}
    faults = [{"kind": "home_moves", "to": "stop-2"}, {"kind": "home_moves", "to": "stop-9"}]
    table = flight(faults=faults)
    site = msgspec.structs.replace(table.site, stops=[msgspec.convert(stop, Location)])
    with pytest.raises(LeewayError, match=r"faults\[1\].to = 'stop-9': expected a name from site"):
        read_faults(msgspec.structs.replace(table, site=site), Path("f.toml"))
