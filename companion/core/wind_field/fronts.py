"""Front detection: a lasting change of wind at one member that moves on to the others.

A member's latest 10 s mean is compared with the mean of the minute before. The wind process gives
the variance of this difference, and the last ten minutes the ratio of the actual gustiness to it.
If the difference is larger, the reports of all members nearby are evaluated (`compute_front_odds`):
the odds decide whether there is a front, its direction and its time. Each member that it reaches
corrects the estimate: times of arrival are linear in the slowness vector s, t = t0 + s . x. A front
that few members detect and that later reports contradict is withdrawn.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from heapq import nsmallest

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.front_odds import KEPT_S, FrontOdds, compute_front_odds
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, MemberWindReport

BEFORE_S, GAP_S = 60.0, 15.0
"""The minute before, and the gap up to now in which a front may be passing."""
MIN_BEFORE_S = 30.0

SUSPECT_SQUARE = 5.0
"""Squared ratio of the change to its expectation from which the odds are computed; reached by
chance once in a dozen."""
EVALUATION_INTERVAL_S = 2.0
"""Minimum interval between computations of the odds."""
MAX_TERRAIN_SHARE = 0.1
"""Limit of the terrain effect: a larger one would hide fronts from moving drones."""
LOG_ODDS = 6.5
"""Natural logarithm of the odds from which a front is accepted.

Chosen on fields about recorded wind (seeds 200 to 202: 82 fronts, 74 h) for less than one false
alert in ten hours of eight drones.
"""
SINGLE_MEMBER_LOG_ODDS = 2.5
"""Allowed excess of the log odds of a change at a single member: its neighbours would have detected
a front."""
MAX_MEMBERS = 10
"""Number of members evaluated, the nearest ones; more add little information."""
MAX_REPORT_AGE_S = 15.0
"""Age of a member's latest report above which the member is not evaluated."""

WITHDRAWAL_PERIOD_S, WITHDRAWN_LOG_ODDS = 60.0, 2.0
"""Period after detection in which the odds are recomputed; log odds that withdraw the front.

On fields about recorded wind (seeds 200 to 202) the odds of a gust fall this low within this time,
whereas those of a front rise first. Later they fall, too, as the earlier wind leaves the memory.
"""

CONFIRMING_MEMBERS = 2
"""Number of other members whose detection makes a front final."""

CONFIRMATION_SQUARE, CONFIRMATION_MPS, CONFIRMATION_COS = 8.0, 3.5, 0.7
"""Limits of a member's own change that confirm a known front: within 45 degrees of its change."""
DETECTION_STD_S = 10.0

GUST_MEMORY_S, MAX_SQUARE, NOMINAL_SQUARE = 600.0, 14.0, 2.0
"""Gustiness is learned over ten minutes: the mean square, relative to 2 by the process. The limit
makes a front count as a gust."""

FRONT_LIFETIME_S = 300.0
"""Time after which a front has left the site, and another one may come."""


@dataclass(frozen=True, slots=True)
class WindChange:
    """A member's change of wind: detection time and position, change, wind behind the front. At the
    first member they are estimates, because the change there has only started."""

    member: str
    t_s: float
    position_ne_m: tuple[float, float]
    change_ne_mps: tuple[float, float]
    wind_ne_mps: tuple[float, float]
    square: float
    """Squared ratio of the change to its expectation: chi-square of two degrees by chance."""

    @property
    def magnitude_mps(self) -> float:
        """Magnitude of the change."""
        return math.hypot(*self.change_ne_mps)


