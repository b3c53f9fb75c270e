"""Missions and tracks as GPX 1.1 (topografix.com/GPX/1/1), heights above mean sea level."""

from xml.etree import ElementTree as ET

from companion.core.exports.exported import GeoPoint, MissionExport, TrackExport
from companion.core.exports.utc import utc_text

NAMESPACE = "http://www.topografix.com/GPX/1/1"


def mission_gpx(mission: MissionExport) -> str:
    """Places as waypoints, the way out and the way home as routes."""
    root = _root(mission.name)
    for place in mission.places:
        waypoint = _point(root, "wpt", place.point)
        _text(waypoint, "name", place.name)
        _text(waypoint, "type", place.kind)
    for name, way in (("outbound", mission.outbound), ("homeward", mission.homeward)):
        route = ET.SubElement(root, "rte")
        _text(route, "name", name)
        for point in way:
            _point(route, "rtept", point)
    return _document(root)


def track_gpx(track: TrackExport) -> str:
    """The track, with UTC times where they are known."""
    root = _root(track.name)
    line = ET.SubElement(root, "trk")
    _text(line, "name", track.name)
    segment = ET.SubElement(line, "trkseg")
    for point, utc_s in track.points:
        element = _point(segment, "trkpt", point)
        if utc_s is not None:
            _text(element, "time", utc_text(utc_s))
    return _document(root)


def _root(name: str) -> ET.Element:
    root = ET.Element("gpx", {"version": "1.1", "creator": "Leeway", "xmlns": NAMESPACE})
    _text(ET.SubElement(root, "metadata"), "name", name)
    return root


def _point(parent: ET.Element, tag: str, point: GeoPoint) -> ET.Element:
    place = {"lat": f"{point.lat_deg:.7f}", "lon": f"{point.lon_deg:.7f}"}
    element = ET.SubElement(parent, tag, place)
    _text(element, "ele", f"{point.alt_amsl_m:.2f}")
    return element


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _document(root: ET.Element) -> str:
    ET.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"
