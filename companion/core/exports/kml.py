"""Missions and tracks as KML 2.2 (OGC 12-007r2), heights above mean sea level ("absolute")."""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from companion.core.exports.exported import Area, GeoPoint, MissionExport, TrackExport
from companion.core.exports.utc import utc_text

NAMESPACE, EXTENSIONS = "http://www.opengis.net/kml/2.2", "http://www.google.com/kml/ext/2.2"


def mission_kml(mission: MissionExport) -> str:
    """Places, both ways as lines in the air, and obstacles as prisms from the ground."""
    root, document = _root(mission.name)
    for place in mission.places:
        mark = _placemark(document, place.name, place.kind)
        _coordinates(ET.SubElement(mark, "Point"), [place.point])
    for name, way in (("outbound", mission.outbound), ("homeward", mission.homeward)):
        _line(_placemark(document, name, "route"), way)
    for area in mission.areas:
        _prism(document, area, mission.home.alt_amsl_m)
    return _document(root)


def track_kml(track: TrackExport) -> str:
    """The track: with its times where all are known, otherwise as a line."""
    root, document = _root(track.name)
    mark = _placemark(document, track.name, "track")
    times_s = [utc_s for _, utc_s in track.points if utc_s is not None]
    if len(times_s) < len(track.points):
        _line(mark, [point for point, _ in track.points])
        return _document(root)
    element = ET.SubElement(mark, "gx:Track")
    _text(element, "altitudeMode", "absolute")
    for utc_s in times_s:
        _text(element, "when", utc_text(utc_s))
    for (lat, lon, alt), _ in track.points:
        _text(element, "gx:coord", f"{lon:.7f} {lat:.7f} {alt:.2f}")
    return _document(root)


def _root(name: str) -> tuple[ET.Element, ET.Element]:
    root = ET.Element("kml", {"xmlns": NAMESPACE, "xmlns:gx": EXTENSIONS})
    document = ET.SubElement(root, "Document")
    _text(document, "name", name)
    return root, document


def _placemark(document: ET.Element, name: str, what: str) -> ET.Element:
    mark = ET.SubElement(document, "Placemark")
    _text(mark, "name", name)
    _text(mark, "description", what)
    return mark


def _line(mark: ET.Element, way: Sequence[GeoPoint]) -> None:
    line = ET.SubElement(mark, "LineString")
    _text(line, "altitudeMode", "absolute")
    _coordinates(line, way)


def _prism(document: ET.Element, area: Area, ground_amsl_m: float) -> None:
    what = "no-fly area" if area.height_m is None else "obstacle"
    polygon = ET.SubElement(_placemark(document, area.name, what), "Polygon")
    if area.height_m is not None:
        _text(polygon, "extrude", "1")
        _text(polygon, "altitudeMode", "absolute")
    top_m = ground_amsl_m + (area.height_m or 0.0)
    ring = [GeoPoint(lat, lon, top_m) for lat, lon in (*area.ring_deg, area.ring_deg[0])]
    outline = ET.SubElement(ET.SubElement(polygon, "outerBoundaryIs"), "LinearRing")
    _coordinates(outline, ring)


def _coordinates(parent: ET.Element, points: Sequence[GeoPoint]) -> None:
    words = (f"{p.lon_deg:.7f},{p.lat_deg:.7f},{p.alt_amsl_m:.2f}" for p in points)
    _text(parent, "coordinates", " ".join(words))


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _document(root: ET.Element) -> str:
    ET.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"
