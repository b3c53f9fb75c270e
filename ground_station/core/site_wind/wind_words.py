"""The wind over a site in lines for people: the field, and fronts that come."""

import math
from collections.abc import Sequence

from companion.core.wind_field.fronts import FrontAhead, FrontWithdrawn
from ground_station.core.site_wind.site_wind import SiteWind

EVERYWHERE_MPS = 50.0
"""No front moves faster: the wind has changed for all at once."""


def field_words(site: SiteWind, now_s: float) -> str:
    """What the field is, in a line; empty: nobody tells."""
    wind, told = site.here(now_s), site.believed(now_s)
    if wind is None:
        return ""
    height_m = sum(one.height_m for one in told) / len(told)
    stations = sum(one.member in site.stations for one in told)
    counts = {"drone": len(told) - stations, "station": stations}
    who = " and ".join(f"{n} {kind}{'s' * (n > 1)}" for kind, n in counts.items() if n)
    return (
        f"wind {wind.speed_mps:.1f} +- {wind.std_mps:.1f} m/s from {wind.from_deg:.0f}"
        f" at {height_m:.0f} m, by {who}{_out_words(site, now_s)}"
    )


def front_words(
    front: FrontAhead, now_s: float, places: Sequence[tuple[str, tuple[float, float]]]
) -> str:
    """A front for people: what it brings, where it goes, and when it comes to whom."""
    change, towards = front.change_ne_mps, math.degrees(front.towards_rad) % 360.0
    felt = ", ".join(one.member for one in front.felt)
    comes: list[str] = []
    for name, place in places:
        t_s, std_s = front.arrives(place)
        if t_s > now_s:
            comes.append(f"{name} in {t_s - now_s:.0f} +- {std_s:.0f} s")
    ahead = f"; comes to {', '.join(comes)}" if comes else ""
    moves = f"moves {front.speed_mps:.0f} m/s towards {towards:.0f}"
    if front.speed_mps > EVERYWHERE_MPS:
        moves = "everywhere at once"
    return (
        f"FRONT: the wind changes by {math.hypot(*change):.0f} m/s, felt by {felt}; {moves}{ahead}"
    )


def withdrawn_words(withdrawn: FrontWithdrawn) -> str:
    """That a front is none, for people."""
    front = withdrawn.front
    felt = ", ".join(one.member for one in front.felt)
    stood_s = withdrawn.t_s - front.noticed_s
    return f"FRONT withdrawn, felt by {felt} {stood_s:.0f} s ago: all told since speaks against it"


def _out_words(site: SiteWind, now_s: float) -> str:
    out = [f"{name} ({why})" for name, why in sorted(site.left_out(now_s).items())]
    return f"; left out: {', '.join(out)}" if out else ""
