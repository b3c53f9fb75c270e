"""Accepted wind of the site with its uncertainty, for the map."""

from ground_station.app.map.picture import WindShown
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_texts import format_site_wind


def wind_field_shown(wind: SiteWind, now_s: float) -> WindShown | None:
    """Return the wind at the centre of the members that report it; None: no member does."""
    estimate = wind.wind_at_report_centroid(now_s)
    if estimate is None:
        return None
    return WindShown(
        to_ne_mps=estimate.to_ne_mps,
        cov_m2ps2=estimate.cov_m2ps2,
        source=format_site_wind(wind, now_s),
    )
