"""Every log format read back: the same flight in SI, and errors reported with their location.

The files come from independent writers (conftest.py), the truth from the synthetic flight.
"""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from companion.adapters.logs.decision_log import TELEMETRY_TOPICS, DecisionLog, TelemetryRows
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.analysis.replay.airborne import airborne_mask_by_motion
from companion.analysis.replay.recorded_flight import (
    iterate_updated_telemetry_state,
    resample_flight_on_time_grid,
)
from companion.core.base.errors import LeewayError
from companion.core.mission.events import (
    AirPressure,
    Airspeed,
    Attitude,
    AutopilotKind,
    AutopilotWind,
    Battery,
    GroundState,
    Mode,
    Position,
    Throttle,
    Tick,
    VehicleLandedState,
    VehicleState,
)
from companion.core.pilot.telemetry_state import TelemetryState


def of_kind(log, kind):
    return [event for event in log.events if isinstance(event, kind)]


def said(log) -> str:
    return "\n".join(map(str, log.findings))


@pytest.fixture
def written(make, world, tmp_path):
    """Return a writer: `written("ulog")` writes the flight; further arguments go to the writer."""

    def write(kind, flown=world, **options):
        path = tmp_path / {"csv": "a.csv", "ulog": "a.ulg", "dataflash": "a.bin"}.get(
            kind, "a.tlog"
        )
        if kind == "csv":
            return make.csv(
                path, make.telemetry_csv_columns(flown) | make.battery_csv_columns(flown)
            )
        return getattr(make, kind)(path, flown, **options)

    return write


@pytest.mark.parametrize("kind", ["csv", "ulog", "dataflash", "tlog"])
def test_every_format_gives_the_flight_in_si(written, make, world, kind):
    log = read_log_of_any_format(written(kind))
    seen = resample_flight_on_time_grid(log, 0.1)
    assert log.source == kind
    true = {name: np.interp(seen.t_s, world.t_s, column) for name, column in (
        ("vel_n_mps", world.vel_ned_mps[:, 0]),
        ("vel_e_mps", world.vel_ned_mps[:, 1]),
        ("vel_d_mps", world.vel_ned_mps[:, 2]),
        ("roll_rad", world.roll_rad),
        ("pitch_rad", world.pitch_rad),
        ("lat_deg", world.lat_deg),
        ("lon_deg", world.lon_deg),
        ("height_rel_m", -world.pos_ned_m[:, 2]),
    )}  # fmt: skip
    # Coarsest on the wire: cm/s, 1e-7 degrees; readers decimate to about 10 Hz: half a time step.
    allowed = {"lat_deg": 2e-5, "lon_deg": 3e-5, "height_rel_m": 0.4, "roll_rad": 0.03,
               "pitch_rad": 0.03}  # fmt: skip
    steady = (world.t_s > 28.0) & (world.t_s < 33.0)  # a leg without a turn
    span = (seen.t_s > world.t_s[steady][0]) & (seen.t_s < world.t_s[steady][-1])
    assert span.sum() > 30
    for name, truth in true.items():
        error = np.abs(getattr(seen, name)[span] - truth[span]).max()
        assert error < allowed.get(name, 0.09), name
    turned = np.angle(np.exp(1j * (seen.yaw_rad[span] - math.radians(110.0 - 90.0))))
    assert np.abs(turned).max() < 0.01
    in_air = seen.t_s[seen.airborne]
    assert abs(in_air[0] - 8.1) < 0.6
    assert abs(in_air[-1] - 153.0) < 0.6
    flying = (seen.t_s > 10.0) & (seen.t_s < 150.0)
    assert np.allclose(seen.current_a[flying], make.current_a, atol=0.01)
    assert np.allclose(seen.voltage_v[flying], make.voltage_v - 0.9, atol=0.01)
    # 20 A for 145 s
    assert np.nanmax(seen.consumed_ah) == pytest.approx(20.0 * 145.0 / 3600.0, rel=0.01)


