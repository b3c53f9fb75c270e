"""The wind that the fleet tells, in lines for people: what the field is, and fronts that come."""

from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_words import field_words, front_words

FRONT_SHOWN_S = 300.0
"""A front wants a person's eye so long."""


def front_notes(wind: SiteWind, status: FleetStatus, now_s: float) -> tuple[str, ...]:
    """Fronts of the last minutes, and whom they have not reached."""
    places = [
        (name, wind.place_ne_m(state.lat_deg, state.lon_deg))
        for name, seen in sorted(status.vehicles.items())
        if (state := seen.state) is not None
        and state.lat_deg is not None
        and state.lon_deg is not None
    ]
    fronts = (one for one in wind.fronts_now(now_s) if now_s - one.noticed_s <= FRONT_SHOWN_S)
    return tuple(front_words(one, now_s, places) for one in fronts)


def wind_notes(wind: SiteWind, status: FleetStatus, now_s: float) -> list[str]:
    """The field in a line, where somebody tells it, and fronts."""
    field = field_words(wind, now_s)
    looks = [f"LOOK: {words}" for words in front_notes(wind, status, now_s)]
    return ([field] if field else []) + looks
