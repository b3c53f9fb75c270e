"""A desk over ground that slows the wind: its front detection receives the ground share."""

import math

import pytest

from companion.core.wind_field.fronts import FrontMonitor
from ground_station.adapters.files.params import read_wind_process
from ground_station.core.site_wind.site_wind import SiteWind
from tests.companion.wind_field.test_terrain_effect import ground_share, open_ground, tellings
from tests.ground_station.site_wind.told_air import DEPOT, M_PER_DEG, a_state


@pytest.mark.sample
@pytest.mark.parametrize(
    ("ground", "least", "most"), [(ground_share, 0.01, 0.2), (open_ground, 0, 0)]
)
def test_the_watch_knows_as_much_of_the_ground_as_drones_have_seen(
    ground, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[float] = []
    as_it_is = FrontMonitor.set_terrain_share

    def noted(self: FrontMonitor, standing_share: float) -> None:
        heard.append(standing_share)
        as_it_is(self, standing_share)

    monkeypatch.setattr(FrontMonitor, "set_terrain_share", noted)
    desk = SiteWind(read_wind_process("coast"), DEPOT)
    for t_s, told in tellings(ground):
        for one in told:
            north_m, east_m = one.position_ne_m
            lat_deg = DEPOT[0] + north_m / M_PER_DEG
            lon_deg = DEPOT[1] + east_m / M_PER_DEG / math.cos(math.radians(DEPOT[0]))
            here = {"vehicle": one.member, "lat_deg": lat_deg, "lon_deg": lon_deg}
            north, east = (round(x, 3) for x in one.mean_to_ne_mps)
            desk.update_from_state(a_state("d1", t_s, (north, east), **here), t_s)
    assert heard[0] == 0.0, "nobody has seen anything yet"
    assert least <= heard[-1] <= most
