"""Which launches the wind forbids now: a front that would catch them, or wind aloft over the limit.

Nothing here is kept but since when the wind has been over its limit: what is due is worked out anew
each time, so a hold is over when its reason is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from companion.core.wind_field.fronts import FrontAhead
from ground_station.core.schema.holds import ALL
from ground_station.core.site_wind.site_wind import SiteWind

HELD_BY = "desk-wind"
"""Whose holds these are. No person has this name: nobody else lifts them, and they lift none."""

AGAIN_SHARE, CALM_S = 0.85, 300.0
"""Launches go on when it has been below this share of the limit for so long, as far as is told."""

TOLD_S = 10.0
"""What somebody told so long ago is still the wind aloft."""

BEHIND_S = 60.0
"""Gusts behind a front's edge."""

SLOWEST_SHARE, GROUND_S = 0.5, 180.0
"""How long a flight may take before it is known: at half its cruise airspeed, and so long for
take-off, settling, drop and landing.
"""


@dataclass(frozen=True, slots=True)
class Launch:
    """A launch to come: a vehicle, the places of its flight (the first where it stands), and how
    long it takes at most.
    """

    vehicle: str
    places_ne_m: tuple[tuple[float, float], ...]
    takes_s: float


def longest_s(places_ne_m: Sequence[tuple[float, float]], airspeed_mps: float) -> float:
    """How long a flight by these places may take."""
    way_m = sum(math.dist(a, b) for a, b in pairwise(places_ne_m))
    return GROUND_S + way_m / (SLOWEST_SHARE * airspeed_mps)


@dataclass(slots=True)
class WindHolds:
    """What is due now. `limit_mps`: of the wind aloft."""

    wind: SiteWind
    limit_mps: float
    _over_s: float = -math.inf
    _over_words: str = ""

    def due(self, now_s: float, launches: Sequence[Launch]) -> dict[str, str]:
        """Who is to be held (a vehicle, or `ALL`), and why."""
        found: dict[str, str] = {}
        if self.is_over(now_s):
            found[ALL] = self._over_words
        for front in self.wind.fronts_now(now_s):
            for launch in launches:
                if would_catch(front, launch, now_s):
                    found.setdefault(launch.vehicle, _caught_words(front))
        return found

    def is_over(self, now_s: float) -> bool:
        """Whether wind aloft is over the limit, or was until a while ago."""
        holding = now_s - self._over_s < CALM_S
        share = AGAIN_SHARE if holding else 1.0
        for one in self.wind.believed(now_s, TOLD_S):
            told_mps = math.hypot(*one.mean_to_ne_mps)
            if told_mps >= share * self.limit_mps:
                if not holding:
                    self._over_words = (
                        f"wind aloft {told_mps:.1f} m/s, by {one.member} at {one.height_m:.0f} m;"
                        f" the limit is {self.limit_mps:.1f}"
                    )
                self._over_s = now_s
                return True
        return holding


def would_catch(front: FrontAhead, launch: Launch, now_s: float) -> bool:
    """Whether a front may pass any place of a flight that is launched now, or has just passed."""
    return any(
        front.catches(place, now_s - BEHIND_S, now_s + launch.takes_s)
        for place in launch.places_ne_m
    )


def _caught_words(front: FrontAhead) -> str:
    change_mps = math.hypot(*front.change_ne_mps)
    towards = math.degrees(front.towards_rad) % 360.0
    return (
        f"a front ({change_mps:.0f} m/s, {front.speed_mps:.0f} m/s towards {towards:.0f}, felt by"
        f" {front.felt[0].member}) would meet its flight; until it has passed"
    )
