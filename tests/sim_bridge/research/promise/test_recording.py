"""Recordings at whole seconds, with the samples that pass the companion's checks.

The checks themselves are tested in tests/companion/wind_fit.
"""

import math
from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.research.promise.recording import read_recording

HEAD = "t_s,wind_speed_mps,wind_from_deg"


def written(tmp_path: Path, rows: list[str], head: str = HEAD) -> Path:
    path = tmp_path / "site.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def steady(first: int, last: int) -> list[str]:
    """Return readings with a varying last digit: a constant minute counts as a frozen vane."""
    return [f"{t},8.0,{90.0 + 1e-9 * ((t + 1) % 2):.9f}" for t in range(first, last)]


def test_wind_from_the_east_moves_west(tmp_path: Path) -> None:
    found = read_recording(written(tmp_path, steady(0, 300)))
    assert found.stretches[0].wind_ne_mps.shape == (300, 2)
    assert found.stretches[0].wind_ne_mps[7] == pytest.approx([0.0, -8.0], abs=1e-12)
    assert found.faults == ()


def test_five_samples_a_second_are_read_at_whole_seconds(tmp_path: Path) -> None:
    rows = [f"{k / 5},{4.0 + k / 5 / 100:.4f},0" for k in range(1001)]
    (stretch,) = read_recording(written(tmp_path, rows)).stretches
    assert stretch.seconds == 200
    assert stretch.wind_ne_mps[50, 0] == pytest.approx(-4.5)


def test_direction_is_averaged_as_a_vector_over_north(tmp_path: Path) -> None:
    rows = [f"{2 * t},8,{350 if t % 2 else 10}" for t in range(100)]
    (stretch,) = read_recording(written(tmp_path, rows)).stretches
    # Between 10 and 350 degrees lies north, not south.
    assert stretch.wind_ne_mps[1] == pytest.approx([-8.0 * math.cos(math.radians(10.0)), 0.0])


CUT = [*steady(0, 300), "300,8."]
GAP = [*steady(0, 300), *steady(500, 700)]
JUMP = [*steady(0, 300), *steady(100, 300)]
NAN = [*steady(0, 100), "100,nan,90", *steady(101, 300)]


@pytest.mark.parametrize(
    ("rows", "stretches", "words"),
    [
        (CUT, [(0.0, 299)], "line 302"),
        (GAP, [(0.0, 299), (500.0, 199)], "line 302: 201 s without a sample"),
        (JUMP, [(0.0, 299), (100.0, 199)], "line 302: t_s goes back from 299 to 100"),
        (NAN, [(0.0, 299)], "line 102: wind_speed_mps = 'nan'"),
    ],
    ids=["cut off", "gap", "clock jumps back", "no number"],
)
def test_what_is_wrong_is_named_with_its_file_and_ends_a_stretch_or_is_bridged(
    tmp_path: Path, rows: list[str], stretches: list[tuple[float, int]], words: str
) -> None:
    found = read_recording(written(tmp_path, rows))
    assert [(s.start_s, s.seconds) for s in found.stretches] == stretches
    assert found.faults[0].startswith(f"{tmp_path / 'site.csv'}: ")
    assert words in found.faults[0]


@pytest.mark.parametrize(
    ("head", "rows", "words"),
    [
        ("t_s,u_mps,v_mps", ["0,1,2"], "column 'u_mps'"),
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
