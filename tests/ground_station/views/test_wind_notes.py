"""Wind notes of `watch` and the map."""

import msgspec

from ground_station.adapters.files.day_wind import create_site_wind
from ground_station.app.views.wind_notes import FRONT_DISPLAY_S, wind_field_and_front_lines
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.site_wind.wind_texts import format_site_wind
from tests.ground_station.site_wind.told_air import PLACES, Air, a_state, front_comes


def test_nobody_who_tells_it_is_nothing_said():
    assert wind_field_and_front_lines(create_site_wind(None), FleetStatus(), 0.0) == []


def test_it_is_said_without_a_day_and_a_front_with_those_to_whom_it_comes():
    """As in `watch`, without a known depot."""
    air, status = Air(seed=2), FleetStatus()
    air.wind = create_site_wind(None)
    air.blow(180.0)
    (field,) = wind_field_and_front_lines(air.wind, status, air.t_s)
    assert field == format_site_wind(air.wind, air.t_s)
    for name in PLACES:
        told = msgspec.structs.replace(a_state(name, air.t_s, (0.0, 6.0)))
        status.record_state_and_new_doubts(told, air.t_s, 0)
    front_comes(air, (0.0, 9.0), 11.0, 12.0)
    _, front = wind_field_and_front_lines(air.wind, status, air.t_s)
    assert front.startswith("WARNING: FRONT: the wind changes by ")
    assert "detected by d1; " in front
    assert "d2 in " in front
    assert "d1 in" not in front, "it is there already"
    air.t_s += FRONT_DISPLAY_S
    assert not [
        words for words in wind_field_and_front_lines(air.wind, status, air.t_s) if "FRONT" in words
    ]
