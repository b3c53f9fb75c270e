"""Rows of the decision log as Foxglove's own messages: what its Map and Log panels draw.

Field names, types and enumerations are those of Foxglove's schemas in JSON
(docs.foxglove.dev, "Message schemas"); a time is {sec, nsec} since 1970.
"""

from typing import Any

from companion.core.mission.actions import Severity

POSITION, ROUTE, LOG = "foxglove_position", "foxglove_route", "foxglove_log"

TIME = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    },
}
NUMBER, COUNT, TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}

COVARIANCE_UNKNOWN = 0
DEBUG, INFO, WARNING, ERROR, FATAL = 1, 2, 3, 4, 5
LEVEL = {
    Severity.CRITICAL: FATAL,
    Severity.ERROR: ERROR,
    Severity.WARNING: WARNING,
    Severity.NOTICE: INFO,
    Severity.INFO: INFO,
}

FOXGLOVE: dict[str, tuple[str, dict[str, Any]]] = {
    POSITION: (
        "foxglove.LocationFix",
        {
            "timestamp": TIME,
            "frame_id": TEXT,
            "latitude": NUMBER,
            "longitude": NUMBER,
            "altitude": NUMBER,
            "position_covariance": {
                "type": "array",
                "items": NUMBER,
                "minItems": 9,
                "maxItems": 9,
            },
            "position_covariance_type": COUNT,
        },
    ),
    ROUTE: ("foxglove.GeoJSON", {"geojson": TEXT}),
    LOG: (
        "foxglove.Log",
        {
            "timestamp": TIME,
            "level": COUNT,
            "message": TEXT,
            "name": TEXT,
            "file": TEXT,
            "line": COUNT,
        },
    ),
}
"""Topic: the name of its Foxglove schema, and its fields."""


def foxglove_row(topic: str, row: dict[str, Any], stamp_ns: int) -> tuple[str, dict[str, Any]]:
    """(topic, message) that one of our rows is for Foxglove; ("", {}) where it is none.

    `stamp_ns`: nanoseconds since 1970.
    """
    stamp = {"timestamp": {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}}
    match topic:
        case "heard_position":
            return POSITION, stamp | _location_fix(row)
        case "said":
            return LOG, stamp | _log(LEVEL[Severity(row["severity"])], row["text"], "operator")
        case "decision":
            return LOG, stamp | _log(INFO, f"{row['kind']}: {row['reason']}", "decision")
        case "phase":
            words = f"{row['before']} -> {row['now']} ({row['why']})"
            return LOG, stamp | _log(DEBUG, words, "phase")
    return "", {}


def _location_fix(row: dict[str, Any]) -> dict[str, Any]:
    return {
        "frame_id": "gnss",
        "latitude": row["lat_deg"],
        "longitude": row["lon_deg"],
        "altitude": row["alt_amsl_m"],
        "position_covariance": [0.0] * 9,
        "position_covariance_type": COVARIANCE_UNKNOWN,
    }


def _log(level: int, message: str, name: str) -> dict[str, Any]:
    return {"level": level, "message": message, "name": name, "file": "", "line": 0}
