"""Texts on the wind over a site: the field, and approaching fronts."""

import math
from collections.abc import Sequence

from companion.core.wind_field.fronts import FrontWithdrawn, WindFront
from ground_station.core.site_wind.site_wind import SiteWind

MAX_FRONT_SPEED_MPS = 50.0
"""Maximum speed of a front: a faster change is simultaneous at all members."""


def format_site_wind(site: SiteWind, now_s: float) -> str:
    """Format the field in one line; empty: no report."""
    wind, reports = site.wind_at_report_centroid(now_s), site.latest_accepted_reports(now_s)
    if wind is None:
        return ""
    height_m = sum(one.height_m for one in reports) / len(reports)
    stations = sum(one.member in site.station_names for one in reports)
    counts = {"drone": len(reports) - stations, "station": stations}
    sources = " and ".join(f"{n} {kind}{'s' * (n > 1)}" for kind, n in counts.items() if n)
    return (
        f"wind {wind.speed_mps:.1f} +- {wind.larger_axis_std_mps:.1f} m/s from {wind.from_deg:.0f}"
        f" at {height_m:.0f} m, by {sources}{_format_excluded_members(site, now_s)}"
    )


def format_front(
    front: WindFront, now_s: float, named_positions_ne_m: Sequence[tuple[str, tuple[float, float]]]
) -> str:
    """Format a front: its change of wind, its motion, and its arrival at each position."""
    change, direction_deg = front.change_ne_mps, math.degrees(front.direction_rad) % 360.0
    members = ", ".join(one.member for one in front.detections)
    arrivals: list[str] = []
    for name, position in named_positions_ne_m:
        t_s, std_s = front.arrival_time_and_std_s(position)
        if t_s > now_s:
            arrivals.append(f"{name} in {t_s - now_s:.0f} +- {std_s:.0f} s")
    arrival_text = f"; arrives at {', '.join(arrivals)}" if arrivals else ""
    motion_text = f"moves {front.speed_mps:.0f} m/s towards {direction_deg:.0f}"
    if front.speed_mps > MAX_FRONT_SPEED_MPS:
        motion_text = "at all members at once"
    return (
        f"FRONT: the wind changes by {math.hypot(*change):.0f} m/s, detected by {members};"
        f" {motion_text}{arrival_text}"
    )


def format_withdrawal(withdrawn: FrontWithdrawn) -> str:
    """Format the withdrawal of a front."""
    front = withdrawn.front
    members = ", ".join(one.member for one in front.detections)
    age_s = withdrawn.t_s - front.detected_s
    return f"FRONT withdrawn, detected by {members} {age_s:.0f} s ago: contradicted since then"


def _format_excluded_members(site: SiteWind, now_s: float) -> str:
    excluded = [
        f"{name} ({reason})"
        for name, reason in sorted(site.exclusion_reason_by_member(now_s).items())
    ]
    return f"; excluded: {', '.join(excluded)}" if excluded else ""
