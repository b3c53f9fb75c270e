"""Recordings with everything wrong that stations do: named by row, used as far as they go."""

import math
from pathlib import Path

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.research.promise.recording import read_recording

HEAD = "t_s,wind_speed_mps,wind_from_deg"


def written(tmp_path: Path, rows: list[str], head: str = HEAD) -> Path:
    path = tmp_path / "site.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def steady(first: int, last: int, speed: float = 8.0, from_deg: float = 90.0) -> list[str]:
    """A last digit that moves: the very same reading for a minute is a vane that froze."""
    return [f"{t},{speed},{from_deg + 1e-9 * ((t + 1) % 2):.9f}" for t in range(first, last)]


def test_wind_from_the_east_moves_west(tmp_path: Path) -> None:
    (stretch,) = read_recording(written(tmp_path, steady(0, 300))).stretches
    assert stretch.wind_ne_mps.shape == (300, 2)
    assert stretch.wind_ne_mps[7] == pytest.approx([0.0, -8.0], abs=1e-12)


def test_five_samples_a_second_are_read_at_whole_seconds(tmp_path: Path) -> None:
    rows = [f"{k / 5},{4.0 + k / 5 / 100:.4f},0" for k in range(1001)]
    (stretch,) = read_recording(written(tmp_path, rows)).stretches
    assert stretch.seconds == 200
    assert stretch.wind_ne_mps[50, 0] == pytest.approx(-4.5)


def test_a_recording_that_is_whole_has_nothing_said_of_it(tmp_path: Path) -> None:
    assert read_recording(written(tmp_path, steady(0, 300))).troubles == ()


def test_a_file_cut_off_in_a_row_is_used_up_to_it(tmp_path: Path) -> None:
    found = read_recording(written(tmp_path, [*steady(0, 300), "300,8."]))
    assert found.stretches[0].seconds == 299
    assert "line 302" in found.troubles[0]


def test_what_is_no_number_is_named_and_bridged(tmp_path: Path) -> None:
    rows = steady(0, 300)
    rows[100] = "100,nan,90"
    rows[200] = "200,8,east"
    found = read_recording(written(tmp_path, rows))
    assert [s.seconds for s in found.stretches] == [299]
    assert found.troubles[0].startswith(f"{tmp_path / 'site.csv'}: line 102: ")
    assert "line 102: wind_speed_mps = 'nan'" in found.troubles[0]
    assert "line 202: wind_from_deg = 'east'" in found.troubles[1]


def test_many_bad_rows_are_counted_not_listed(tmp_path: Path) -> None:
    rows = [row if k % 3 else f"{k},,90" for k, row in enumerate(steady(0, 300))]
    troubles = read_recording(written(tmp_path, rows)).troubles
    assert len(troubles) == 6
    assert "95 more rows" in troubles[-1]


def test_a_gap_ends_a_stretch(tmp_path: Path) -> None:
    found = read_recording(written(tmp_path, [*steady(0, 300), *steady(500, 700)]))
    assert [(s.start_s, s.seconds) for s in found.stretches] == [(0.0, 299), (500.0, 199)]
    assert "line 302: 201 s without a sample" in found.troubles[0]


def test_a_clock_that_jumps_back_begins_a_new_stretch(tmp_path: Path) -> None:
    found = read_recording(written(tmp_path, [*steady(0, 300), *steady(100, 300)]))
    assert [s.seconds for s in found.stretches] == [299, 199]
    assert "line 302: t_s goes back from 299 to 100" in found.troubles[0]


def test_a_station_that_turns_round_for_minutes_is_left_out_while_it_does(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)

    def blown(first: int, last: int, from_deg: float) -> list[str]:
        angles = (from_deg + 15.0 * rng.standard_normal(last - first)) % 360.0
        return [f"{t},8,{a:.1f}" for t, a in zip(range(first, last), angles, strict=True)]

    rows = [*blown(0, 400, 80.0), *blown(400, 600, 260.0), *blown(600, 1000, 80.0)]
    found = read_recording(written(tmp_path, rows))
    assert [(s.start_s, s.seconds) for s in found.stretches] == [(0.0, 399), (600.0, 399)]
    assert "lines 402 to 601" in found.troubles[0]
    assert "for 199 s" in found.troubles[0]


def test_a_wind_that_veers_by_itself_is_kept(tmp_path: Path) -> None:
    rows = [f"{t},8,{(80.0 + t) % 360.0}" for t in range(400)]
    found = read_recording(written(tmp_path, rows))
    assert found.troubles == ()
    assert found.stretches[0].seconds == 399


@pytest.mark.parametrize(
    ("head", "rows", "words"),
    [
        ("t_s,u_mps,v_mps", ["0,1,2"], "column 'u_mps'"),
        ("t_s,wind_speed_mps", ["0,1"], "column wind_from_deg"),
        (HEAD, steady(0, 40), "no stretch of 120 s"),
        (HEAD, ["0,99,90"] * 3, "expected m/s (km/h?"),
        (HEAD, [], "0 rows of numbers"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path, head, rows, words) -> None:
    with pytest.raises(LeewayError) as refused:
        read_recording(written(tmp_path, rows, head))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LeewayError, match=r"nowhere\.csv: No such file"):
        read_recording(tmp_path / "nowhere.csv")


def test_direction_is_averaged_as_a_vector_over_north(tmp_path: Path) -> None:
    rows = [f"{2 * t},8,{350 if t % 2 else 10}" for t in range(100)]
    (stretch,) = read_recording(written(tmp_path, rows)).stretches
    # Between 10 and 350 degrees lies north, not south.
    assert stretch.wind_ne_mps[1] == pytest.approx([-8.0 * math.cos(math.radians(10.0)), 0.0])