@dataclass(frozen=True, slots=True)
class WindFront:
    """An accepted front: its time of arrival at each position, with the error.

    `slowness_spm` (2,) seconds per metre towards north and east, `cov` (3, 3) of (t0, slowness)
    about `origin_ne_m`.
    """

    detected_s: float
    detections: tuple[WindChange, ...]
    origin_ne_m: Floats
    t0_s: float
    slowness_spm: Floats
    cov: Floats

    @property
    def change_ne_mps(self) -> tuple[float, float]:
        """The largest change among the members that detected the front."""
        return max(self.detections, key=lambda one: one.magnitude_mps).change_ne_mps

    @property
    def speed_mps(self) -> float:
        """Speed of the front over the ground."""
        return 1.0 / max(float(np.hypot(*self.slowness_spm)), 1e-3)

    @property
    def direction_rad(self) -> float:
        """Direction that the front moves to, clockwise from north."""
        return math.atan2(float(self.slowness_spm[1]), float(self.slowness_spm[0]))

    def arrival_time_and_std_s(self, position_ne_m: tuple[float, float]) -> tuple[float, float]:
        """Return the detection time at a position and its standard deviation, s."""
        due_s, std_s = self.arrival_times_and_stds_s(np.array([position_ne_m]))
        return float(due_s[0]), float(std_s[0])

    def arrival_times_and_stds_s(self, position_ne_m: Floats) -> tuple[Floats, Floats]:
        """Return times and standard deviations (n,) for positions (n, 2)."""
        off_m = position_ne_m - self.origin_ne_m
        rows = np.column_stack([np.ones(len(off_m)), off_m])
        variance = np.einsum("ij,jk,ik->i", rows, self.cov, rows)
        return self.t0_s + off_m @ self.slowness_spm, np.sqrt(variance + DETECTION_STD_S**2)

    def may_pass_within(
        self, position_ne_m: tuple[float, float], interval_start_s: float, interval_end_s: float
    ) -> bool:
        """Return whether it may pass a position in a time interval (two standard deviations)."""
        t_s, std_s = self.arrival_time_and_std_s(position_ne_m)
        return interval_start_s - 2.0 * std_s <= t_s <= interval_end_s + 2.0 * std_s

    def updated_with(self, detection: WindChange) -> "WindFront":
        """Return the front after a linear update by one more member's detection."""
        row = np.array([1.0, *(np.array(detection.position_ne_m) - self.origin_ne_m)])
        late_s = detection.t_s - self.t0_s - float(row[1:] @ self.slowness_spm)
        with_late = self.cov @ row
        variance = float(row @ with_late) + DETECTION_STD_S**2
        gain = with_late / variance
        cov = self.cov - np.outer(gain, with_late)
        return replace(
            self,
            detections=(*self.detections, detection),
            t0_s=self.t0_s + float(gain[0]) * late_s,
            slowness_spm=self.slowness_spm + gain[1:] * late_s,
            cov=0.5 * (cov + cov.T),
        )


@dataclass(frozen=True, slots=True)
class FrontWithdrawn:
    """The withdrawal of an accepted front at `t_s`."""

    front: WindFront
    t_s: float


FrontUpdate = WindFront | FrontWithdrawn


@dataclass(slots=True)
class _Member:
    """One member's reports of the last minutes, oldest first, and the gustiness there."""

    reports: deque[MemberWindReport] = field(default_factory=deque)
    square: float = NOMINAL_SQUARE
    latest_change: WindChange | None = None
    """Change of the wind by the latest report."""

    def update_gustiness(self, change_square: float, dt_s: float) -> None:
        """Update the gustiness at this member."""
        share = -math.expm1(-dt_s / GUST_MEMORY_S)
        self.square += share * (min(change_square, MAX_SQUARE) - self.square)

    def store_report_and_get_wind_change(
        self, report: MemberWindReport
    ) -> tuple[float, float] | None:
        """Return the latest wind less the mean of the minute before; None if unknown."""
        now_s = report.t_s
        while self.reports and now_s - self.reports[0].t_s > KEPT_S:
            self.reports.popleft()
        before = [one for one in self.reports if GAP_S <= now_s - one.t_s <= BEFORE_S + GAP_S]
        self.reports.append(report)
        if len(before) < 2 or before[-1].t_s - before[0].t_s < MIN_BEFORE_S:
            return None
        north, east = (sum(one.mean_to_ne_mps[k] for one in before) / len(before) for k in (0, 1))
        wind = report.mean_to_ne_mps
        return wind[0] - north, wind[1] - east


