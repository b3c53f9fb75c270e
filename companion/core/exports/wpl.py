"""Missions as QGC WPL 110, the text that Mission Planner and MAVProxy load (mavlink.io, "File
Formats": plain-text mission files).
"""

import math

from companion.core.exports.exported import MissionExport

HEADER = "QGC WPL 110"
ABSOLUTE, RELATIVE, MISSION, WAYPOINT = 0, 3, 2, 16


def wpl_document(mission: MissionExport) -> str:
    """The mission's items; the first line is home, as both tools expect.

    The format has no geofence and no rally points.
    """
    home = mission.home
    place = (home.lat_deg, home.lon_deg, home.alt_amsl_m)
    lines = [HEADER, _line(0, 1, ABSOLUTE, WAYPOINT, (0.0, 0.0, 0.0, 0.0), place)]
    for number, item in enumerate(mission.items, 1):
        if item.spot is None:
            lines.append(_line(number, 0, MISSION, item.command, item.params, (0.0, 0.0, 0.0)))
            continue
        spot = item.spot
        place = (spot.lat_deg, spot.lon_deg, spot.height_rel_m)
        lines.append(_line(number, 0, RELATIVE, item.command, item.params, place))
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
