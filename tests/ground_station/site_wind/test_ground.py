"""A desk over ground that slows the wind: its watch for fronts is told of it."""

import math

import numpy as np
import pytest

from companion.core.wind_field.fronts import FrontWatch
from ground_station.adapters.files.params import read_wind_process
from ground_station.core.site_wind.site_wind import SiteWind
from tests.companion.wind_field.test_standing import ground_share, open_ground, to_and_fro
from tests.ground_station.site_wind.told_air import DEPOT, M_PER_DEG, a_state

MEMBERS, END_S, WIND = 6, 900, np.array([-8.0, 1.0])


@pytest.mark.parametrize(
    ("ground", "least", "most"), [(ground_share, 0.01, 0.2), (open_ground, 0, 0)]
)
def test_the_watch_knows_as_much_of_the_ground_as_drones_have_seen(
    ground, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[float] = []
    as_it_is = FrontWatch.expect_ground

    def noted(self: FrontWatch, standing_share: float) -> None:
        heard.append(standing_share)
        as_it_is(self, standing_share)

    monkeypatch.setattr(FrontWatch, "expect_ground", noted)
    rng, eddy = np.random.default_rng(2), np.zeros(2)
    desk = SiteWind(read_wind_process("coast"), DEPOT)
    for t_s in range(10, END_S, 10):
        eddy = 0.95 * eddy + 0.3 * rng.standard_normal(2)
        for index in range(MEMBERS):
            place = to_and_fro(index, t_s - 5.0)
            north, east = ground(place) * (WIND + eddy) + 0.4 * rng.standard_normal(2)
            state = a_state(
                "d1",
                float(t_s),
                (round(float(north), 3), round(float(east), 3)),
                lat_deg=DEPOT[0] + place[0] / M_PER_DEG,
                lon_deg=DEPOT[1] + place[1] / M_PER_DEG / math.cos(math.radians(DEPOT[0])),
                vehicle=f"v{index}",
            )
            desk.on_state(state, float(t_s))
    assert heard[0] == 0.0, "nobody has seen anything yet"
    assert least <= heard[-1] <= most
