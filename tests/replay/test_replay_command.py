"""`companion replay`: wind in a known flight, time of the return decision, and output files."""

import csv
import importlib.util
import json
import math
import re
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.analysis.replay.flight_replay import ReplayConfig, replay_flight
from companion.analysis.replay.recorded_flight import LogIssue
from companion.analysis.replay.summary import score_wind_against_reference, summarise_wind_in_flight
from companion.app.cli.main import app
from companion.app.tools.replay_report import replay_report_lines
from companion.core.base.location import Location
from companion.core.mission.actions import Decision
from companion.core.mission.events import AirPressure, Position
from companion.core.mission.flight_file import Flight, Site, Vehicle
from companion.core.vehicle.drag_by_mass import with_drag_over_mass_of

ROOT = Path(__file__).parents[2]
ANEMOMETER = ROOT.parent / "shared/data/estimator/anemometer_uav_5hz.csv"
HEADER = ["t_s", "wind_to_n_mps", "wind_to_e_mps", "std_n_mps", "std_e_mps"]


def run(*arguments):
    return CliRunner().invoke(app, ["replay", *map(str, arguments)])


def terms(*, with_energy=True, pitot=False):
    nowhere = Site(customer=Location(east_m=0.0, north_m=0.0))
    vehicle = Vehicle(airframe="m100", charge_frac=[0.05, 1.0], pitot=pitot, autopilot_wind=True)
    flight = Flight(format="flight/1", site=nowhere, vehicle=vehicle)
    process = read_wind_process(flight.mission.wind_process)
    return ReplayConfig(read_airframe("m100"), flight, process, False, with_energy)


def read_wind(path):
    rows = list(csv.reader(path.read_text().splitlines()))
    assert rows[0] == HEADER
    return np.array(rows[1:], float)


@pytest.mark.sample
@pytest.mark.parametrize("kind", ["csv", "ulog", "dataflash", "tlog"])
def test_the_wind_of_a_known_world_comes_out_of_every_format(make, world, tmp_path, kind):
    if kind == "csv":
        path = make.csv(tmp_path / "f.csv", make.telemetry_csv_columns(world))
    else:
        path = getattr(make, kind)(tmp_path / "f", world)
    assert run(path, "--airframe", "m100", "--out", tmp_path / "w.csv").exit_code == 0
    rows = read_wind(tmp_path / "w.csv")
    flown = rows[(rows[:, 0] > 60.0) & (rows[:, 0] < 140.0)]
    assert len(flown) > 700
    error = flown[:, 1:3] - np.array(
        world.wind_to_ne_mps
    )  # 5 m/s: no estimate at all would be off by this much
    assert np.hypot(*error.T).mean() < 0.8
    assert ((error / flown[:, 3:5]) ** 2).sum(axis=1).mean() < 6.0


def test_wind_csv_has_a_row_for_each_row_of_a_csv_log(make, world, tmp_path):
    slow = world.select_rows(slice(0, None, 2))
    path = make.csv(tmp_path / "f.csv", make.telemetry_csv_columns(slow))
    run(path, "--airframe", "m100", "--out", tmp_path / "w.csv")
    rows = read_wind(tmp_path / "w.csv")
    later = slow.t_s[slow.t_s >= rows[0, 0]]
    assert set(np.round(later, 6)) <= set(np.round(rows[:, 0], 6))
    assert (np.diff(rows[:, 0]) > 0.0).all()


def test_the_mass_of_an_unknown_vehicle_scales_its_drag(make, world, tmp_path):
    path = make.csv(tmp_path / "f.csv", make.telemetry_csv_columns(world))
    speeds = []
    for mass in (0.5, 50.0):  # 100 times the mass, 0.32 times the drag over mass
        assert run(path, "--mass", mass, "--out", tmp_path / "w.csv").exit_code == 0
        rows = read_wind(tmp_path / "w.csv")
        speeds.append(np.hypot(*rows[rows[:, 0] > 60.0, 1:3].T).mean())
    assert speeds[1] > 1.1 * speeds[0]  # the flight narrows the drag
    generic = read_airframe("generic")
    assert with_drag_over_mass_of(generic, 50.0).drag.linear_right_n_per_mps == pytest.approx(
        generic.drag.linear_right_n_per_mps * (50.0 / 3.5) ** -0.25
    )
    refused = run(path, "--mass", 2.0, "--airframe", "m100")
    assert refused.exit_code == 2
    assert "--mass: expected without --airframe" in refused.output