def test_what_the_companion_heard_is_read_back_from_our_mcap_as_it_was(tmp_path):
    log, rows, now = DecisionLog(tmp_path / "d.mcap"), TelemetryRows(), TelemetryState()
    told = [
        VehicleState(1.0, Mode.MISSION, "AUTO", armed=True),
        GroundState(1.0, VehicleLandedState.IN_AIR),
        Attitude(1.0, 0.1, -0.05, 3.0),
        Position(1.1, 55.47, 8.45, 52.0, 40.0, 3.0, -2.0, 0.1),
        Battery(1.1, voltage_v=22.5, current_a=None, remaining_frac=0.8),
        Airspeed(1.1, 12.5),
        AutopilotWind(1.2, -4.0, 3.0, None),
        AirPressure(1.2, 70_109.0, 55.0),
        Throttle(1.2, 0.41),
        Attitude(1.2, 0.2, -0.05, 3.0),
    ]
    for event in told:
        now.store_event(event)
        for topic, row in rows.take_new_rows(now):
            log.write(topic, row)
    assert rows.take_new_rows(now) == []  # no new event, no row
    log.close()
    assert sorted(read_log_of_any_format(tmp_path / "d.mcap").events, key=repr) == sorted(
        told, key=repr
    )


LEFT_OUT = {
    "t_s",
    "autopilot_kind",
    "estimator",
    "readiness",
    "disarmed_since_s",
    "ground_amsl_m",
    "home_below_ground_m",
    "pack",  # each of its messages is a row of heard_battery
    "position_watch",  # derived from positions, heights and GNSS fixes
    "observed",  # derived from rows of other topics
}


def test_our_mcap_keeps_all_that_the_situation_is_made_of():
    """The omitted fields only decide whether the companion may command, which a replay does not."""
    parts = {field.name for field in fields(TelemetryState) if not field.name.startswith("_")}
    assert parts - set(TELEMETRY_TOPICS) == LEFT_OUT


def test_an_mcap_without_telemetry_points_to_the_stream_beside_it(tmp_path):
    log = DecisionLog(tmp_path / "d.mcap")
    log.write("said", {"t_s": 1.0, "severity": 6, "text": "hello"})
    log.close()
    with pytest.raises(LeewayError, match=r"heard_attitude.*found said.*stream\.tlog"):
        read_log_of_any_format(tmp_path / "d.mcap")


# --- what is not a fact -------------------------------------------------------------------------


def test_px4_without_a_current_sensor_leaves_current_and_counter_unknown(written):
    batteries = of_kind(read_log_of_any_format(written("ulog", with_current=False)), Battery)
    assert {(b.current_a, b.consumed_ah) for b in batteries} == {(None, None)}
    assert all(b.voltage_v is not None for b in batteries)


@pytest.mark.parametrize(("source", "taken"), [(-1, False), (0, False), (1, True), (4, False)])
def test_only_a_sensor_is_an_airspeed_on_px4(written, source, taken):
    assert (
        bool(of_kind(read_log_of_any_format(written("ulog", airspeed_source=source)), Airspeed))
        is taken
    )


@pytest.mark.parametrize("fused", [0, 1])
def test_px4_wind_is_taken_with_drag_fusion_only_and_points_where_it_blows_to(
    written, world, fused
):
    log = read_log_of_any_format(
        written("ulog", parameters={"EKF2_DRAG_CTRL": fused}, with_wind_estimate=True)
    )
    winds = of_kind(log, AutopilotWind)
    assert bool(winds) is bool(fused)
    assert all((w.to_n_mps, w.to_e_mps) == world.wind_to_ne_mps for w in winds)
    assert all(w.std_mps == 0.5 for w in winds)


def test_ardupilot_airspeed_and_wind_need_what_makes_them_real(written, world):
    short = world.select_rows(slice(0, 150))
    bare = read_log_of_any_format(written("dataflash", short))
    assert not of_kind(bare, Airspeed)
    assert not of_kind(bare, AutopilotWind)
    fitted = read_log_of_any_format(
        written("dataflash", short, parameters={"ARSPD_TYPE": 1.0, "EK3_DRAG_BCOEF_X": 80.0})
    )
    assert of_kind(fitted, Airspeed)
    winds = of_kind(fitted, AutopilotWind)
    assert {(w.to_n_mps, w.to_e_mps) for w in winds} == {world.wind_to_ne_mps}
    assert not of_kind(
        read_log_of_any_format(
            written(
                "dataflash", short, parameters={"EK3_DRAG_BCOEF_X": 80.0}, with_wind_estimate=False
            )
        ),
        AutopilotWind,
    )


def test_ardupilot_wind_on_the_stream_is_not_believed_without_its_parameter(written):
    assert not of_kind(
        read_log_of_any_format(written("tlog", px4=False, with_wind_estimate=True)), AutopilotWind
    )


