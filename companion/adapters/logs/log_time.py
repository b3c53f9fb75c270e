"""Monotonic time for a log's stamps: outliers are removed, gaps and steps are reported."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.adapters.clock import AutopilotClock
from companion.analysis.replay.recorded_flight import LogIssue
from companion.core.base.arrays import Floats

GAP_S = 2.0
"""A larger step between stamps (or one of twenty median steps) is a gap or a jump."""

MAX_LATE_S = 1.0
"""Stamps up to this much older than the newest are late rows, not a step back."""

MAX_DURATION_S = 86_400.0
"""Maximum duration of a log: delivery drones fly less than a day."""

STAMPS_TO_CONFIRM_STEP = 3
"""Consecutive stamps that must agree on a jump: one wrong stamp has no effect (as in flight)."""


def longest_non_decreasing_row_indices(stamps_s: Floats) -> NDArray[np.intp]:
    """Return the rows of the longest non-decreasing subsequence: an outlier costs one row.

    Patience sorting (Fredman 1975), n log n. If the clock steps back, the longer part is kept.
    """
    if not (np.diff(stamps_s) < 0.0).any():
        return np.arange(stamps_s.size)
    tops: list[float] = []
    rows: list[int] = []
    before: list[int] = []
    for row, stamp_s in enumerate(stamps_s.tolist()):
        stack_index = bisect_right(tops, stamp_s)
        before.append(rows[stack_index - 1] if stack_index else -1)
        tops[stack_index : stack_index + 1], rows[stack_index : stack_index + 1] = [stamp_s], [row]
    kept = [rows[-1]]
    while before[kept[-1]] >= 0:
        kept.append(before[kept[-1]])
    return np.array(kept[::-1])


def stamp_outlier_issue(t_s: float, topic: str, row: int, stamp_s: float, count: int) -> LogIssue:
    """Return the finding of `count` outliers in a topic; the first is `row` (from 0), at `t_s`."""
    more = f", and {count - 1} more" if count > 1 else ""
    description = f"{topic}: row {row} has the time stamp {stamp_s:.1f} s, out of order{more}"
    return LogIssue.at_time(t_s, description, "discarded")


class LogClock:
    """Time of a log's messages in file order; steps and outliers become findings."""

    def __init__(self) -> None:
        self._clock = AutopilotClock()
        self._findings: list[LogIssue] = []
        self._rows: Counter[str] = Counter()
        self._outliers: list[tuple[float, str, int, float]] = []

    @property
    def t_s(self) -> float | None:
        """The newest time; `None` before the first stamp."""
        return self._clock.t_s if self._clock.is_known else None

    def update_from_stamp(self, topic: str, stamp_s: float) -> float | None:
        """Return the time of the topic's next message; `None` for an outlier."""
        before_s, reading = self._clock.t_s, self._clock.update_from_boot_time(stamp_s)
        self._rows[topic] += 1
        if reading.t_s is None:
            self._outliers.append((before_s, topic, self._rows[topic] - 1, stamp_s))
        if reading.step_back_s > 0.0 or reading.step_forward_s > 0.0:
            del self._outliers[
                1 - STAMPS_TO_CONFIRM_STEP :
            ]  # these were the first stamps after the step
            description, action = (
                f"gap of {reading.step_forward_s:.1f} s",
                "estimates age during the gap",
            )
            if reading.step_back_s > 0.0:
                description = f"the clock goes back by {reading.step_back_s:.1f} s"
                action = "later times are shifted"
            self._findings.append(LogIssue.at_time(before_s, description, action))
        return reading.t_s

    def clock_issues(self) -> list[LogIssue]:
        """Return the steps, and one finding for each topic's outliers."""
        of_topic: dict[str, list[tuple[float, str, int, float]]] = {}
        for outlier in self._outliers:
            of_topic.setdefault(outlier[1], []).append(outlier)
        return self._findings + [stamp_outlier_issue(*of[0], len(of)) for of in of_topic.values()]


@dataclass(frozen=True, slots=True)
class MonotonicTime:
    """`t_s` (k,) increasing, of the rows `kept` (k,); errors are in `findings`."""

    t_s: Floats
    kept: NDArray[np.intp]
    findings: tuple[LogIssue, ...]


def make_time_monotonic(
    stamps_s: Floats, format_row_location: Callable[[int], str]
) -> MonotonicTime:
    """Return the stamps as an increasing time.

    After a permanent step back, time continues from its last value; a step forward is a gap. Stamps
    over a day from the median are outliers.
    """
    known_s = stamps_s[np.isfinite(stamps_s)]
    middle_s = float(np.median(known_s)) if known_s.size else 0.0
    steps = np.diff(stamps_s)
    rising = steps[steps > 0.0]
    median_step_s = float(np.median(rising)) if rising.size else 0.1
    gap_s = max(GAP_S, 20.0 * median_step_s)
    near = np.abs(stamps_s - middle_s) <= MAX_DURATION_S  # NaN and infinities compare false
    if bool(near.all() and (steps > 0.0).all() and (steps <= gap_s).all()):
        return MonotonicTime(stamps_s, np.arange(stamps_s.size), ())
    return _StampFilter(
        stamps_s, middle_s, median_step_s, gap_s, format_row_location
    ).process_all_stamps()


