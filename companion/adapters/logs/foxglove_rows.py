"""Rows of the decision log as Foxglove messages, for its Map and Log panels.

Field names, types and enumerations are those of Foxglove's JSON schemas (docs.foxglove.dev,
"Message schemas"); a time is {sec, nsec} since 1970.
"""

from typing import Any

from companion.core.mission.alerts import Severity

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
"""Topic: its Foxglove schema name and fields."""


def foxglove_row(topic: str, row: dict[str, Any], stamp_ns: int) -> tuple[str, dict[str, Any]]:
    """Return the Foxglove (topic, message) of a decision log row; ("", {}) if it has none.

    `stamp_ns`: nanoseconds since 1970.
    """
    stamp = {"timestamp": {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}}
    match topic:
        case "heard_position":
            return POSITION, stamp | _location_fix(row)
        case "said":
            return LOG, stamp | _log_message(
                LEVEL[Severity(row["severity"])], row["text"], "operator"
            )
        case "decision":
            return LOG, stamp | _log_message(INFO, f"{row['kind']}: {row['reason']}", "decision")
        case "phase":
            words = f"{row['before']} -> {row['now']} ({row['why']})"
            return LOG, stamp | _log_message(DEBUG, words, "phase")
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


def _log_message(level: int, message: str, name: str) -> dict[str, Any]:
    return {"level": level, "message": message, "name": name, "file": "", "line": 0}
