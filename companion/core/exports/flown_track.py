"""The track of a recorded flight."""

from collections.abc import Iterable

from companion.core.base.errors import LeewayError
from companion.core.exports.exported import GeoPoint, TrackExport, TrackPoint
from companion.core.mission.events import Event, GnssTime, Position


def track_export(
    events: Iterable[Event], name: str, *, every_s: float, utc_at_zero_s: float | None = None
) -> TrackExport:
    """Positions at least `every_s` apart.

    `utc_at_zero_s`: seconds since 1970 at zero of the log's clock; without it the first satellite
    time in the log tells, if there is one. LeewayError: the log has no position.
    """
    positions: list[Position] = []
    for event in events:
        if isinstance(event, GnssTime) and utc_at_zero_s is None:
            utc_at_zero_s = event.unix_s - event.t_s
        if isinstance(event, Position) and (
            not positions or event.t_s - positions[-1].t_s >= every_s
        ):
            positions.append(event)
    if not positions:
        raise LeewayError(f"{name}: no position in this log, so there is no track")
    return TrackExport(name, tuple(_track_point(p, utc_at_zero_s) for p in positions))


def _track_point(position: Position, utc_at_zero_s: float | None) -> TrackPoint:
    utc_s = None if utc_at_zero_s is None else utc_at_zero_s + position.t_s
    return TrackPoint(GeoPoint(position.lat_deg, position.lon_deg, position.alt_amsl_m), utc_s)