def draining(make, world, capacity_ah):
    """Write the flight with a pack whose resting voltage falls to 3.5 V/cell over `capacity_ah`."""
    columns = make.telemetry_csv_columns(world) | make.battery_csv_columns(world)
    used = columns["consumed_mah"] / (1000.0 * capacity_ah)
    columns["voltage_v"] = 6.0 * (4.2 - 0.6 * used) - np.where(world.flying, 0.9, 0.0)
    return columns


def decisions(make, tmp_path, columns):
    return replay_flight(
        read_log_of_any_format(make.csv(tmp_path / "d.csv", columns)), terms()
    ).decisions


def test_flying_away_with_the_wind_it_says_turn_back_while_home_is_still_in_reach(make, tmp_path):
    away = make.build_outbound_flight((-7.0, 0.0), 8.0, 300.0)  # a headwind of 7 m/s on the return
    said = decisions(
        make, tmp_path, make.telemetry_csv_columns(away) | make.battery_csv_columns(away)
    )
    turns = [d for d in said if d.kind == "turn_back"]
    assert len(turns) == 1
    assert turns[0].p_home_now is not None
    assert turns[0].p_home_now > 0.97
    assert 60.0 < turns[0].t_s < 240.0


def test_with_the_wind_ahead_it_may_fly_farther_than_with_it_behind(make, tmp_path):
    away = make.build_outbound_flight((7.0, 0.0), 8.0, 250.0)
    columns = make.telemetry_csv_columns(away) | make.battery_csv_columns(away)
    assert "turn_back" not in [d.kind for d in decisions(make, tmp_path, columns)]


def test_a_square_near_home_with_a_full_battery_is_never_turned_back(make, world, tmp_path):
    said = decisions(make, tmp_path, draining(make, world, 5.7))
    kinds = [d.kind for d in said]
    assert "turn_back" not in kinds
    assert kinds[0] == "take_off"
    assert kinds[-1] == "landed"


def test_a_replay_settles_the_air_at_take_off_by_what_the_log_tells(make, world, tmp_path):
    log = read_log_of_any_format(make.csv(tmp_path / "h.csv", make.telemetry_csv_columns(world)))
    high = [replace(e, alt_amsl_m=3000.0) if isinstance(e, Position) else e for e in log.events]
    told = (AirPressure(log.start_s, 70_109.0, 55.0), *high)
    measured = replace(log, events=told, position_measured=True)
    notes = replay_flight(measured, terms()).notes
    assert [words for _, words in notes if words.startswith("air ")] == [
        "air 0.780 kg/m3: 701 hPa, 40 C (barometer, its board 15 C warmer)"
    ]


# --- what a log lacks ---------------------------------------------------------------------------


def findings(log, asked=None):
    return "\n".join(map(str, replay_flight(log, asked or terms()).findings))


def test_without_a_battery_only_the_wind_is_said(make, world, tmp_path):
    log = read_log_of_any_format(make.ulog(tmp_path / "a.ulg", replace(world, powered=False)))
    result = replay_flight(log, terms())
    assert any("no battery" in str(f) for f in result.findings)
    assert not result.decisions
    assert summarise_wind_in_flight(result) is not None


def test_another_pack_than_the_airframes_is_not_judged(make, world, tmp_path):
    columns = make.telemetry_csv_columns(world) | make.battery_csv_columns(world)
    columns["voltage_v"] = columns["voltage_v"] / 2.0
    result = replay_flight(read_log_of_any_format(make.csv(tmp_path / "p.csv", columns)), terms())
    assert any("does not fit a pack of 6 cells" in str(f) for f in result.findings)
    assert all(m.assessment is None for m in result.states)


