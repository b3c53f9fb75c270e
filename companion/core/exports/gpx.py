"""Missions and tracks as GPX 1.1 (topografix.com/GPX/1/1), heights above mean sea level."""

from xml.etree import ElementTree as ET

from companion.core.exports.exported import GeoPoint, MissionExport, TrackExport
from companion.core.exports.utc import iso8601_utc_text

NAMESPACE = "http://www.topografix.com/GPX/1/1"


def mission_gpx(mission: MissionExport) -> str:
    """Return locations as waypoints, both routes as routes."""
    root = _create_gpx_root(mission.name)
    for location in mission.locations:
        waypoint = _append_point_element(root, "wpt", location.point)
        _append_text_element(waypoint, "name", location.name)
        _append_text_element(waypoint, "type", location.kind)
    for name, route_points in (("outbound", mission.outbound), ("homeward", mission.homeward)):
        route = ET.SubElement(root, "rte")
        _append_text_element(route, "name", name)
        for point in route_points:
            _append_point_element(route, "rtept", point)
    return _to_xml_document(root)


def track_gpx(track: TrackExport) -> str:
    """Return the track, with UTC times where they are known."""
    root = _create_gpx_root(track.name)
    line = ET.SubElement(root, "trk")
    _append_text_element(line, "name", track.name)
    segment = ET.SubElement(line, "trkseg")
    for point, utc_s in track.points:
        element = _append_point_element(segment, "trkpt", point)
        if utc_s is not None:
            _append_text_element(element, "time", iso8601_utc_text(utc_s))
    return _to_xml_document(root)


def _create_gpx_root(name: str) -> ET.Element:
    root = ET.Element("gpx", {"version": "1.1", "creator": "Leeway", "xmlns": NAMESPACE})
    _append_text_element(ET.SubElement(root, "metadata"), "name", name)
    return root


def _append_point_element(parent: ET.Element, tag: str, point: GeoPoint) -> ET.Element:
    location = {"lat": f"{point.lat_deg:.7f}", "lon": f"{point.lon_deg:.7f}"}
    element = ET.SubElement(parent, tag, location)
    _append_text_element(element, "ele", f"{point.alt_amsl_m:.2f}")
    return element


def _append_text_element(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _to_xml_document(root: ET.Element) -> str:
    ET.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"
