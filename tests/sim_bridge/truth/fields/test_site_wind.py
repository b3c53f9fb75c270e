"""Fronts, and the wind of a site that several vehicles meet."""

import math

import numpy as np
import pytest

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.front import LinearFront, draw_front
from sim_bridge.truth.fields.site_wind import SiteWind

FRONT = LinearFront(600.0, 90.0, 10.0, (0.0, 7.0), 40.0)


class Steady:
    """A wind of 5 m/s to the north everywhere."""

    def to_ne_mps(self, t_s: np.ndarray, north_m: np.ndarray, east_m: np.ndarray) -> np.ndarray:
        return np.tile([5.0, 0.0], (t_s.size, 1))


def test_a_front_comes_when_and_where_it_should() -> None:
    wind = SiteWind(Steady(), [FRONT])
    for east_m, t_s, jump in (
        (0.0, 599.0, 0.0),
        (0.0, 620.0, 3.5),
        (0.0, 641.0, 7.0),
        (500.0, 649.0, 0.0),
        (500.0, 670.0, 3.5),
        (-500.0, 570.0, 3.5),
    ):
        found = wind.to_ne_mps(t_s, 123.0, east_m, 40.0)[0]
        assert found == pytest.approx([5.0, jump], abs=1e-9)
    reached = FRONT.arrival_time_s(np.array([99.0]), np.array([500.0]))
    assert reached[0] == pytest.approx(650.0)


def test_a_gust_front_can_end() -> None:
    ends = LinearFront(0.0, 0.0, 10.0, (6.0, 0.0), 20.0, lasts_s=300.0)
    share = [float(ends.added_wind_to_ne_mps(np.array([t]), np.zeros(1), np.zeros(1))[0,
    0]) for t in
             (100.0, 450.0, 700.0)]  # fmt: skip
    assert share == pytest.approx([6.0, 3.0, 0.0])


def test_vehicles_at_one_place_meet_one_wind_that_grows_with_height() -> None:
    wind = SiteWind(Steady(), [FRONT], profile_exponent=1.0 / 7.0, reference_height_m=40.0)
    both = wind.to_ne_mps([700.0, 700.0], [10.0, 10.0], [20.0, 20.0], [40.0, 40.0])
    assert np.array_equal(both[0], both[1])
    high = wind.to_ne_mps(700.0, 10.0, 20.0, 120.0)[0]
    assert high == pytest.approx(both[0] * 3.0 ** (1.0 / 7.0))


def test_drawn_fronts_move_as_density_currents() -> None:
    rng = np.random.default_rng(1)
    mean = np.array([-8.0, 1.0])
    for _ in range(100):
        front = draw_front(0.0, mean, 5.0, 10.0, rng)
        assert 5.0 <= math.hypot(*front.jump_ne_mps) <= 10.0
        angle = math.radians(front.direction_deg)
        normal = np.array([math.cos(angle), math.sin(angle)])
        behind = float((mean + front.jump_ne_mps) @ normal)
        assert front.speed_mps == pytest.approx(max(front.speed_mps / behind, 0.6) * behind)
        assert 2.0 <= front.speed_mps <= 0.9 * behind + 1e-9 or front.speed_mps == 2.0


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("speed_mps", 0.1, "speed_mps"),
        ("transition_s", 0.0, "passing_s"),
        ("lasts_s", 1.0, "lasts_s"),
    ],
)
def test_a_front_that_is_none_is_refused(key: str, value: float, words: str) -> None:
    numbers = {"speed_mps": 10.0, "transition_s": 40.0, "lasts_s": None} | {key: value}
    with pytest.raises(TruthError, match=words):
        LinearFront(0.0, 0.0, jump_ne_mps=(5.0, 0.0), **numbers)
