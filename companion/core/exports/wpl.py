"""Missions as QGC WPL 110, the text that Mission Planner and MAVProxy load (mavlink.io, "File
Formats": plain-text mission files), and the two files beside it for fence and rally points.
"""

import math

from companion.core.exports.exported import MissionExport

HEADER = "QGC WPL 110"
ABSOLUTE, RELATIVE, MISSION, WAYPOINT = 0, 3, 2, 16
FENCE_RETURN, FENCE_EXCLUSION, RALLY_POINT = 5000, 5002, 5100
NOTHING = (0.0, 0.0, 0.0, 0.0)


def wpl_document(mission: MissionExport) -> str:
    """The mission's items; the first line is home, as both tools expect.

    The format has no geofence and no rally points: those are `fence_document`, `rally_document`.
    """
    home = mission.home
    place = (home.lat_deg, home.lon_deg, home.alt_amsl_m)
    lines = [HEADER, _line(0, 1, ABSOLUTE, WAYPOINT, NOTHING, place)]
    for number, item in enumerate(mission.items, 1):
        if item.spot is None:
            lines.append(_line(number, 0, MISSION, item.command, item.params, (0.0, 0.0, 0.0)))
            continue
        spot = item.spot
        place = (spot.lat_deg, spot.lon_deg, spot.height_rel_m)
        lines.append(_line(number, 0, RELATIVE, item.command, item.params, place))
    return "\n".join(lines) + "\n"


def fence_document(mission: MissionExport) -> str | None:
    """The areas that the mission may not fly over, as `fence load` reads them; None without any.

    The first item is where a breach returns to, home: Mission Planner takes the first line of any
    such file for home and leaves it out of the list.
    """
    areas = [area for area in mission.areas if area.in_fence]
    if not areas:
        return None
    home = (mission.home.lat_deg, mission.home.lon_deg, 0.0)
    lines = [HEADER, _line(0, 0, ABSOLUTE, FENCE_RETURN, NOTHING, home)]
    for area in areas:
        corners = (float(len(area.ring_deg)), 0.0, 0.0, 0.0)
        for lat_deg, lon_deg in area.ring_deg:
            place = (lat_deg, lon_deg, 0.0)
            lines.append(_line(len(lines) - 1, 0, ABSOLUTE, FENCE_EXCLUSION, corners, place))
    return "\n".join(lines) + "\n"


def rally_document(mission: MissionExport) -> str | None:
    """The rally points as `rally load` reads them; None without any.

    The first stands twice, for the line that Mission Planner takes for home. (The older format of
    "RALLY" lines is not written: pymavlink 2.4.49 reads its metres as millimetres.)
    """
    if not mission.rally:
        return None
    lines = [HEADER]
    for number, point in enumerate((mission.rally[0], *mission.rally)):
        spot = point.spot
        place = (spot.lat_deg, spot.lon_deg, spot.height_rel_m)
        lines.append(_line(number, 0, RELATIVE, RALLY_POINT, NOTHING, place))
    return "\n".join(lines) + "\n"


def _line(
    number: int,
    current: int,
    frame: int,
    command: int,
    params: tuple[float, float, float, float],
    place: tuple[float, float, float],
) -> str:
    # Readers of the format differ on NaN; ArduPilot takes 0 as "choose your own heading".
    numbers = [f"{0.0 if math.isnan(p) else p:.8f}" for p in (*params, *place)]
    return "\t".join([str(number), str(current), str(frame), str(command), *numbers, "1"])
