"""Wind recordings: faults are reported by file and line, the rest is used."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from typer.testing import CliRunner

from companion.adapters.logs.wind_logs import read_wind_log
from companion.analysis.wind_fit.log_checks import CheckedRecording
from companion.app.cli.main import app
from companion.core.base.errors import LeewayError

ROOT = Path(__file__).parents[3]
COAST = ROOT.parent / "shared" / "data" / "wind" / "coast_2023_1hz.csv"
HEADER = "t_s,wind_speed_mps,wind_from_deg"


def rows(count: int, seed: int = 1) -> list[list[float]]:
    """A steady wind of about 7 m/s from 250 degrees, at 1 Hz."""
    random = np.random.default_rng(seed)
    speed = 7.0 + random.normal(0.0, 0.6, count).round(2)
    from_deg = (250.0 + random.normal(0.0, 8.0, count)).round(0)
    return [[float(i), s, d] for i, (s, d) in enumerate(zip(speed, from_deg, strict=True))]


def written(folder: Path, table: list[list[object]], header: str = HEADER) -> Path:
    path = folder / "site.csv"
    lines = [header, *(",".join(str(cell) for cell in row) for row in table)]
    path.write_text("\n".join(lines) + "\n")
    return path


def used(found: CheckedRecording) -> int:
    return sum(run.t_s.size for run in found.segments)


def test_a_sound_log_is_used_whole_and_nothing_is_said(tmp_path: Path) -> None:
    found = read_wind_log(written(tmp_path, rows(300)))
    assert used(found) == 300
    assert found.findings == ()
    np.testing.assert_allclose(
        found.segments[0].wind_to_ne_mps.mean(axis=0),
        [7.0 * -math.cos(math.radians(250.0)), 7.0 * -math.sin(math.radians(250.0))],
        atol=0.3,
    )


@pytest.mark.parametrize("lasts", [60, 215])
@pytest.mark.parametrize("slow_turn", [False, True])
def test_a_station_that_flips_its_direction_is_found_and_left_out(
    tmp_path: Path, lasts: int, slow_turn: bool
) -> None:
    table = rows(900)
    for i in range(400, 400 + lasts):
        table[i][2] = (table[i][2] + 180.0) % 360.0
    if slow_turn:  # one sample half way
        table[400][2] = (table[399][2] + 90.0) % 360.0
    found = read_wind_log(written(tmp_path, table))
    assert used(found) == pytest.approx(900 - lasts, abs=2)
    (words,) = [w for w in found.findings if "half a circle" in w]
    first = int(words.split()[1])
    assert abs(first - 402) <= 1  # line 1 is the header
    kept = np.concatenate([run.from_rad for run in found.segments])
    assert np.all(np.abs(np.degrees(kept) - 250.0) < 91.0)


def test_a_flip_that_lasts_to_the_end_leaves_the_longer_part(tmp_path: Path) -> None:
    table = rows(600)
    for i in range(450, 600):
        table[i][2] = (table[i][2] + 180.0) % 360.0
    found = read_wind_log(written(tmp_path, table))
    assert used(found) == 450


def test_light_air_and_a_front_are_not_flips(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    light = [[float(i), 0.8, float(d)] for i, d in enumerate(random.integers(0, 360, 300))]
    assert used(read_wind_log(written(tmp_path, light))) == 300
    front = rows(600)
    for i in range(300, 600):  # turns by 170 degrees over a minute
        front[i][2] = (front[i][2] + 170.0 * min((i - 300) / 60.0, 1.0)) % 360.0
    found = read_wind_log(written(tmp_path, front))
    assert used(found) == 600


def test_rows_that_are_not_numbers_are_named_and_left_out(tmp_path: Path) -> None:
    table: list[list[object]] = list(rows(200))
    table[10] = [10.0, "NaN", 250.0]
    table[20] = [20.0, "", 250.0]
    table[30] = [30.0, 7.0]
    table[40] = [40.0, -1.0, 250.0]
    table[50] = [50.0, 7.0, 400.0]
    found = read_wind_log(written(tmp_path, table))
    assert used(found) == 195
    said = "\n".join(found.findings)
    assert "line 12: wind_speed_mps = 'NaN', not a number" in said
    assert "line 22: wind_speed_mps = ''" in said
    assert "line 32: 2 cells, expected 3" in said
    assert "line 42: wind_speed_mps outside 0 to 75" in said
    assert "line 52: wind_from_deg outside 0 to 360" in said


def test_a_log_that_was_cut_off_is_used_up_to_there(tmp_path: Path) -> None:
    path = written(tmp_path, rows(200))
    path.write_bytes(path.read_bytes()[:-9] + b"\x00\x00\xff")
    found = read_wind_log(path)
    assert 198 <= used(found) <= 199
    assert any("line 201" in words for words in found.findings)


def test_gaps_and_clock_jumps_divide_a_log(tmp_path: Path) -> None:
    table = rows(400)
    for i in range(100, 400):
        table[i][0] += 50.0
    for i in range(300, 400):
        table[i][0] -= 400.0
    table[200][0] = table[199][0]
    found = read_wind_log(written(tmp_path, table))
    assert [run.t_s.size for run in found.segments] == [100, 199, 100]
    said = "\n".join(found.findings)
    assert "line 102: 51 s without a sample" in said
    assert "line 302: t_s goes back from 349 to -50" in said
    assert "line 202: t_s repeats" in said


def test_a_stuck_instrument_is_left_out(tmp_path: Path) -> None:
    table = rows(400)
    for i in range(100, 200):
        table[i][1:] = [6.5, 251.0]
    found = read_wind_log(written(tmp_path, table))
    assert used(found) == 300
    assert "lines 102 to 201: the same reading for 99 s (stuck?)" in "\n".join(found.findings)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: [r[0] * 1000.0, r[1], r[2]], "milliseconds?"),
        (lambda r: [r[0], r[1] * 100.0, r[2]], "cm/s?"),
        (lambda r: [r[0], r[1], round(math.radians(r[2]), 3)], "radians?"),
    ],
)
def test_wrong_units_are_refused_in_words(tmp_path: Path, change, words: str) -> None:
    path = written(tmp_path, [change(row) for row in rows(300)])
    with pytest.raises(LeewayError, match=r"site\.csv") as refused:
        read_wind_log(path)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("t_s,wind_speed_kn,wind_from_deg", "line 1: column 'wind_speed_kn': expected only"),
        ("t_s,wind_speed_mps", "line 1: column wind_from_deg: expected once, found 0 times"),
        ("", "column t_s: expected once"),
    ],
)
def test_other_columns_are_refused_by_name(tmp_path: Path, header: str, words: str) -> None:
    with pytest.raises(LeewayError) as refused:
        read_wind_log(written(tmp_path, rows(5), header))
    assert words in str(refused.value)


# --- the command ---------------------------------------------------------------------------------


@pytest.mark.sample
def test_fit_wind_writes_a_process_that_loads(tmp_path: Path) -> None:
    random = np.random.default_rng(8)
    drift = np.cumsum(random.normal(0.0, 0.12, (2600, 2)), axis=0)
    drift -= np.linspace(0.0, 1.0, 2600)[:, None] * drift[-1]
    wind = np.array([-2.0, -7.0]) + drift + random.normal(0.0, 0.8, (2600, 2))
    table = [
        [float(i), round(math.hypot(*w), 2), round(math.degrees(math.atan2(-w[1], -w[0])) % 360)]
        for i, w in enumerate(wind)
    ]
    table[70] = [70.0, math.nan, 0.0]
    path, out = written(tmp_path, table), tmp_path / "yard.toml"
    name = 'my "yard" \\ 1'
    result = CliRunner().invoke(
        app, ["fit-wind", str(path), "--out", str(out), "--parts", "2", "--name", name]
    )
    assert result.exit_code == 0, result.output
    assert "line 72: wind_speed_mps = 'nan', not a number: left out" in result.output
    assert "memory s" in result.output
    assert "log likelihood" in result.output
    text = out.read_text()
    assert f"companion fit-wind site.csv --parts 2 --name '{name}' --out yard.toml" in text
    assert str(tmp_path) not in text
    from companion.adapters.files.params import read_wind_process

    assert read_wind_process(str(out)).name == name


def test_fit_wind_refuses_what_it_cannot_fit_with_one_line(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["fit-wind", str(written(tmp_path, rows(200)))])
    assert result.exit_code == 2
    assert "200 s of usable wind: expected 1200 or more" in result.output
    missing = CliRunner().invoke(app, ["fit-wind", str(tmp_path / "none.csv")])
    assert missing.exit_code == 2
    assert "none.csv: No such file" in missing.output


def test_the_coast_recording_has_nothing_wrong_and_a_flip_put_in_is_found(tmp_path: Path) -> None:
    if not COAST.exists():
        pytest.skip(f"{COAST} is not here")
    assert read_wind_log(COAST).findings == ()
    lines = COAST.read_text().splitlines()
    for i in range(3001, 3216):  # as long as the station's own, which was left out of the file
        t, speed, from_deg = lines[i].split(",")
        lines[i] = f"{t},{speed},{(float(from_deg) + 180.0) % 360.0:g}"
    path = tmp_path / "turned.csv"
    path.write_text("\n".join(lines))
    found = read_wind_log(path)
    assert used(found) == pytest.approx(len(lines) - 1 - 215, abs=2)
    (words,) = found.findings[:1]
    assert words.startswith("lines 3002 to 3216: direction turned by half a circle")


def site_folder(folder: Path, gust_mps: float, seed: int) -> Path:
    """A site's folder with 40 minutes of wind in gusts of a minute, in two recordings."""
    random = np.random.default_rng(seed)
    folder.mkdir()
    gusts = lfilter([1.0], [1.0, -math.exp(-1.0 / 60.0)], random.standard_normal((2400, 2)), axis=0)
    wind = np.array([0.0, -8.0]) + gust_mps * gusts / gusts.std()
    for k in (0, 1):
        table = [
            [i, f"{math.hypot(*w):.2f}", f"{math.degrees(math.atan2(-w[1], -w[0])) % 360.0:.1f}"]
            for i, w in enumerate(wind[1200 * k : 1200 * (k + 1)])
        ]
        written(folder, table).rename(folder / f"part{k}.CSV")
    return folder


