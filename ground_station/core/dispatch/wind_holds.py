"""Launches that the wind forbids now: a front would meet them, or wind aloft exceeds the limit.

The only state is the time of the last exceedance. Due holds are recomputed at each call, so a hold
ends with its cause.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from companion.core.wind_field.fronts import WindFront
from ground_station.core.dispatch.hold_source import HoldKey, HoldSource
from ground_station.core.schema.holds import ALL_DRONES
from ground_station.core.site_wind.site_wind import SiteWind

RESUME_FRACTION, CALM_S = 0.85, 300.0
"""Launches resume when the reported wind has been below this share of the limit for `CALM_S`."""

MAX_REPORT_AGE_S = 10.0
"""Maximum age of a wind report that counts as the current wind aloft."""

FRONT_PASSAGE_S = 60.0
"""Duration of gusts behind a front's edge."""

MIN_SPEED_FRACTION, EXTRA_FLIGHT_S = 0.5, 180.0
"""Upper limit of the time of an unplanned flight: at half its cruise airspeed, plus the second for
take-off, settling, drop and landing.
"""


@dataclass(frozen=True, slots=True)
class PlannedLaunch:
    """A future launch: vehicle, positions of its flight (the first is its current one), maximum
    duration.
    """

    vehicle: str
    positions_ne_m: tuple[tuple[float, float], ...]
    max_duration_s: float


def flight_duration_upper_bound_s(
    positions_ne_m: Sequence[tuple[float, float]], cruise_airspeed_mps: float
) -> float:
    """Return the maximum duration of a flight through these positions."""
    path_m = sum(math.dist(a, b) for a, b in pairwise(positions_ne_m))
    return EXTRA_FLIGHT_S + path_m / (MIN_SPEED_FRACTION * cruise_airspeed_mps)


@dataclass(slots=True)
class WindHoldRules:
    """Determines the holds that the wind requires. `limit_mps`: limit of the wind aloft."""

    wind: SiteWind
    limit_mps: float
    _exceeded_s: float = -math.inf
    _exceedance_text: str = ""

    def update_reason_by_due_hold(
        self, now_s: float, launches: Sequence[PlannedLaunch]
    ) -> dict[HoldKey, str]:
        """Return the holds that are due, with their reasons."""
        found: dict[HoldKey, str] = {}
        if self.update_is_on_wind_hold(now_s):
            found[ALL_DRONES, HoldSource.WIND] = self._exceedance_text
        for front in self.wind.drop_expired_and_get_fronts(now_s):
            for launch in launches:
                if may_be_hit_by_front(front, launch, now_s):
                    found.setdefault((launch.vehicle, HoldSource.FRONT), _front_hold_text(front))
        return found

    def update_is_on_wind_hold(self, now_s: float) -> bool:
        """Return True while wind aloft exceeds the limit and for `CALM_S` afterwards."""
        on_hold = now_s - self._exceeded_s < CALM_S
        threshold_fraction = RESUME_FRACTION if on_hold else 1.0
        for one in self.wind.latest_accepted_reports(now_s, MAX_REPORT_AGE_S):
            reported_mps = math.hypot(*one.mean_to_ne_mps)
            if reported_mps >= threshold_fraction * self.limit_mps:
                if not on_hold:
                    self._exceedance_text = (
                        f"wind aloft {reported_mps:.1f} m/s, reported by {one.member} at"
                        f" {one.height_m:.0f} m; the limit is {self.limit_mps:.1f}"
                    )
                self._exceeded_s = now_s
                return True
        return on_hold


def may_be_hit_by_front(front: WindFront, launch: PlannedLaunch, now_s: float) -> bool:
    """Return True if a front may pass a position of a flight launched now, or just passed it."""
    return any(
        front.may_pass_within(position, now_s - FRONT_PASSAGE_S, now_s + launch.max_duration_s)
        for position in launch.positions_ne_m
    )


def _front_hold_text(front: WindFront) -> str:
    change_mps = math.hypot(*front.change_ne_mps)
    direction_deg = math.degrees(front.direction_rad) % 360.0
    return (
        f"a front ({change_mps:.0f} m/s, {front.speed_mps:.0f} m/s towards {direction_deg:.0f},"
        f" detected by {front.detections[0].member}) would meet its flight; until it has passed"
    )
