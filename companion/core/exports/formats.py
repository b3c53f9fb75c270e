"""Exports of missions and tracks in each format."""

import json

from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import MissionExport, TrackExport
from companion.core.exports.geojson import mission_geojson, track_geojson
from companion.core.exports.gpx import mission_gpx, track_gpx
from companion.core.exports.kml import mission_kml, track_kml
from companion.core.exports.qgc_plan import mission_plan_document
from companion.core.exports.wpl import fence_document, rally_document, wpl_document


def mission_document_text(mission: MissionExport, file_format: ExportFormat, autopilot: str) -> str:
    """Return a mission as a document; `autopilot` ("px4", "ardupilot") is the target of a .plan."""
    match file_format:
        case ExportFormat.PLAN:
            return _to_json_text(mission_plan_document(mission, autopilot))
        case ExportFormat.WPL:
            return wpl_document(mission)
        case ExportFormat.KML:
            return mission_kml(mission)
        case ExportFormat.GPX:
            return mission_gpx(mission)
        case ExportFormat.GEOJSON:
            return _to_json_text(mission_geojson(mission))


def auxiliary_document_by_suffix(
    mission: MissionExport, file_format: ExportFormat
) -> dict[str, str]:
    """Return additional documents by file extension, for formats without fence and rally points."""
    if file_format is not ExportFormat.WPL:
        return {}
    found = {
        ".fence.waypoints": fence_document(mission),
        ".rally.waypoints": rally_document(mission),
    }
    return {ending: text for ending, text in found.items() if text is not None}


def track_document_text(track: TrackExport, file_format: ExportFormat) -> str:
    """Return a recorded track as a document; LeewayError for a format that holds missions only."""
    match file_format:
        case ExportFormat.KML:
            return track_kml(track)
        case ExportFormat.GPX:
            return track_gpx(track)
        case ExportFormat.GEOJSON:
            return _to_json_text(track_geojson(track))
    raise LeewayError(
        f"{file_format.value} holds a mission, not a track: expected kml, gpx or geojson for a log"
        " (a run folder's mission.plan is the mission that was uploaded)"
    )


def _to_json_text(document: dict[str, object]) -> str:
    return json.dumps(document, indent=1, allow_nan=False) + "\n"
