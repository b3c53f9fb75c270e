"""The shipped airframes load, every number has a source, and mistakes are named."""

import re
from pathlib import Path

import pytest

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.params import load_airframe

SHIPPED = sorted((Path(__file__).parents[3] / "params" / "truth").glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_airframe_loads_under_its_own_name(path: Path) -> None:
    assert load_airframe(path).name == path.stem


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_number_says_where_it_comes_from(path: Path) -> None:
    for line in path.read_text().splitlines():
        if re.match(r"\w+ = [-\d]", line):
            assert re.search(r"# (source|assumed): \w.{8,}", line), line


def _spoilt(tmp_path: Path, old: str, new: str) -> Path:
    text = SHIPPED[0].read_text()
    assert old in text
    path = tmp_path / "spoilt.toml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("radius_m = 0.1651", "radius_m = -0.1651", "rotors.radius_m"),
        ("radius_m = 0.1651", "radius_m = nan", "rotors.radius_m"),
        ("radius_m = 0.1651", "radius_mm = 165.1", "radius_mm"),
        ("radius_m = 0.1651", "", "radius_m"),
        ("cells = 6 ", 'cells = "six" ', "battery.cells"),
        ('format = "truth/1"', 'format = "truth/2"', "truth/2"),
        ("mass_kg = 0.676", "mass_kg = 150.0", "battery.mass_kg"),
        ("[ground]", "[ground", "spoilt.toml"),
    ],
)
def test_a_mistake_in_a_file_is_refused_by_name(
    tmp_path: Path, old: str, new: str, named: str
) -> None:
    with pytest.raises(TruthError, match=re.escape(named)):
        load_airframe(_spoilt(tmp_path, old, new))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TruthError, match=r"nothing\.toml"):
        load_airframe(tmp_path / "nothing.toml")
