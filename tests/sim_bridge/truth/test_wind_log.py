"""The reader of recordings: accepted input, and errors by file, line and column."""

import csv
import math
from pathlib import Path

import pytest

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.wind_log import load_wind_log

RECORDING = Path(__file__).parents[4] / "shared" / "data" / "wind" / "coast_2023_1hz.csv"
HEADER = "t_s,wind_speed_mps,wind_from_deg\n"


def _file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "wind.csv"
    path.write_text(text)
    return path


def test_columns_may_come_in_any_order(tmp_path: Path) -> None:
    log = load_wind_log(_file(tmp_path, "wind_from_deg,t_s,wind_speed_mps\n90,0,4\n90,1,5\n"))
    assert log.t_s == (0.0, 1.0)
    assert log.to_east_mps == pytest.approx((-4.0, -5.0))


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("t_s,wind_speed_mps,wind_from_deg,gust_mps\n0,1,2,3\n", "line 1.*gust_mps"),
        ("t_s,wind_speed_mps\n0,1\n", "line 1.*wind_from_deg"),
        ("t_s,t_s,wind_speed_mps,wind_from_deg\n0,0,1,2\n", "line 1.*t_s"),
        (HEADER + "0,1,2\n1,nan,2\n", "line 3.*wind_speed_mps"),
        (HEADER + "0,1,2\n1,,2\n", "line 3.*wind_speed_mps"),
        (HEADER + "0,1,2\n1,1,inf\n", "line 3.*wind_from_deg"),
        (HEADER + "0,1,2\n1,x,2\n", "line 3.*wind_speed_mps"),
        (HEADER + "0,1,2\n0,1,2\n", "line 3.*t_s"),
        (HEADER + "0,1,2\n1,1,2\n0.5,1,2\n", "line 4.*t_s"),
        (HEADER + "0,-1,2\n1,1,2\n", "line 2.*wind_speed_mps"),
        (HEADER + "0,101,2\n1,1,2\n", "line 2.*wind_speed_mps"),
        (HEADER + "0,1,-2\n1,1,2\n", "line 2.*wind_from_deg"),
        (HEADER + "0,1,360.5\n1,1,2\n", "line 2.*wind_from_deg"),
        (HEADER + "0,1\n1,1,2\n", "line 2.*cells"),
        (HEADER + "0,1,2,3\n1,1,2\n", "line 2.*cells"),
        (HEADER + "0,1,2\n", "1 rows"),
        (HEADER, "0 rows"),
        ("", "line 1"),
    ],
)
def test_a_bad_file_is_refused_by_file_line_and_column(
    tmp_path: Path, text: str, where: str
) -> None:
    with pytest.raises(TruthError, match=rf"wind\.csv: .*{where}"):
        load_wind_log(_file(tmp_path, text))


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "wind.csv"
    path.write_bytes(b"t_s,wind_speed_mps,wind_from_deg\n\xff\xfe,1,2\n")
    with pytest.raises(TruthError, match=r"wind\.csv"):
        load_wind_log(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TruthError, match=r"none\.csv"):
        load_wind_log(tmp_path / "none.csv")


def test_a_real_recording_reads_as_the_csv_module_reads_it() -> None:
    if not RECORDING.exists():
        pytest.skip("../shared/data/wind/coast_2023_1hz.csv is not here")
    log = load_wind_log(RECORDING)
    with RECORDING.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(log.t_s) == len(rows) > 6000
    for index in (0, 1234, len(rows) - 1):
        speed = float(rows[index]["wind_speed_mps"])
        from_rad = math.radians(float(rows[index]["wind_from_deg"]))
        assert log.to_north_mps[index] == pytest.approx(-speed * math.cos(from_rad))
        assert log.to_east_mps[index] == pytest.approx(-speed * math.sin(from_rad))
