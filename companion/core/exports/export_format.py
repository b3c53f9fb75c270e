"""Formats by their names: a module of its own, since command lines load it for their help."""

from enum import StrEnum


class ExportFormat(StrEnum):
    """A file format; its value is the file's ending too, but for WPL's."""

    PLAN = "plan"
    WPL = "wpl"
    KML = "kml"
    GPX = "gpx"
    GEOJSON = "geojson"

    @property
    def suffix(self) -> str:
        """How its files end: Mission Planner looks for .waypoints."""
        return ".waypoints" if self is ExportFormat.WPL else f".{self.value}"