class FrontMonitor:
    """Detects fronts in the members' reports, about once a second; one per desk."""

    def __init__(self, process: WindProcessParams) -> None:
        self._process = process
        self._field = FieldProcess(process)
        self._chance_m2ps2 = expected_change_variance_m2ps2(process)
        self._members: dict[str, _Member] = {}
        self._evaluated_s = -math.inf
        self._terrain_share = 0.0
        self.front: WindFront | None = None
        """The current front, while it may be on the site."""

    def set_terrain_share(self, terrain_share: float) -> None:
        """Set the terrain effect over the mean wind."""
        self._terrain_share = min(terrain_share, MAX_TERRAIN_SHARE)

    def add_report_and_update_front(self, report: MemberWindReport) -> FrontUpdate | None:
        """Process a report. Returns a front that is new, better estimated or withdrawn, or None."""
        if report.rejection_reason_or_empty():
            return None
        detection = self._update_member_wind_change(report)
        if self.front is not None and report.t_s - self.front.detected_s > FRONT_LIFETIME_S:
            self.front = None
        if self.front is not None and self._recompute_odds_and_check_refutation(
            self.front, report.t_s
        ):
            withdrawn, self.front = FrontWithdrawn(self.front, report.t_s), None
            return withdrawn
        if detection is None or detection.square < SUSPECT_SQUARE:
            return None
        if self.front is not None:
            return self._correct_front_if_confirmed(self.front, detection)
        if detection.t_s - self._evaluated_s < EVALUATION_INTERVAL_S - 0.05:
            return None
        self._evaluated_s = detection.t_s
        return self._detect_and_store_new_front(detection)

    def _update_member_wind_change(self, report: MemberWindReport) -> WindChange | None:
        """Return the change of wind at the member; None if unknown."""
        known = self._members.setdefault(report.member, _Member())
        before_s = known.reports[-1].t_s if known.reports else report.t_s
        if known.reports and report.t_s <= before_s:
            return None
        change = known.store_report_and_get_wind_change(report)
        if change is None:
            return None
        north, east = change
        scale = self._process.variance_scale(
            math.hypot(report.mean_to_ne_mps[0] - north, report.mean_to_ne_mps[1] - east)
        )
        reported = 0.5 * sum(report.conservative_variance_ne_m2ps2)
        square = (north**2 + east**2) / (scale * self._chance_m2ps2 + reported)
        known.update_gustiness(square, min(report.t_s - before_s, BEFORE_S))
        known.latest_change = WindChange(
            report.member,
            report.t_s,
            report.position_ne_m,
            change,
            report.mean_to_ne_mps,
            square / self._gustiness_ratio_to_process,
        )
        return known.latest_change

    @property
    def _gustiness_ratio_to_process(self) -> float:
        """Ratio of the actual mean square change to the process's, at least 1."""
        squares = [one.square for one in self._members.values()]
        return max(sum(squares) / len(squares) / NOMINAL_SQUARE, 1.0)

    def _detect_and_store_new_front(self, detection: WindChange) -> WindFront | None:
        """Return a new front if the members nearby indicate one."""
        members = self._nearest_reporting_members(detection.position_ne_m, detection.t_s)
        odds = self._compute_odds_of_members(members, detection.position_ne_m, detection.t_s)
        if odds is None or odds.log_odds < LOG_ODDS:
            return None
        if odds.log_odds < odds.single_member_log_odds - SINGLE_MEMBER_LOG_ODDS:
            return None
        changes = [one.latest_change for one in members if one.latest_change is not None]
        front_change = odds.change_ne_mps
        first = max(changes, key=lambda one: np.dot(one.change_ne_mps, front_change))
        self.front = _front_from_odds(odds, replace(first, t_s=detection.t_s))
        return self.front

    def _recompute_odds_and_check_refutation(self, front: WindFront, now_s: float) -> bool:
        """Return whether the reports since the detection contradict the front."""
        first, *others = front.detections
        if len(others) >= CONFIRMING_MEMBERS or now_s - front.detected_s > WITHDRAWAL_PERIOD_S:
            return False
        if now_s - self._evaluated_s < EVALUATION_INTERVAL_S - 0.05:
            return False
        self._evaluated_s = now_s
        position = first.position_ne_m
        odds = self._compute_odds_of_members(
            self._nearest_reporting_members(position, now_s), position, now_s
        )
        return odds is not None and odds.log_odds < WITHDRAWN_LOG_ODDS

    def _compute_odds_of_members(
        self, members: Sequence[_Member], position_ne_m: tuple[float, float], now_s: float
    ) -> FrontOdds | None:
        reported = [tuple(one.reports) for one in members]
        return compute_front_odds(
            reported,
            position_ne_m,
            now_s,
            self._field,
            self._gustiness_ratio_to_process,
            self._terrain_share,
        )

    def _nearest_reporting_members(
        self, position_ne_m: tuple[float, float], now_s: float
    ) -> list[_Member]:
        """Return the nearest members with a recent report."""
        reporting = (
            one
            for one in self._members.values()
            if one.reports and now_s - one.reports[-1].t_s <= MAX_REPORT_AGE_S
        )
        return nsmallest(
            MAX_MEMBERS,
            reporting,
            key=lambda one: math.dist(one.reports[-1].position_ne_m, position_ne_m),
        )

    def _correct_front_if_confirmed(
        self, current_front: WindFront, detection: WindChange
    ) -> WindFront | None:
        if (
            detection.square < CONFIRMATION_SQUARE
            or detection.magnitude_mps < CONFIRMATION_MPS
            or not _have_similar_directions(current_front.detections[0], detection)
        ):
            return None
        if any(one.member == detection.member for one in current_front.detections):
            return None
        self.front = current_front.updated_with(detection)
        return self.front


