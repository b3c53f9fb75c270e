"""What `watch` and the map say of the wind."""

import msgspec

from ground_station.adapters.files.day_wind import site_wind_of
from ground_station.app.views.wind_notes import FRONT_SHOWN_S, wind_notes
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.site_wind.wind_words import field_words
from tests.ground_station.site_wind.told_air import PLACES, Air, a_state, front_comes


def test_nobody_who_tells_it_is_nothing_said():
    assert wind_notes(site_wind_of(None), FleetStatus(), 0.0) == []


def test_it_is_said_without_a_day_and_a_front_with_those_to_whom_it_comes():
    """As `watch` hears it: it knows no depot."""
    air, status = Air(seed=2), FleetStatus()
    air.wind = site_wind_of(None)
    air.blow(180.0)
    (field,) = wind_notes(air.wind, status, air.t_s)
    assert field == field_words(air.wind, air.t_s)
    for name in PLACES:
        told = msgspec.structs.replace(a_state(name, air.t_s, (0.0, 6.0)))
        status.on_state(told, air.t_s, 0)
    front_comes(air, (0.0, 9.0), 11.0, 12.0)
    _, front = wind_notes(air.wind, status, air.t_s)
    assert front.startswith("LOOK: FRONT: the wind changes by ")
    assert "felt by d1; " in front
    assert "d2 in " in front
    assert "d1 in" not in front, "it is there already"
    air.t_s += FRONT_SHOWN_S
    assert not [words for words in wind_notes(air.wind, status, air.t_s) if "FRONT" in words]
