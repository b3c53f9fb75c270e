"""Suspends position reports after a step that the vehicle cannot fly (an estimator's reset).

The autopilot navigates by the same estimate, so a stable one is accepted again, unless the GNSS
receiver contradicts it.
"""

import math
from dataclasses import dataclass, field

from companion.core.base.geo import ne_offset_m
from companion.core.mission.events import GnssFix, Position
from companion.core.wind.step_watch import HEIGHT, POSITION, StepDetector

STABLE_S = 5.0
MAX_GNSS_DISTANCE_M, MAX_GNSS_HEIGHT_DIFFERENCE_M = 20.0, 25.0
"""Larger differences contradict: receiver error, delay at top speed, drift of a barometer."""


@dataclass(slots=True)
class PositionWatch:
    """Watches horizontal position and altitude of one flight. `step_count`: steps so far."""

    step_count: int = 0
    reason: str = ""
    """Why the reports are suspended; empty while they are accepted."""
    _stepped_s: float = 0.0
    _origin_deg: tuple[float, float] | None = None
    _horizontal: StepDetector = field(default_factory=lambda: StepDetector(POSITION, [0.0, 0.0]))
    _height: StepDetector = field(default_factory=lambda: StepDetector(HEIGHT, [0.0]))

    def accepts_report(self, position: Position, gnss: GnssFix | None) -> bool:
        """Process a report in flight; return whether it can be used. `gnss`: recent fix."""
        self._origin_deg = self._origin_deg or (position.lat_deg, position.lon_deg)
        north_east_m = ne_offset_m(*self._origin_deg, position.lat_deg, position.lon_deg)
        speeds_mps = position.vel_n_mps, position.vel_e_mps
        for detector, limits, values, rates in (
            (self._horizontal, POSITION, north_east_m, speeds_mps),
            (self._height, HEIGHT, [position.alt_amsl_m], [-position.vel_d_mps]),
        ):
            size = detector.update_and_detect_step(position.t_s, values, rates)
            if size:
                self.step_count += 1
                self._stepped_s, self.reason = position.t_s, limits.step_text(size)
        if not any((*self._horizontal.off, *self._height.off)):
            self.reason = ""
        elif position.t_s - self._stepped_s > STABLE_S and not _contradicts(gnss, position):
            self._horizontal.accept_reports()
            self._height.accept_reports()
            self.reason = ""
        return not self.reason


def _contradicts(gnss: GnssFix | None, position: Position) -> bool:
    if gnss is None or gnss.lat_lon_deg is None:
        return False
    offset_m = ne_offset_m(*gnss.lat_lon_deg, position.lat_deg, position.lon_deg)
    height_difference_m = abs((gnss.gnss_alt_m or position.alt_amsl_m) - position.alt_amsl_m)
    return (
        math.hypot(*offset_m) > MAX_GNSS_DISTANCE_M
        or height_difference_m > MAX_GNSS_HEIGHT_DIFFERENCE_M
    )
