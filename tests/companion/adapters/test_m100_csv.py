"""Reader of the CSV logs of the M100 field flights: axes, clocks, detection of faulty flights."""

import csv
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.logs.flight_table import (
    read_flight_table,
    read_payload_kg_from_flight_table,
)
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.core.base.errors import LeewayError
from companion.core.mission.events import Airspeed, Attitude, Battery, Position, VehicleState

_PLACE = [f"position_{axis}" for axis in "xyz"]
_ATTITUDE = [f"orientation_{axis}" for axis in "xyzw"]
_VELOCITY = [f"velocity_{axis}" for axis in "xyz"]
_SENSORS = ["time", "wind_speed", "wind_angle", "battery_voltage", "battery_current"]
COLUMNS = [*_SENSORS, *_PLACE, *_ATTITUDE, *_VELOCITY]
TABLE = "flight,speed,payload,altitude,date,local_time,route\n"


def turned(axis, angle):
    """Quaternion (x, y, z, w) of a counter-clockwise rotation about an axis."""
    return np.r_[math.sin(angle / 2) * np.array(axis, float), math.cos(angle / 2)]


def product(a, b):
    """Hamilton product: rotation b first, then a."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def rows(attitude=(0.0, 0.0, 0.0, 1.0), velocity=(0.0, 0.0, 0.0), *, seconds=40, ground_s=5):
    """Rows at 5 Hz: at rest, 10 m climb in 5 s, 10 m high at 20 A, descent in 5 s, at rest."""
    table = []
    for i in range(seconds * 5):
        t = i / 5
        up = min(max(t - ground_s, 0.0), max(seconds - ground_s - t, 0.0), 5.0) * 2.0
        flying = ground_s < t < seconds - ground_s
        current = 20.0 if flying else 0.1
        table.append(
            [t, 6.0, 90.0, 22.0, current, -79.78, 40.458, 270.0 + up, *attitude,
             *(velocity if flying else (0.0, 0.0, 0.0))]
        )  # fmt: skip
    return table


def write(path, table, columns=COLUMNS):
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([columns, *table])
    return path


def last(flight, kind):
    return [event for event in flight.events if isinstance(event, kind)][len(flight.events) // 9]


def test_heading_is_counter_clockwise_from_north_and_forward_is_y(tmp_path):
    # Yaw 0 is north; a quarter turn counter-clockwise points west: 3 m/s forward is west.
    west = turned((0, 0, 1), math.pi / 2)
    flight = read_log_of_any_format(write(tmp_path / "1.csv", rows(west, (0.0, 3.0, 0.0))))
    assert last(flight, Attitude).yaw_rad == pytest.approx(-math.pi / 2, abs=1e-6)
    position = last(flight, Position)
    assert (position.vel_n_mps, position.vel_e_mps) == pytest.approx((0.0, -3.0), abs=1e-6)


def test_a_turn_about_the_right_axis_lifts_the_nose(tmp_path):
    up, right = turned((1, 0, 0), math.radians(10)), turned((0, 1, 0), math.radians(5))
    flight = read_log_of_any_format(write(tmp_path / "1.csv", rows(up)))
    assert math.degrees(last(flight, Attitude).pitch_rad) == pytest.approx(10.0)
    flight = read_log_of_any_format(write(tmp_path / "2.csv", rows(right)))
    assert math.degrees(last(flight, Attitude).roll_rad) == pytest.approx(5.0)


def test_velocity_lies_along_the_tilted_body(tmp_path):
    # Nose up by 10 degrees: 4 m/s along the body's forward axis is a climb of 4 sin 10.
    flight = read_log_of_any_format(
        write(tmp_path / "1.csv", rows(turned((1, 0, 0), math.radians(10)), (0.0, 4.0, 0.0)))
    )
    position = last(flight, Position)
    assert position.vel_d_mps == pytest.approx(-4.0 * math.sin(math.radians(10)))
    assert position.vel_n_mps == pytest.approx(4.0 * math.cos(math.radians(10)))


def test_a_combined_attitude_is_scipys(tmp_path):
    from scipy.spatial.transform import Rotation

    heading = turned((0, 0, 1), -1.1)
    attitude = product(product(heading, turned((1, 0, 0), 0.2)), turned((0, 1, 0), 0.1))
    seen = last(read_log_of_any_format(write(tmp_path / "1.csv", rows(attitude))), Attitude)
    # Body right-forward-up becomes forward-right-down; east-north-up becomes north-east-down.
    swap = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    matrix = swap @ Rotation.from_quat(attitude).as_matrix() @ swap
    yaw, pitch, roll = Rotation.from_matrix(matrix).as_euler("ZYX")
    assert (seen.yaw_rad, seen.pitch_rad, seen.roll_rad) == pytest.approx((yaw, pitch, roll))


def test_gzip_reads_as_the_plain_file(tmp_path):
    plain = write(tmp_path / "1.csv", rows())
    packed = tmp_path / "2.csv.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    assert read_log_of_any_format(packed).events == read_log_of_any_format(plain).events


def test_packed_bytes_that_look_like_dataflash_are_still_gzip(tmp_path):
    packed = tmp_path / "1.csv.gz"
    content = gzip.compress(write(tmp_path / "1.csv", rows()).read_bytes())
    # An extra field in the header (RFC 1952, 2.3.1.1) contains dataflash's two bytes.
    packed.write_bytes(content[:3] + b"\x04" + content[4:10] + b"\x02\x00\xa3\x95" + content[10:])
    assert read_log_of_any_format(packed).source == "m100 csv"


@pytest.mark.parametrize("table", [[], rows()[:1]])
def test_a_header_with_hardly_a_row_is_refused_by_file_and_line(tmp_path, table):
    with pytest.raises(LeewayError, match=r"1\.csv: line 2: .*expected 2"):
        read_log_of_any_format(write(tmp_path / "1.csv", table))


def test_a_log_whose_first_time_is_unknown_is_read_from_the_next(tmp_path):
    table = rows()
    table[0][0] = "nan"
    flight = read_log_of_any_format(write(tmp_path / "1.csv", table))
    assert any("line 2: time is no finite number" in str(f) for f in flight.findings)


def test_a_single_sample_of_current_far_off_is_unknown_and_said_by_line(tmp_path):
    table = rows()
    table[100][4] = 45.0
    flight = read_log_of_any_format(write(tmp_path / "1.csv", table))
    assert max(e.current_a for e in flight.events if isinstance(e, Battery) and e.current_a) < 21.0
    assert any("line 102: battery_current jumps" in str(f) for f in flight.findings)


def test_a_surge_of_a_second_stays(tmp_path):
    table = rows()
    for row in table[100:105]:
        row[4] = 35.0
    flight = read_log_of_any_format(write(tmp_path / "1.csv", table))
    assert max(e.current_a for e in flight.events if isinstance(e, Battery) and e.current_a) > 30.0


def test_the_anemometer_is_unknown_on_the_ground_and_set_back_by_its_lag(tmp_path):
    table = rows()
    for row in table:
        row[1] = 5.0 if row[0] < 20.7 else 9.0
    flight = read_log_of_any_format(write(tmp_path / "1.csv", table))
    seen = [e for e in flight.events if isinstance(e, Airspeed)]
    armed = [e for e in flight.events if isinstance(e, VehicleState) and e.armed]
    assert seen[0].t_s >= armed[0].t_s
    first_fast = next(e.t_s for e in seen if e.forward_mps > 7.0)
    assert first_fast == pytest.approx(20.0, abs=0.21)


def test_a_log_that_begins_with_the_take_off_begins_on_the_ground(tmp_path):
    table = [row for row in rows() if row[0] > 5.0]
    flight = read_log_of_any_format(write(tmp_path / "1.csv", table))
    position = next(e for e in flight.events if isinstance(e, Position))
    assert position.height_rel_m == pytest.approx(0.0, abs=0.5)


def test_a_missing_column_is_named(tmp_path):
    columns = [name for name in COLUMNS if name != "position_z"]
    table = [row[:7] + row[8:] for row in rows()]
    with pytest.raises(LeewayError, match=r"1\.csv: line 1: .*missing position_z"):
        read_log_of_any_format(write(tmp_path / "1.csv", table, columns))


def test_a_gap_a_step_back_and_a_bad_quaternion_are_said(tmp_path):
    table = rows()
    table[60][8:12] = [0.0, 0.0, 0.0, 0.0]
    for row in table[120:]:
        row[0] += 8.0
    for row in table[150:]:
        row[0] -= 20.0
    found = " ".join(map(str, read_log_of_any_format(write(tmp_path / "1.csv", table)).findings))
    assert "line 62: the quaternion's length is not 1" in found
    assert "gap of 8" in found
    assert "time goes back by" in found


def test_a_cut_off_gzip_is_an_error_with_its_name(tmp_path):
    packed = tmp_path / "1.csv.gz"
    packed.write_bytes(gzip.compress(write(tmp_path / "1.csv", rows()).read_bytes())[:-300])
    with pytest.raises(LeewayError, match=r"1\.csv\.gz: .*damaged"):
        read_log_of_any_format(packed)


def test_the_table_gives_payload_in_kg_and_hours_after_noon(tmp_path):
    (tmp_path / "parameters.csv").write_text(
        TABLE + "1,12.0,250.0,75,2019-07-03,3:10,R1\n2,10,0,25-50-25,2019-07-03,9:00,R7\n"
    )
    late, early = sorted(read_flight_table(tmp_path), key=lambda f: -f.hour)
    assert (late.payload_kg, late.heights_m, late.hour) == (
        0.25,
        (75.0,),
        pytest.approx(15.167, abs=1e-3),
    )
    assert early.heights_m == (25.0, 50.0, 25.0)
    assert read_payload_kg_from_flight_table(tmp_path / "1.csv.gz") == 0.25
    assert read_payload_kg_from_flight_table(tmp_path / "9.csv.gz") is None


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("1,fast,0,25,2019-07-03,9:00,R1", "line 2: speed = 'fast'"),
        ("1,4,-5,25,2019-07-03,9:00,R1", "line 2: payload = '-5'"),
        ("1,4,0,25,03.07.2019,9:00,R1", "line 2: date"),
        ("1,4,0,25,2019-07-03,9.00,R1", "line 2: local_time"),
        ("1,4,0,high,2019-07-03,9:00,R1", "line 2: altitude"),
        ("../1,4,0,25,2019-07-03,9:00,R1", "line 2: flight"),
        ("1,4,0,25,2019-07-03,9:00,R1\n1,4,0,25,2019-07-03,9:10,R1", "flight 1 occurs twice"),
    ],
)
def test_a_mistake_in_the_table_is_said_by_line(tmp_path, row, said):
    (tmp_path / "parameters.csv").write_text(TABLE + row + "\n")
    with pytest.raises(LeewayError, match=said):
        read_flight_table(tmp_path)


def test_a_folder_without_a_table_says_so(tmp_path: Path):
    with pytest.raises(LeewayError, match=r"parameters\.csv: No such file"):
        read_flight_table(tmp_path)
