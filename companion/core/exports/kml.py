"""Missions and tracks as KML 2.2 (OGC 12-007r2), heights above mean sea level ("absolute")."""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from companion.core.exports.exported import Area, GeoPoint, MissionExport, TrackExport
from companion.core.exports.utc import iso8601_utc_text

NAMESPACE, EXTENSIONS = "http://www.opengis.net/kml/2.2", "http://www.google.com/kml/ext/2.2"


def mission_kml(mission: MissionExport) -> str:
    """Return locations, routes as lines in the air, and obstacles as prisms from the ground."""
    root, document = _create_root_and_document(mission.name)
    for location in mission.locations:
        mark = _append_placemark(document, location.name, location.kind)
        _append_coordinates(ET.SubElement(mark, "Point"), [location.point])
    for name, route_points in (("outbound", mission.outbound), ("homeward", mission.homeward)):
        _append_line_string(_append_placemark(document, name, "route"), route_points)
    for area in mission.areas:
        _append_obstacle_prism(document, area, mission.home.alt_amsl_m)
    return _to_xml_document(root)


def track_kml(track: TrackExport) -> str:
    """Return the track: with its times if all are known, otherwise as a line."""
    root, document = _create_root_and_document(track.name)
    mark = _append_placemark(document, track.name, "track")
    times_s = [utc_s for _, utc_s in track.points if utc_s is not None]
    if len(times_s) < len(track.points):
        _append_line_string(mark, [point for point, _ in track.points])
        return _to_xml_document(root)
    element = ET.SubElement(mark, "gx:Track")
    _append_text_element(element, "altitudeMode", "absolute")
    for utc_s in times_s:
        _append_text_element(element, "when", iso8601_utc_text(utc_s))
    for (lat, lon, alt), _ in track.points:
        _append_text_element(element, "gx:coord", f"{lon:.7f} {lat:.7f} {alt:.2f}")
    return _to_xml_document(root)


def _create_root_and_document(name: str) -> tuple[ET.Element, ET.Element]:
    root = ET.Element("kml", {"xmlns": NAMESPACE, "xmlns:gx": EXTENSIONS})
    document = ET.SubElement(root, "Document")
    _append_text_element(document, "name", name)
    return root, document


def _append_placemark(document: ET.Element, name: str, description: str) -> ET.Element:
    mark = ET.SubElement(document, "Placemark")
    _append_text_element(mark, "name", name)
    _append_text_element(mark, "description", description)
    return mark


def _append_line_string(mark: ET.Element, route_points: Sequence[GeoPoint]) -> None:
    line = ET.SubElement(mark, "LineString")
    _append_text_element(line, "altitudeMode", "absolute")
    _append_coordinates(line, route_points)


def _append_obstacle_prism(document: ET.Element, area: Area, depot_ground_amsl_m: float) -> None:
    description = "no-fly area" if area.height_m is None else "obstacle"
    polygon = ET.SubElement(_append_placemark(document, area.name, description), "Polygon")
    if area.height_m is not None:
        _append_text_element(polygon, "extrude", "1")
        _append_text_element(polygon, "altitudeMode", "absolute")
    top_m = depot_ground_amsl_m + (area.height_m or 0.0)
    ring = [GeoPoint(lat, lon, top_m) for lat, lon in (*area.ring_deg, area.ring_deg[0])]
    outline = ET.SubElement(ET.SubElement(polygon, "outerBoundaryIs"), "LinearRing")
    _append_coordinates(outline, ring)


def _append_coordinates(parent: ET.Element, points: Sequence[GeoPoint]) -> None:
    words = (f"{p.lon_deg:.7f},{p.lat_deg:.7f},{p.alt_amsl_m:.2f}" for p in points)
    _append_text_element(parent, "coordinates", " ".join(words))


def _append_text_element(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _to_xml_document(root: ET.Element) -> str:
    ET.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"