@pytest.mark.parametrize(
    ("kind", "options", "name"),
    [
        ("ulog", {"parameters": {"MAV_TYPE": 1}}, "fixed wing"),
        ("dataflash", {"firmware_text": "ArduPlane V4.5.7 (abcdef01)"}, "fixed wing"),
        ("tlog", {"mav_type": 1}, "fixed wing"),
        ("ulog", {"parameters": {"MAV_TYPE": 22}}, "VTOL"),
        ("tlog", {"mav_type": 10, "px4": False}, "rover"),
        ("tlog", {"mav_type": 13}, "multirotor"),
    ],
)
def test_the_kind_of_vehicle_is_told(written, world, kind, options, name):
    log = read_log_of_any_format(written(kind, world.select_rows(slice(0, 150)), **options))
    assert log.vehicle == name
    assert log.is_multirotor_or_unknown is (name == "multirotor")
    assert log.autopilot_kind is (
        AutopilotKind.PX4 if options.get("px4", kind != "dataflash") else AutopilotKind.ARDUPILOT
    )


def test_a_dataflash_log_that_begins_armed_is_armed_from_the_start(written):
    states = of_kind(read_log_of_any_format(written("dataflash")), VehicleState)
    assert [s.armed for s in states] == [True, True, False]
    assert states[-1].t_s == pytest.approx(159.9)


def test_only_one_of_two_vehicles_in_a_stream_is_read(written, make, world, tmp_path):
    ours = written("tlog").read_bytes()
    short = world.select_rows(slice(0, 200))
    other = make.tlog(tmp_path / "o.tlog", short, px4=False, system_id=7).read_bytes()
    (tmp_path / "two.tlog").write_bytes(ours + other)
    log = read_log_of_any_format(tmp_path / "two.tlog")
    assert log.autopilot_kind is AutopilotKind.PX4
    assert len(of_kind(log, Attitude)) == world.t_s.size
    assert "other systems in the log: 7" in said(log)


# --- what is wrong, and where -------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["csv", "ulog", "dataflash", "tlog"])
def test_a_log_cut_off_anywhere_is_used_up_to_there(written, world, kind):
    path = written(kind, world.select_rows(slice(0, 500)))
    whole, raw = read_log_of_any_format(path), path.read_bytes()
    for share in (0.5, 0.999):
        path.write_bytes(raw[: int(share * len(raw))])
        log = read_log_of_any_format(path)
        assert log.duration_s > (share - 0.25) * whole.duration_s
        assert log.duration_s < whole.duration_s + 0.01
        assert len(log.events) > (share - 0.25) * len(whole.events)


@pytest.mark.parametrize("kind", ["ulog", "dataflash", "tlog"])
def test_damaged_bytes_cost_only_what_they_hit(written, world, kind):
    path = written(kind, world.select_rows(slice(0, 500)))
    whole, raw = read_log_of_any_format(path), bytearray(path.read_bytes())
    rng = np.random.default_rng(3)
    middle = len(raw) // 2
    raw[middle : middle + 60] = rng.integers(0, 256, 60, np.uint8).tobytes()
    path.write_bytes(bytes(raw))
    log = read_log_of_any_format(path)
    assert log.duration_s > 0.9 * whole.duration_s or kind != "tlog"
    assert log.findings or len(log.events) >= 0.98 * len(whole.events)
    assert all(math.isfinite(event.t_s) for event in log.events)


@pytest.fixture
def csv_lines(make, world, tmp_path):
    """Return a reader of the file after `change` has modified its lines, header first."""

    def read(change):
        path = make.csv(
            tmp_path / "c.csv", make.telemetry_csv_columns(world) | make.battery_csv_columns(world)
        )
        lines = path.read_text().splitlines()
        path.write_text("\n".join(change(lines)) + "\n")
        return read_log_of_any_format(path)

    return read


