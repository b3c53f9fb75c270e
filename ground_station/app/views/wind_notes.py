"""Wind measured by the fleet as lines of text: the current field, and approaching fronts."""

from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_texts import format_front, format_site_wind

FRONT_DISPLAY_S = 300.0
"""Time for which a front is shown after its detection."""


def recent_front_texts(wind: SiteWind, status: FleetStatus, now_s: float) -> tuple[str, ...]:
    """Return fronts of the last minutes, with the members that they have not reached."""
    positions = [
        (name, wind.position_ne_m(state.lat_deg, state.lon_deg))
        for name, seen in sorted(status.vehicles.items())
        if (state := seen.state) is not None
        and state.lat_deg is not None
        and state.lon_deg is not None
    ]
    fronts = (
        one
        for one in wind.drop_expired_and_get_fronts(now_s)
        if now_s - one.detected_s <= FRONT_DISPLAY_S
    )
    return tuple(format_front(one, now_s, positions) for one in fronts)


def wind_field_and_front_lines(wind: SiteWind, status: FleetStatus, now_s: float) -> list[str]:
    """Return the field in one line, if a member reports it, and fronts."""
    field_text = format_site_wind(wind, now_s)
    front_lines = [f"WARNING: {words}" for words in recent_front_texts(wind, status, now_s)]
    return ([field_text] if field_text else []) + front_lines
