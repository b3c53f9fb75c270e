"""What may be exported, in each format."""

import json

from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import MissionExport, TrackExport
from companion.core.exports.geojson import mission_geojson, track_geojson
from companion.core.exports.gpx import mission_gpx, track_gpx
from companion.core.exports.kml import mission_kml, track_kml
from companion.core.exports.qgc_plan import mission_plan
from companion.core.exports.wpl import fence_document, rally_document, wpl_document


def mission_text(mission: MissionExport, file_format: ExportFormat, autopilot: str) -> str:
    """A mission as a document; `autopilot` ("px4", "ardupilot") is the one that a .plan is for."""
    match file_format:
        case ExportFormat.PLAN:
            return _json(mission_plan(mission, autopilot))
        case ExportFormat.WPL:
            return wpl_document(mission)
        case ExportFormat.KML:
            return mission_kml(mission)
        case ExportFormat.GPX:
            return mission_gpx(mission)
        case ExportFormat.GEOJSON:
            return _json(mission_geojson(mission))


def texts_beside(mission: MissionExport, file_format: ExportFormat) -> dict[str, str]:
    """Documents that belong beside a mission's, by their files' endings: of formats that hold
    neither fence nor rally points.
    """
    if file_format is not ExportFormat.WPL:
        return {}
    found = {
        ".fence.waypoints": fence_document(mission),
        ".rally.waypoints": rally_document(mission),
    }
    return {ending: text for ending, text in found.items() if text is not None}


def track_text(track: TrackExport, file_format: ExportFormat) -> str:
    """A flown track as a document; LeewayError for a format that holds missions only."""
    match file_format:
        case ExportFormat.KML:
            return track_kml(track)
        case ExportFormat.GPX:
            return track_gpx(track)
        case ExportFormat.GEOJSON:
            return _json(track_geojson(track))
    raise LeewayError(
        f"{file_format.value} holds a mission, not a track: expected kml, gpx or geojson for a log"
        " (a run folder's mission.plan is the mission that was aboard)"
    )


def _json(document: dict[str, object]) -> str:
    return json.dumps(document, indent=1, allow_nan=False) + "\n"