def test_without_attitude_or_on_another_vehicle_no_wind_is_made_up(make, world, tmp_path):
    columns = make.telemetry_csv_columns(world)
    for name in ("roll_deg", "pitch_deg", "yaw_deg", "airspeed_mps"):
        del columns[name]
    blind = replay_flight(read_log_of_any_format(make.csv(tmp_path / "b.csv", columns)), terms())
    assert blind.wind_t_s.size == 0
    plane = read_log_of_any_format(make.ulog(tmp_path / "a.ulg", world, {"MAV_TYPE": 1}))
    assert "fixed wing, multirotor expected" in findings(plane)
    assert replay_flight(plane, terms()).wind_t_s.size == 0


def test_time_in_the_air_is_counted_where_nothing_tells_the_wind(make, world, tmp_path):
    """The flight is airborne from 8.1 s to 153.0 s, measured to the second without that column."""
    columns = make.telemetry_csv_columns(world)
    for name in ("roll_deg", "pitch_deg", "yaw_deg", "airspeed_mps"):
        del columns[name]
    path = make.csv(tmp_path / "b.csv", columns)
    done = run(path, "--json", tmp_path / "b.json")
    assert "wind: not observable from this log" in done.output
    flown_s = json.loads((tmp_path / "b.json").read_text())["log"]["flown_s"]
    assert flown_s == pytest.approx(145.0, abs=2.0)
    printed_s = re.search(r"160 s, (\d+) s in the air", done.output)
    assert printed_s is not None
    assert float(printed_s[1]) == pytest.approx(flown_s, abs=1.0)


HOSTILE = "ArduCopter \x1b]0;owned\x07\x1b[2J[red]V9\u202e\r\nready"


@pytest.mark.parametrize("kind", ["dataflash", "ulog"])
@pytest.mark.parametrize("guarded", [True, False], ids=["ours", "canary"])
def test_what_a_log_calls_its_firmware_does_not_rule_the_terminal(
    make, world, tmp_path, monkeypatch, kind, guarded
):
    if not guarded:
        module = f"companion.adapters.logs.{kind}_log"
        monkeypatch.setattr(f"{module}.safe_text", lambda text: text)
    short = world.select_rows(slice(0, 200))
    if kind == "dataflash":
        path = make.dataflash(tmp_path / "a.bin", short, firmware_text=HOSTILE)
    else:
        path = make.ulog(tmp_path / "a.ulg", short)
        path.write_bytes(path.read_bytes() + ulog_information("ver_sw", HOSTILE))
    printed = run(path, "--airframe", "m100").output
    assert "ArduCopter" in printed
    ruled = any(sign in printed for sign in ("\x1b", "\x07", "\u202e", "[red]"))
    assert ruled is not guarded


def ulog_information(key: str, text: str) -> bytes:
    """Return an information message of the file format (PX4, ULog, message 'I')."""
    value = text.encode()
    named = f"char[{len(value)}] {key}".encode()
    body = bytes([len(named)]) + named + value
    return len(body).to_bytes(2, "little") + b"I" + body


def test_what_is_printed_counts_from_the_logs_start_whatever_its_clock_says(make, world, tmp_path):
    columns = make.telemetry_csv_columns(world) | make.battery_csv_columns(world)
    log = read_log_of_any_format(make.csv(tmp_path / "f.csv", columns))
    late = [replace(event, t_s=event.t_s + 1_700_000_000.0) for event in log.events]
    gap = LogIssue.at_time(log.start_s + 3.0, "gap of 2.0 s", "ages")
    late_gap = LogIssue.at_time(gap.t_s + 1_700_000_000.0, gap.what, gap.done)
    printed = []
    for one in (
        replace(log, findings=(gap,)),
        replace(log, events=tuple(late), findings=(late_gap,)),
    ):
        result = replay_flight(one, terms())
        words = replay_report_lines(tmp_path / "f.csv", one, "m100", result, None, None, 1.0)
        printed.append([line for line in words if "times real time" not in line])
    assert printed[0] == printed[1]
    assert "  ! 3.0 s: gap of 2.0 s; ages" in printed[0]
    assert any("take_off" in line for line in printed[0])


