"""The track of a recorded flight."""

from collections.abc import Iterable

from companion.core.base.errors import LeewayError
from companion.core.exports.exported import GeoPoint, TrackExport, TrackPoint
from companion.core.mission.events import Event, GnssTime, Position


def build_track_export(
    events: Iterable[Event], name: str, *, min_interval_s: float, utc_at_zero_s: float | None = None
) -> TrackExport:
    """Return positions with a minimum interval of `min_interval_s`.

    `utc_at_zero_s`: seconds since 1970 at zero of the log's clock; by default from the first
    satellite time in the log, if there is one. LeewayError: the log has no position.
    """
    positions: list[Position] = []
    for event in events:
        if isinstance(event, GnssTime) and utc_at_zero_s is None:
            utc_at_zero_s = event.unix_s - event.t_s
        if isinstance(event, Position) and (
            not positions or event.t_s - positions[-1].t_s >= min_interval_s
        ):
            positions.append(event)
    if not positions:
        raise LeewayError(f"{name}: no position in this log, expected a recorded track")
    return TrackExport(name, tuple(_track_point(p, utc_at_zero_s) for p in positions))


def _track_point(position: Position, utc_at_zero_s: float | None) -> TrackPoint:
    utc_s = None if utc_at_zero_s is None else utc_at_zero_s + position.t_s
    return TrackPoint(GeoPoint(position.lat_deg, position.lon_deg, position.alt_amsl_m), utc_s)
