"""A growing wind station file: rows by a logger, and file errors."""

import pytest

from ground_station.adapters.files.station_file import TAIL_BYTES, StationFile

HEADER = "time_utc,wind_speed_mps,wind_from_deg\n"
ROW = "2026-05-01T10:00:{:02d}Z,{},270\n"


def speeds(file: StationFile) -> list[float]:
    winds, wrong = file.read_new_winds_and_problems()
    assert wrong == []
    return [wind.speed_mps for wind in winds]


def test_rows_come_once_each_as_they_are_appended(tmp_path):
    path = tmp_path / "mast.csv"
    path.write_text(HEADER + ROW.format(0, 5.0))
    file = StationFile("mast", path)
    assert speeds(file) == [5.0]
    assert speeds(file) == []
    with path.open("a") as log:
        log.write(ROW.format(10, 6.0) + ROW.format(20, 7.0)[:15])
    assert speeds(file) == [6.0], "half a row waits for its end"
    with path.open("a") as log:
        log.write(ROW.format(20, 7.0)[15:])
    winds, _ = file.read_new_winds_and_problems()
    assert [(w.station, w.speed_mps, w.from_deg, w.std_mps) for w in winds] == [
        ("mast", 7.0, 270.0, None)
    ]
    assert winds[0].epoch_us == 1_777_629_620_000_000  # date -u -d 2026-05-01T10:00:20Z +%s


def test_seconds_and_offsets_are_times_and_columns_may_stand_in_any_order(tmp_path):
    path = tmp_path / "mast.csv"
    path.write_text(
        "std_mps, wind_from_deg, time_utc, wind_speed_mps\n0.4,90,1777629620,3\n"
        ",90,2026-05-01T12:00:20+02:00,3\n"
    )
    winds, wrong = StationFile("mast", path).read_new_winds_and_problems()
    assert wrong == []
    assert [w.epoch_us for w in winds] == [1_777_629_620_000_000] * 2
    assert [w.std_mps for w in winds] == [0.4, None]


def test_a_file_that_comes_later_goes_and_is_begun_anew(tmp_path):
    path = tmp_path / "mast.csv"
    file = StationFile("mast", path)
    winds, wrong = file.read_new_winds_and_problems()
    assert winds == []
    assert wrong == [f"station mast: {path}: No such file or directory"]
    assert file.read_new_winds_and_problems() == ([], [])  # reported once
    path.write_text(HEADER[:10])
    assert speeds(file) == []
    path.write_text(HEADER + ROW.format(0, 5.0))
    assert speeds(file) == [5.0]
    path.write_text(HEADER)  # truncated by the logger
    assert speeds(file) == []
    with path.open("a") as log:
        log.write(ROW.format(30, 8.0))
    assert speeds(file) == [8.0]
    fresh = tmp_path / "new"
    fresh.write_text(HEADER + "# a longer file\n" * 9 + ROW.format(40, 9.0))
    fresh.replace(path)  # rotated: same name, another file
    winds, wrong = file.read_new_winds_and_problems()
    assert [wind.speed_mps for wind in winds] == [9.0]
    assert len(wrong) == 1


def test_of_a_long_file_only_the_newest_rows_are_news(tmp_path):
    path = tmp_path / "mast.csv"
    path.write_text(HEADER + "".join(ROW.format(k % 60, k % 50) for k in range(5000)))
    assert path.stat().st_size > 2 * TAIL_BYTES
    found = StationFile("mast", path).read_new_winds_and_problems()[0]
    assert 0 < len(found) < TAIL_BYTES // 20
    assert all(w.speed_mps <= 100.0 for w in found)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("yesterday,5,270", "time_utc = 'yesterday', expected as 2026-07-01T15:10:30Z"),
        ("2026-05-01T10:00:00,5,270", "expected as 2026-07-01T15:10:30Z"),
        ("2026-05-01T10:00:00Z,fast,270", "wind_speed_mps = 'fast', expected a number"),
        ("2026-05-01T10:00:00Z,5", "row of 2 cells, expected 3"),
        ("2026-05-01T10:00:00Z,-5,270", "speed_mps"),
        ("2026-05-01T10:00:00Z,nan,270", "speed_mps"),
        ("2026-05-01T10:00:00Z,5,400", "from_deg"),
        ("1e300,5,270", "expected as 2026"),
        ("inf,5,270", "time_utc"),
        ("\x1b[31m,5,270", "time_utc"),
    ],
)
def test_a_wrong_row_is_said_with_its_file_and_those_after_it_are_read(tmp_path, row, words):
    path = tmp_path / "mast.csv"
    path.write_text(HEADER + f"{row}\n{row}\n" + ROW.format(1, 6.0))
    winds, wrong = StationFile("mast", path).read_new_winds_and_problems()
    assert [wind.speed_mps for wind in winds] == [6.0]
    (said,) = wrong
    assert said.startswith(f"station mast: {path}: ")
    assert words in said
    assert "\x1b" not in said


@pytest.mark.parametrize(
    "header",
    ["a,b,c\n", "time_utc,wind_speed_mps\n", HEADER.strip() + ",lat\n", "x" * 1200, "\xff\xfe\n"],
)
def test_a_file_of_other_columns_is_said_once_and_looked_at_again(tmp_path, header):
    path = tmp_path / "mast.csv"
    path.write_text(header, encoding="latin-1")
    file = StationFile("mast", path)
    winds, wrong = file.read_new_winds_and_problems()
    assert winds == []
    assert len(wrong) == 1
    assert file.read_new_winds_and_problems() == ([], [])
    path.write_text(HEADER + ROW.format(0, 5.0))
    assert speeds(file) == [5.0]