def test_a_log_that_ends_in_the_air_says_so(make, world, tmp_path):
    cut = world.select_rows(world.t_s < 100.0)
    columns = make.telemetry_csv_columns(cut) | make.battery_csv_columns(cut)
    log = read_log_of_any_format(make.csv(tmp_path / "e.csv", columns))
    assert "99.9 s: the log ends in the air" in findings(log)


def test_the_wind_ages_in_a_gap_and_is_found_again(make, world, tmp_path):
    gapped = world.select_rows((world.t_s < 70.0) | (world.t_s > 100.0))
    log = read_log_of_any_format(make.csv(tmp_path / "g.csv", make.telemetry_csv_columns(gapped)))
    result = replay_flight(log, terms(with_energy=False))
    std = np.sqrt(result.wind_cov_m2ps2[:, 0, 0])
    before, after = (int(np.searchsorted(result.wind_t_s, t_s)) for t_s in (69.5, 99.5))
    assert std[after] > 1.5 * std[before]
    last = result.wind_to_ne_mps[(result.wind_t_s > 115.0) & (result.wind_t_s < 140.0)]
    assert np.hypot(*(last - np.array(world.wind_to_ne_mps)).T).mean() < 1.0


# --- what it writes -----------------------------------------------------------------------------


def test_the_record_holds_what_its_page_says(make, world, tmp_path):
    path = make.csv(
        tmp_path / "f.csv", make.telemetry_csv_columns(world) | make.battery_csv_columns(world)
    )
    done = run(path, "--airframe", "m100", "--json", tmp_path / "r.json", "--every", "10")
    assert done.exit_code == 0, done.output
    record = json.loads((tmp_path / "r.json").read_text())
    page = (ROOT / "docs/reference/replay-json.md").read_text()
    assert record["format"] == "replay/1"
    for key in record:
        assert f"`{key}`" in page, key
    assert set(record["decisions"][0]) == {each.name for each in fields(Decision)}
    for key in record["timeline"][0]:
        assert f"`{key}`" in page, key
    times = [row["t_s"] for row in record["timeline"]]
    assert np.median(np.diff(times)) == pytest.approx(10.0)
    assert record["energy"]["used_wh"] == pytest.approx(20.0 * 23.2 * 145.0 / 3600.0, rel=0.05)


@pytest.mark.sample
def test_a_picture_is_drawn_of_wind_alone_and_of_everything(make, world, tmp_path):
    bare = make.csv(tmp_path / "bare.csv", make.telemetry_csv_columns(world))
    full = make.csv(
        tmp_path / "f.csv", make.telemetry_csv_columns(world) | make.battery_csv_columns(world)
    )
    sizes = []
    for path in (bare, full):
        picture = tmp_path / f"{path.stem}.png"
        done = run(path, "--airframe", "m100", "--picture", picture)
        assert done.exit_code == 0, done.output
        head = picture.read_bytes()[:24]
        assert head[:8] == b"\x89PNG\r\n\x1a\n"
        sizes.append(int.from_bytes(head[20:24], "big"))
    assert sizes[1] > 1.3 * sizes[0]  # energy and probability plots below the wind


def test_without_matplotlib_a_picture_is_refused_before_the_work(monkeypatch, tmp_path):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    done = run(tmp_path / "none.csv", "--picture", tmp_path / "p.png")
    assert done.exit_code == 2
    assert "pip install 'leeway-uas[replay]'" in done.output


