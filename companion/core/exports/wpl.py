"""Missions as QGC WPL 110, the text that Mission Planner and MAVProxy load (mavlink.io, "File
Formats": plain-text mission files), and the separate files for fence and rally points."""

import math

from companion.core.exports.exported import MissionExport

HEADER = "QGC WPL 110"
ABSOLUTE, RELATIVE, MISSION, WAYPOINT = 0, 3, 2, 16
FENCE_RETURN, FENCE_EXCLUSION, RALLY_POINT = 5000, 5002, 5100
NO_PARAMS = (0.0, 0.0, 0.0, 0.0)


def wpl_document(mission: MissionExport) -> str:
    """Return the mission's items; the first line is home, as both tools expect.

    The format has no geofence and no rally points: see `fence_document`, `rally_document`.
    """
    home = mission.home
    position = (home.lat_deg, home.lon_deg, home.alt_amsl_m)
    lines = [HEADER, _wpl_line(0, 1, ABSOLUTE, WAYPOINT, NO_PARAMS, position)]
    for number, item in enumerate(mission.items, 1):
        if item.spot is None:
            lines.append(_wpl_line(number, 0, MISSION, item.command, item.params, (0.0, 0.0, 0.0)))
            continue
        spot = item.spot
        position = (spot.lat_deg, spot.lon_deg, spot.height_rel_m)
        lines.append(_wpl_line(number, 0, RELATIVE, item.command, item.params, position))
    return "\n".join(lines) + "\n"


def fence_document(mission: MissionExport) -> str | None:
    """Return the areas that the mission may not fly over, for `fence load`; None without any.

    The first item is the return point after a breach, home: Mission Planner interprets the first
    line of any such file as home and does not list it.
    """
    areas = [area for area in mission.areas if area.in_fence]
    if not areas:
        return None
    home = (mission.home.lat_deg, mission.home.lon_deg, 0.0)
    lines = [HEADER, _wpl_line(0, 0, ABSOLUTE, FENCE_RETURN, NO_PARAMS, home)]
    for area in areas:
        corners = (float(len(area.ring_deg)), 0.0, 0.0, 0.0)
        for lat_deg, lon_deg in area.ring_deg:
            position = (lat_deg, lon_deg, 0.0)
            lines.append(_wpl_line(len(lines) - 1, 0, ABSOLUTE, FENCE_EXCLUSION, corners, position))
    return "\n".join(lines) + "\n"


def rally_document(mission: MissionExport) -> str | None:
    """Return the rally points for `rally load`; None without any.

    The first is repeated, because Mission Planner interprets the first line as home. (The older
    format of "RALLY" lines is not written: pymavlink 2.4.49 reads its metres as millimetres.)
    """
    if not mission.rally:
        return None
    lines = [HEADER]
    for number, point in enumerate((mission.rally[0], *mission.rally)):
        spot = point.spot
        position = (spot.lat_deg, spot.lon_deg, spot.height_rel_m)
        lines.append(_wpl_line(number, 0, RELATIVE, RALLY_POINT, NO_PARAMS, position))
    return "\n".join(lines) + "\n"


def _wpl_line(
    item_number: int,
    is_current: int,
    frame: int,
    command: int,
    params: tuple[float, float, float, float],
    position: tuple[float, float, float],
) -> str:
    # Readers of the format differ on NaN; ArduPilot interprets 0 as free choice of the heading.
    numbers = [f"{0.0 if math.isnan(p) else p:.8f}" for p in (*params, *position)]
    return "\t".join([str(item_number), str(is_current), str(frame), str(command), *numbers, "1"])
