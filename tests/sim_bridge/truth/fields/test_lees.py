"""Wind among obstacles: lee, corners, roof, and the unaffected area."""

import math
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.field_file import load_wind_field
from sim_bridge.truth.fields.lees import Obstacle, wind_speed_ratio
from sim_bridge.truth.fields.site_wind import SiteWind

BOX = Obstacle(north_m=100.0, east_m=-50.0, half_north_m=20.0, half_east_m=10.0, height_m=40.0)
"""Wider across a wind from the west than across one from the south."""


def share(
    north_m: float, east_m: float, height_m: float = 30.0, from_deg: float = 270.0, *more: Obstacle
) -> float:
    to = math.radians(from_deg + 180.0)
    heading = 7.0 * np.array([math.cos(to), math.sin(to)])
    place = (np.array([x]) for x in (north_m, east_m, height_m))
    return float(wind_speed_ratio(*place, heading, (BOX, *more))[0])


@pytest.mark.parametrize(
    ("north_m", "east_m", "height_m", "from_deg", "expected"),
    [
        (100.0, -39.9999, 30.0, 270.0, 0.4),  # right behind it: 60 % less
        (100.0, 160.0, 30.0, 270.0, 1.0 - 0.6 / math.e),  # five heights further on
        (100.0, -61.0, 30.0, 270.0, 1.0),  # upstream
        (129.0, -50.0, 30.0, 270.0, 1.25),  # past its corner
        (141.0, -50.0, 30.0, 270.0, 1.0),  # well outside it
        (100.0, -50.0, 60.0, 270.0, 1.15),  # over its roof
        (100.0, -39.0, 60.0, 270.0, 1.0),  # above its wake
        (100.0, -50.0, 81.0, 270.0, 1.0),  # far above it
        (79.9999, -50.0, 30.0, 0.0, 0.4),  # the same from the north: behind is south
        (100.0, -65.0, 30.0, 0.0, 1.25),  # and it is narrower: 15 m out is its corner
        (120.9, -30.0, 30.0, 270.0, 1.0 - 0.6 * math.exp(-0.05)),  # its wake widens by a tenth
    ],
)
def test_the_wind_about_a_box(
    north_m: float, east_m: float, height_m: float, from_deg: float, expected: float
) -> None:
    assert math.isclose(share(north_m, east_m, height_m, from_deg), expected, rel_tol=1e-4)


def test_wakes_add_up_to_a_fifth_of_the_wind_at_the_least() -> None:
    ahead = [
        Obstacle(north_m=100.0, east_m=-250.0 + 40.0 * k, half_north_m=20.0, half_east_m=10.0,
                 height_m=40.0)
        for k in range(4)
    ]  # fmt: skip
    one, two, five = (
        share(100.0, -39.0),
        share(100.0, -39.0, 30.0, 270.0, ahead[0]),
        share(100.0, -39.0, 30.0, 270.0, *ahead),
    )
    assert five == 0.2 < two < one


def test_turned_by_a_quarter_with_the_wind_nothing_changes() -> None:
    rng = np.random.default_rng(1)
    north, east = rng.uniform(-150.0, 150.0, (2, 500))
    turned = Obstacle(
        north_m=-BOX.east_m, east_m=BOX.north_m, half_north_m=BOX.half_east_m,
        half_east_m=BOX.half_north_m, height_m=BOX.height_m,
    )  # fmt: skip
    height = np.full(500, 30.0)
    to = np.array([math.cos(0.7), math.sin(0.7)])
    before = wind_speed_ratio(north, east, height, to, [BOX])
    after = wind_speed_ratio(-east, north, height, np.array([-to[1], to[0]]), [turned])
    assert np.allclose(before, after)
    assert 0.01 < (before < 1.0).mean() < 0.9


class Steady:
    def to_ne_mps(self, t_s: np.ndarray, north_m: np.ndarray, east_m: np.ndarray) -> np.ndarray:
        return np.stack([np.where(t_s < 10.0, 0.0, 6.0), np.zeros_like(t_s)], axis=-1)


def test_all_who_fly_over_a_site_meet_its_lees_and_no_wind_stays_none() -> None:
    wind = SiteWind(Steady(), obstacles=[BOX])
    behind, free = (121.0, -50.0), (121.0, 50.0)
    assert wind.to_ne_mps(5.0, *behind, 30.0).tolist() == [[0.0, 0.0]]
    slow, full = wind.to_ne_mps(20.0, *behind, 30.0)[0], wind.to_ne_mps(20.0, *free, 30.0)[0]
    assert full.tolist() == [6.0, 0.0]
    assert math.isclose(slow[0], 6.0 * (1.0 - 0.6 * math.exp(-1.0 / 200.0)))
    assert slow[1] == 0.0


def test_a_file_says_what_stands_in_the_wind(tmp_path: Path) -> None:
    from companion.adapters.files.params import params_dir

    folder = params_dir() / "fields"
    assert load_wind_field(folder / "front.toml").obstacles == ()
    shipped = load_wind_field(folder / "lees.toml")
    assert len(shipped.obstacles) == 13
    text = (folder / "lees.toml").read_text()
    torn = tmp_path / "torn.toml"
    torn.write_text(text.replace("height_m = 36.0", "height_m = nan", 1))
    with pytest.raises(TruthError, match=r"torn\.toml.*height_m = nan: expected a number"):
        load_wind_field(torn)
    torn.write_text(text.replace("half_east_m = 30.0", "half_east = 30.0", 1))
    with pytest.raises(TruthError, match=r"half_east\b"):
        load_wind_field(torn)