def test_without_pyulog_a_ulog_is_refused_in_words(monkeypatch, make, world, tmp_path):
    path = make.ulog(tmp_path / "a.ulg", world.select_rows(slice(0, 5)))
    monkeypatch.setitem(sys.modules, "pyulog", None)
    done = run(path)
    assert done.exit_code == 2
    assert "pip install 'leeway-uas[replay]'" in done.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["no.ulg"], "No such file"),
        (["LOG", "--airframe", "zeppelin"], "no such airframe; there are"),
        (["LOG", "--max-loss", "2"], "mission.max_loss"),
        (["LOG", "--flight", "none.toml"], "none.toml"),
        (["LOG", "--airframe", "m100", "--out", "LOG/w.csv"], "w.csv"),
    ],
)
def test_a_mistake_in_the_input_says_what_was_expected(make, world, tmp_path, arguments, words):
    path = make.csv(
        tmp_path / "f.csv", make.telemetry_csv_columns(world.select_rows(slice(0, 150)))
    )
    done = run(*(a.replace("LOG", str(path)) for a in arguments))
    assert done.exit_code == 2
    assert words in done.output
    assert not list(tmp_path.glob("*.new"))


# --- against a reference ------------------------------------------------------------------------


def test_the_score_is_the_error_of_what_is_written(make, world, tmp_path):
    rng = np.random.default_rng(2)
    truth = np.array(world.wind_to_ne_mps) + rng.standard_normal((world.t_s.size, 2))
    columns = make.telemetry_csv_columns(world)
    columns |= {"wind_to_n_ref_mps": truth[:, 0], "wind_to_e_ref_mps": truth[:, 1]}
    log = read_log_of_any_format(make.csv(tmp_path / "r.csv", columns))
    result = replay_flight(log, terms(with_energy=False))
    assert log.reference is not None
    score = score_wind_against_reference(result, log.reference)
    assert score is not None
    inside = (world.t_s >= score.from_s - 1e-6) & (world.t_s <= score.to_s + 1e-6)
    assert abs(score.from_s - 38.0) < 3.0  # 30 s after take-off at 8 s
    assert abs(score.to_s - 153.0) < 4.0
    at = np.searchsorted(result.wind_t_s, world.t_s[inside] + 1e-6) - 1
    error = result.wind_to_ne_mps[at] - truth[inside]
    assert score.rmse_mps == pytest.approx(math.sqrt((error**2).sum(axis=1).mean()), rel=1e-9)
    spread = truth[inside] - truth[inside].mean(axis=0)
    assert score.constant_rmse_mps == pytest.approx(math.sqrt((spread**2).sum(axis=1).mean()))
    nees = [e @ np.linalg.inv(result.wind_cov_m2ps2[i]) @ e for e, i in zip(error, at, strict=True)]
    assert score.nees == pytest.approx(np.mean(nees), rel=1e-6)


@pytest.mark.sample
@pytest.mark.skipif(not ANEMOMETER.is_file(), reason=f"{ANEMOMETER} is not there")
def test_the_anemometer_flight_goes_through_whole(tmp_path):
    done = run(ANEMOMETER, "--out", tmp_path / "w.csv", "--json", tmp_path / "r.json")
    assert done.exit_code == 0, done.output
    record = json.loads((tmp_path / "r.json").read_text())
    rows = read_wind(tmp_path / "w.csv")
    table = np.genfromtxt(ANEMOMETER, delimiter=",", names=True)
    # shared/data/README.md: on the ground for the first 280 s; its height column rises at 268 s.
    assert 264.0 < record["reference"]["from_s"] - 30.0 < 275.0
    flown = table["t_s"] > 300.0
    at = {round(t_s, 6): i for i, t_s in enumerate(rows[:, 0])}
    mine = rows[[at[round(t_s, 6)] for t_s in table["t_s"][flown]], 1:3]
    truth = np.stack([table["wind_to_n_ref_mps"], table["wind_to_e_ref_mps"]], axis=1)[flown]
    rmse = math.sqrt(((mine - truth) ** 2).sum(axis=1).mean())
    assert record["reference"]["rmse_mps"] == pytest.approx(rmse, abs=0.05)
    assert record["reference"]["constant_rmse_mps"] == pytest.approx(1.16, abs=0.02)