def test_folders_are_sites_whose_differences_enter_the_evidence(tmp_path: Path) -> None:
    calm, gusty = (site_folder(tmp_path / n, g, 4) for n, g in (("calm", 0.6), ("gusty", 1.2)))
    (calm / "notes.txt").write_text("mast of 10 m")
    out = tmp_path / "two.toml"
    arguments = ["fit-wind", str(calm), str(gusty), "--parts", "2", "--out", str(out)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert f"{calm}: 1 entries that are not *.csv: not read" in result.output
    assert f"{gusty}: 0.7 h of wind" in result.output
    assert "2 sites: 1.3 h of wind" in result.output
    assert "# Held out (2 folds of whole sites)" in out.read_text()
    from companion.adapters.files.params import read_wind_process

    process = read_wind_process(str(out))
    assert process.recorded_s == 4800.0
    assert process.independent_returns is not None
    assert process.independent_returns < 1.0  # two sites that differ four times in variance
    middle = math.sqrt(sum(process.variance_m2ps2))
    assert 0.6 < middle < 1.2


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({}, "site: no *.csv among 0 entries: expected recordings of one site"),
        ({"notes.txt": "mast"}, "site: no *.csv among 1 entries"),
        ({"a.csv": "t_s,wind_speed_kn,wind_from_deg\n"}, "a.csv: line 1: column 'wind_speed_kn'"),
    ],
)
def test_a_folder_without_a_usable_recording_is_refused(
    tmp_path: Path, entries: dict[str, str], words: str
) -> None:
    (tmp_path / "site").mkdir()
    for name, text in entries.items():
        (tmp_path / "site" / name).write_text(text)
    result = CliRunner().invoke(app, ["fit-wind", str(tmp_path / "site")])
    assert result.exit_code == 2
    assert words in result.output.replace("\n", "")


def test_a_recording_counts_once(tmp_path: Path) -> None:
    path = written(tmp_path, rows(200))
    result = CliRunner().invoke(app, ["fit-wind", str(tmp_path), str(path)])
    assert result.exit_code == 2
    assert "site.csv: given twice" in result.output.replace("\n", "")