def cell(lines, number, column, text):
    """Change one cell of line `number` (1 is the header)."""
    cells = lines[number - 1].split(",")
    cells[lines[0].split(",").index(column)] = text
    return [*lines[: number - 1], ",".join(cells), *lines[number:]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda x: cell(x, 40, "roll_deg", "abc"), "line 40: roll_deg is no finite number"),
        (lambda x: cell(x, 40, "vel_n_mps", "nan"), "line 40: vel_n_mps is no finite number"),
        (lambda x: cell(x, 41, "vel_e_mps", "inf"), "line 41: vel_e_mps is no finite number"),
        (lambda x: cell(x, 42, "vel_d_mps", "700"), "line 42: vel_d_mps = 700, expected -50 to 50"),
        (lambda x: cell(x, 43, "t_s", ""), "line 43: no time stamp"),
        (lambda x: cell(x, 44, "t_s", "99999"), "line 44: time stamp far from its neighbours"),
        (lambda x: cell(x, 45, "t_s", "-50"), "line 45: time stamp far from its neighbours"),
        (lambda x: [*x[:99], x[98], *x[99:]], "line 100: time stamp repeated or late"),
        (lambda x: [*x[:60], x[60][:12], *x[61:]], "line 61: a number of cells other than"),
        (lambda x: [*x[:200], *x[300:]], "line 201: gap of 10.1 s (from 19.8 to 29.9 s)"),
    ],
    ids=["text", "nan", "inf", "wild", "no time", "ahead", "back", "twice", "torn", "gap"],
)
def test_what_is_wrong_with_a_csv_is_said_by_its_line(csv_lines, world, change, words):
    log = csv_lines(change)
    assert words in said(log)
    times = [e.t_s for e in of_kind(log, Attitude)]
    assert len(times) >= world.t_s.size - 101
    assert times == sorted(times)
    assert times[-1] == pytest.approx(159.9)


def test_a_clock_that_steps_back_goes_on_from_where_it_was(csv_lines, world):
    def restart(lines):
        for number in range(800, len(lines) + 1):
            t_s = float(lines[number - 1].split(",")[0])
            lines = cell(lines, number, "t_s", f"{t_s - 60.0:.9g}")
        return lines

    log = csv_lines(restart)
    assert "line 800: time goes back by 59.9 s (from 79.7 to 19.8 s)" in said(log)
    times = np.array([e.t_s for e in of_kind(log, Attitude)])
    assert times.size == world.t_s.size
    assert np.diff(times) == pytest.approx(0.1)


def in_unit(world, make, path, **factors):
    columns = make.telemetry_csv_columns(world) | make.battery_csv_columns(world)
    return make.csv(
        path, {n: v * factors.get(n.rsplit("_", 1)[0], 1.0) for n, v in columns.items()}
    )


@pytest.mark.sample
@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ({"roll": math.pi / 180, "pitch": math.pi / 180, "yaw": math.pi / 180}, "radians"),
        ({"yaw": math.pi / 180}, "columns yaw_deg: these are radians"),
        ({"vel_n": 100.0, "vel_e": 100.0, "vel_d": 100.0}, "these are cm/s"),
        ({"t": 1e3}, "these are milliseconds"),
        ({"t": 1e6}, "these are microseconds"),
        ({"voltage": 1e3}, "column voltage_v: usual value"),
    ],
    ids=["radians", "yaw only", "cm/s", "ms", "us", "mV"],
)
def test_wrong_units_are_found_said_and_converted(make, world, tmp_path, factors, words):
    right = resample_flight_on_time_grid(
        read_log_of_any_format(in_unit(world, make, tmp_path / "right.csv")), 0.1
    )
    log = read_log_of_any_format(in_unit(world, make, tmp_path / "wrong.csv", **factors))
    assert words in said(log)
    seen = resample_flight_on_time_grid(log, 0.1)
    for name in ("t_s", "vel_n_mps", "vel_d_mps", "roll_rad", "yaw_rad", "voltage_v", "lat_deg"):
        assert np.allclose(getattr(seen, name), getattr(right, name), atol=1e-5, equal_nan=True)


@pytest.mark.parametrize("seed", range(4))
def test_right_units_are_left_alone(make, tmp_path, seed):
    angle = 1.6 * seed
    flown = make.build_square_flight(
        (8.0 * math.cos(angle), 8.0 * math.sin(angle)), rate_hz=5.0 + 5 * seed
    )
    log = read_log_of_any_format(make.csv(tmp_path / "r.csv", make.telemetry_csv_columns(flown)))
    assert "these are" not in said(log)


def test_unknown_columns_empty_cells_and_missing_columns_break_nothing(make, world, tmp_path):
    columns = make.telemetry_csv_columns(world)
    del columns["airspeed_mps"]
    columns["yaw_deg"] = np.where(world.t_s < 80.0, np.nan, columns["yaw_deg"])
    columns["rpm_1"] = np.full(world.t_s.size, 6000.0)
    log = read_log_of_any_format(make.csv(tmp_path / "x.csv", columns))
    assert min(e.t_s for e in of_kind(log, Attitude)) == pytest.approx(80.0)
    assert len(of_kind(log, Position)) == world.t_s.size
    assert not of_kind(log, Airspeed)