class _StampFilter:
    """Processes the stamps once, in order."""

    def __init__(
        self,
        stamps_s: Floats,
        median_stamp_s: float,
        median_step_s: float,
        gap_s: float,
        format_row_location: Callable[[int], str],
    ) -> None:
        self._stamps = stamps_s.tolist()
        self._middle_s = median_stamp_s
        self._median_step_s, self._leap_s, self._where = median_step_s, gap_s, format_row_location
        self._newest_s: float | None = None
        self._offset_s = 0.0
        self._unconfirmed: list[int] = []
        self._times: list[float] = []
        self._kept: list[int] = []
        self._removed: dict[str, list[int]] = {}
        self._findings: list[LogIssue] = []

    def process_all_stamps(self) -> MonotonicTime:
        for row, stamp_s in enumerate(self._stamps):
            self._keep_discard_or_defer_stamp(row, stamp_s)
        for row in self._unconfirmed:
            self._record_removed_row("time stamp far from its neighbours", row)
        for description, rows in self._removed.items():
            self._findings.append(
                summarise_rows_as_issue(rows, self._where, description, "discarded")
            )
        return MonotonicTime(
            np.array(self._times), np.array(self._kept, int), tuple(self._findings)
        )

    def _keep_discard_or_defer_stamp(self, row: int, stamp_s: float) -> None:
        if stamp_s != stamp_s or stamp_s in (np.inf, -np.inf):
            self._record_removed_row("no time stamp", row)
            return
        if abs(stamp_s - self._middle_s) > MAX_DURATION_S:
            self._record_removed_row("time stamp far from its neighbours", row)
            return
        if self._newest_s is None:
            self._append_stamp(row, stamp_s)
            return
        step_s = stamp_s - self._newest_s
        if -MAX_LATE_S <= step_s <= self._leap_s:
            for outlier in self._unconfirmed:
                self._record_removed_row("time stamp far from its neighbours", outlier)
            self._unconfirmed.clear()
            if step_s > 0.0:
                self._append_stamp(row, stamp_s)
            else:
                self._record_removed_row("time stamp repeated or late", row)
            return
        self._store_unconfirmed_stamp(row, stamp_s)

    def _store_unconfirmed_stamp(self, row: int, stamp_s: float) -> None:
        if (
            self._unconfirmed
            and not 0.0 < stamp_s - self._stamps[self._unconfirmed[-1]] <= self._leap_s
        ):
            for outlier in self._unconfirmed:
                self._record_removed_row("time stamp far from its neighbours", outlier)
            self._unconfirmed.clear()
        self._unconfirmed.append(row)
        if len(self._unconfirmed) == STAMPS_TO_CONFIRM_STEP:
            self._append_stamps_after_step(self._unconfirmed)
            self._unconfirmed = []

    def _append_stamps_after_step(self, rows: list[int]) -> None:
        """Accept a step that several stamps confirm."""
        assert self._newest_s is not None
        first_s = self._stamps[rows[0]]
        step_s = first_s - self._newest_s
        if step_s < 0.0:
            self._offset_s += self._median_step_s - step_s
            self._findings.append(
                LogIssue(
                    self._where(rows[0]),
                    f"time goes back by {-step_s:.1f} s (from {self._newest_s:.1f} to"
                    f" {first_s:.1f} s)",
                    f"later times are shifted by {self._offset_s:+.1f} s",
                )
            )
        else:
            self._findings.append(
                LogIssue(
                    self._where(rows[0]),
                    f"gap of {step_s:.1f} s (from {self._newest_s:.1f} to {first_s:.1f} s)",
                    "estimates age during the gap",
                )
            )
        for row in rows:
            self._append_stamp(row, self._stamps[row])

    def _append_stamp(self, row: int, stamp_s: float) -> None:
        self._newest_s = stamp_s
        self._times.append(stamp_s + self._offset_s)
        self._kept.append(row)

    def _record_removed_row(self, description: str, row: int) -> None:
        self._removed.setdefault(description, []).append(row)


def summarise_rows_as_issue(
    rows: list[int], format_row_location: Callable[[int], str], description: str, action: str
) -> LogIssue:
    """Return one finding for an error in several rows: the first row and their number."""
    more = f" and {len(rows) - 1} more" if len(rows) > 1 else ""
    return LogIssue(f"{format_row_location(min(rows))}{more}", description, action)
