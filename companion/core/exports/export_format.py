"""File formats by name: a separate module, since command lines load it for their help."""

from enum import StrEnum


class ExportFormat(StrEnum):
    """A file format; its value is also the file's extension, except for WPL."""

    PLAN = "plan"
    WPL = "wpl"
    KML = "kml"
    GPX = "gpx"
    GEOJSON = "geojson"

    @property
    def suffix(self) -> str:
        """File extension: Mission Planner expects .waypoints."""
        return ".waypoints" if self is ExportFormat.WPL else f".{self.value}"