def _front_from_odds(odds: FrontOdds, detection: WindChange) -> WindFront:
    """Return the accepted front with its strongest detection."""
    before = np.subtract(detection.wind_ne_mps, detection.change_ne_mps)
    north, east = before + odds.change_ne_mps
    first = replace(
        detection, change_ne_mps=odds.change_ne_mps, wind_ne_mps=(float(north), float(east))
    )
    return WindFront(
        detection.t_s, (first,), odds.origin_ne_m, odds.t0_s, odds.slowness_spm, odds.cov
    )


def _have_similar_directions(first_change: WindChange, second_change: WindChange) -> bool:
    """Return whether two changes have similar directions."""
    (n0, e0), (n1, e1) = first_change.change_ne_mps, second_change.change_ne_mps
    return (
        n0 * n1 + e0 * e1
        >= CONFIRMATION_COS * first_change.magnitude_mps * second_change.magnitude_mps
    )


def expected_change_variance_m2ps2(process: WindProcessParams) -> float:
    """Return the variance of a 10 s mean less the mean of the minute before, by the process at its
    reference wind, per axis."""
    ages = np.concatenate([[0.0], np.arange(GAP_S, GAP_S + BEFORE_S, REPORT_AVERAGING_S)])
    weight = np.array([1.0, *np.full(ages.size - 1, -1.0 / (ages.size - 1))])
    # E[(sum w x)^2] = -1/2 sum w_i w_j E[(x_i - x_j)^2] for weights that sum to zero
    moved = process.mean_squared_change_m2ps2(
        np.abs(np.subtract.outer(ages, ages)), REPORT_AVERAGING_S
    )
    return float(-0.5 * weight @ moved @ weight)
