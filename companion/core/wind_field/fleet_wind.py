"""One vehicle's estimate of the wind field, from its own wind and the reports that a desk forwards.

Reports may be false, constant or late, or stop. They are therefore used only while they agree with
the vehicle's own wind; in doubt the own wind alone is used, and this module returns no field.

- Implausible, old, too fast and constant reports have no effect, and members that contradict all
  others are excluded (`wind_reports`, `agreement`).
- All others together are compared with the own wind, over 15 minutes and over the last minute
  (`FieldEstimate.chi_square_of_member_against_others`). A contradiction may be a front that has not
  arrived here, or false reports: the own wind is used until the two have agreed for a minute.
"""

import math
from collections.abc import Iterable

from companion.core.wind_field.field_estimator import FieldEstimator
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.fronts import WindFront
from companion.core.wind_field.settled_field import FieldEstimate
from companion.core.wind_field.wind_reports import MemberWindReport

OWN = "(own)"
"""Name of the vehicle itself; not a valid member name."""

SILENT_S = 25.0
"""Messages arrive every 10 s: two are missing."""

CONTRADICTION_SQUARE = 9.21
"""Exceeded by chance once in a hundred times (chi-square of two degrees) if the process holds."""

CONSISTENT_S = 60.0
UPDATE_INTERVAL_S = 1.0
"""Minimum interval between estimates: the gate's rate."""

MAX_FRONT_S = 900.0
"""Longest time that a front needs to reach a site."""


class FleetWind:
    """Combines the vehicle's own wind and the others' reports, on the vehicle's clock."""

    def __init__(self, process: FieldProcess) -> None:
        self._process = process
        self.discard_all_reports_and_field()

    def discard_all_reports_and_field(self) -> None:
        """Reset everything, the own wind included."""
        self._estimator = FieldEstimator(self._process)
        self._own: MemberWindReport | None = None
        self._received_s: float | None = None
        self._contradicted_s: float | None = None
        self._front: WindFront | None = None
        self._field: FieldEstimate | None = None
        self._evaluated_s: float | None = None
        self.rejected: dict[str, str] = {}
        """Members whose latest report was rejected, with the reason."""
        self.unused_reason = ""
        """Reason why the fleet's reports are not used now; empty: used, or none received."""

    def add_own_estimate(self, own_report: MemberWindReport) -> None:
        """Add the vehicle's own wind estimate, at any rate."""
        if self._own is not None and own_report.t_s < self._own.t_s - UPDATE_INTERVAL_S:
            self.discard_all_reports_and_field()  # the clock went back
        self._own = own_report
        self._estimator.add_report_or_rejection_reason(own_report, own_report.t_s)

    def add_reports_and_front_of_desk(
        self, reports: Iterable[MemberWindReport], front: WindFront | None, now_s: float
    ) -> None:
        """Add the desk's reports of the others; `front`: a new or better estimated front."""
        self._received_s = now_s
        self.rejected = {}
        for one in reports:
            if one.member != OWN and (
                reason := self._estimator.add_report_or_rejection_reason(one, now_s)
            ):
                self.rejected[one.member] = reason
        if front is not None:
            self._front = front

    def discard_front_and_return_if_expected(self) -> bool:
        """Discard the reported front. Returns True if one was expected."""
        expected, self._front = self._front is not None, None
        return expected

    def joint_field_or_none(self, now_s: float) -> FieldEstimate | None:
        """Return the joint field; None: use the own wind alone (reason in `unused_reason`)."""
        if self._received_s is None or self._own is None:
            return None
        if (
            self._evaluated_s is None
            or not 0.0 <= now_s - self._evaluated_s < UPDATE_INTERVAL_S - 1e-6
        ):
            self._field, self._evaluated_s = (
                self._estimate_field_and_set_unused_reason(now_s),
                now_s,
            )
        return self._field

    def expected_front_after_dropping_expired(
        self, now_s: float, position_ne_m: tuple[float, float]
    ) -> WindFront | None:
        """Return a front that may still arrive at a position, or None."""
        front = self._front
        if front is None:
            return None
        due_s, std_s = front.arrival_time_and_std_s(position_ne_m)
        if now_s > due_s + 2.0 * std_s or now_s - front.detected_s > MAX_FRONT_S:
            self._front = None
        return self._front

    def _estimate_field_and_set_unused_reason(self, now_s: float) -> FieldEstimate | None:
        assert self._received_s is not None
        silent_s = now_s - self._received_s
        if silent_s > SILENT_S:
            self.unused_reason = "silent"
            self._contradicted_s = None  # a desk that returns is checked like a new one
            return None
        settled = self._estimator.prune_learn_and_estimate_field(
            now_s, OWN, newest_report_not_stored=self._own
        )
        others = [name for name in settled.accepted_members if name != OWN]
        square = settled.chi_square_of_member_against_others(OWN)
        if not others:
            self.unused_reason = "no other member accepted"
        elif square is None:
            self.unused_reason = "too few own wind estimates to compare"
        elif square > CONTRADICTION_SQUARE:
            self.unused_reason, self._contradicted_s = "contradicts own wind", now_s
        elif self._contradicted_s is not None and now_s - self._contradicted_s < CONSISTENT_S:
            self.unused_reason = "contradicted own wind within the last minute"
        else:
            self.unused_reason = ""
            return settled
        return None


def other_member_count_text(field_estimate: FieldEstimate) -> str:
    """Return the number of accepted other members as text."""
    count = sum(name != OWN for name in field_estimate.accepted_members)
    return "1 other" if count == 1 else f"{count} others"


def wind_speed_and_origin_text(to_ne_mps: tuple[float, float]) -> str:
    """Return a wind as text: speed and the direction it blows from."""
    north, east = to_ne_mps
    from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
    return f"{math.hypot(north, east):.1f} m/s from {from_deg:.0f}"