WITH_TILT = b"t_s,vel_n_mps,vel_e_mps,vel_d_mps,roll_deg,pitch_deg,yaw_deg"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"", "the file is empty"),
        ("a.csv", b"t_s,vel_n_mps,vel_e_mps\n1,2,3\n", "line 1: .*missing vel_d_mps"),
        ("a.csv", b"t_s;vel_n_mps;vel_e_mps;vel_d_mps\n1;2;3;4\n", "comma separated"),
        ("a.csv", b"t_s,vel_n_mps,vel_e_mps,vel_d_mps,t_s\n", "column t_s occurs twice"),
        ("a.csv", b"t_s,vel_n_mps,vel_e_mps,vel_d_mps\n", "0 rows"),
        ("a.csv", WITH_TILT + b"\n", "0 rows"),
        ("a.csv", WITH_TILT + b"\n" + b"nan,nan,nan,nan,nan,nan,nan\n" * 3, "0 rows"),
        ("a.ulg", b"ULog\x01\x12\x35\x01" + bytes(8), "none of vehicle_attitude"),
        ("a.ulg", b"ULog\x01\x12\x35", "damaged definitions, expected a ULog of PX4"),
        ("a.bin", b"\xa3\x95\x80" + bytes(300), "dataflash|DFReader"),
        ("a.tlog", bytes(8) + b"\xfd\x00" + bytes(40), "unknown log format"),
        ("a.mcap", b"\x89MCAP0\r\n", "heard_attitude"),
        ("a.gz", b"\x1f\x8b" + bytes(100), "compressed file .gzip."),
        ("a.jpg", b"\xff\xd8\xff\xe0" + bytes(100), "unknown log format"),
    ],
)
def test_a_file_that_is_no_flight_is_refused_in_words(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(LeewayError, match=words):
        read_log_of_any_format(path)


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(LeewayError, match="No such file"):
        read_log_of_any_format(tmp_path / "none.ulg")


# --- in the air or not --------------------------------------------------------------------------


@pytest.mark.parametrize("with_height", [True, False])
def test_a_flight_is_found_by_its_motion(world, with_height):
    tilt = np.column_stack([world.roll_rad, world.pitch_rad])
    height = -world.pos_ned_m[:, 2] if with_height else None
    flying = airborne_mask_by_motion(world.t_s, world.vel_ned_mps, tilt, height)
    flown = world.t_s[flying]
    assert 7.9 < flown[0] < 10.5
    assert 151.0 < flown[-1] < 156.0
    assert flying[(world.t_s > 12.0) & (world.t_s < 151.0)].all()


def test_two_flights_in_a_log_and_one_that_begins_in_the_air(world):
    again = replace(world, t_s=world.t_s + 170.0)
    t_s = np.concatenate([world.t_s, again.t_s])
    vel = np.concatenate([world.vel_ned_mps, world.vel_ned_mps])
    tilt = np.tile(np.column_stack([world.roll_rad, world.pitch_rad]), (2, 1))
    flying = airborne_mask_by_motion(t_s, vel, tilt, None)
    assert np.count_nonzero(np.diff(flying.astype(int)) > 0) == 2
    late = world.select_rows(world.t_s > 30.0)
    tilt = np.column_stack([late.roll_rad, late.pitch_rad])
    assert airborne_mask_by_motion(late.t_s, late.vel_ned_mps, tilt, None)[0]


def test_a_vehicle_that_never_leaves_the_ground_never_flies(world):
    rng = np.random.default_rng(5)
    vel = 0.1 * rng.standard_normal(world.vel_ned_mps.shape)
    tilt = np.radians(0.05) * rng.standard_normal((world.t_s.size, 2))
    assert not airborne_mask_by_motion(world.t_s, vel, tilt, None).any()


def test_moments_fall_on_telemetry_and_fill_gaps_as_ticks_do(make, world, tmp_path):
    gapped = world.select_rows((world.t_s < 40.0) | (world.t_s > 45.0))
    log = read_log_of_any_format(make.csv(tmp_path / "g.csv", make.telemetry_csv_columns(gapped)))
    times = [now.t_s for now in iterate_updated_telemetry_state(log, 0.1)]
    assert np.diff(times).min() > 0.09
    assert np.diff(times).max() < 0.21
    assert set(np.round(gapped.t_s, 6)) <= set(np.round(times, 6))
    assert Tick(1.0) not in log.events
