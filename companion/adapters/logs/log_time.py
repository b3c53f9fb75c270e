"""A log's time stamps made to run forward: stray stamps left out, gaps and steps said."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.adapters.clock import AutopilotClock
from companion.core.base.arrays import Floats
from companion.core.replay.recorded_flight import LogFinding

LEAP_S = 2.0
"""A step of more than this (or of twenty usual ones) between two stamps is a gap or a jump."""

LATE_S = 1.0
"""Stamps up to this much older than the newest are late rows, not a clock that was set back."""

LONGEST_S = 86_400.0
"""No delivery drone flies for a day, and no log of one is longer."""

WITNESSES = 3
"""Consecutive stamps that must agree on a jump: one wild stamp moves nothing (as in flight)."""


def rising_rows(stamps_s: Floats) -> NDArray[np.intp]:
    """Rows of the longest subsequence that never falls: a stray stamp costs its own row only.

    Patience sorting (Fredman 1975), n log n. Of a clock that is set back it keeps the longer part.
    """
    if not (np.diff(stamps_s) < 0.0).any():
        return np.arange(stamps_s.size)
    tops: list[float] = []
    rows: list[int] = []
    before: list[int] = []
    for row, stamp_s in enumerate(stamps_s.tolist()):
        place = bisect_right(tops, stamp_s)
        before.append(rows[place - 1] if place else -1)
        tops[place : place + 1], rows[place : place + 1] = [stamp_s], [row]
    kept = [rows[-1]]
    while before[kept[-1]] >= 0:
        kept.append(before[kept[-1]])
    return np.array(kept[::-1])


def stray_stamps(t_s: float, topic: str, row: int, stamp_s: float, count: int) -> LogFinding:
    """The finding of `count` stray stamps in a topic; the first is `row` (from 0), at `t_s`."""
    more = f", and {count - 1} more" if count > 1 else ""
    what = f"{topic}: row {row} has the time stamp {stamp_s:.1f} s, out of order{more}"
    return LogFinding.at(t_s, what, "left out")


class LogClock:
    """Time of a log's messages in the order of the file; steps and stray stamps are findings."""

    def __init__(self) -> None:
        self._clock = AutopilotClock()
        self._findings: list[LogFinding] = []
        self._rows: Counter[str] = Counter()
        self._strays: list[tuple[float, str, int, float]] = []

    @property
    def t_s(self) -> float | None:
        """The newest time; `None` before the first stamp."""
        return self._clock.t_s if self._clock.known else None

    def stamp(self, topic: str, stamp_s: float) -> float | None:
        """Time of the topic's next message; `None` where its stamp is not to be believed."""
        before_s, reading = self._clock.t_s, self._clock.stamp(stamp_s)
        self._rows[topic] += 1
        if reading.t_s is None:
            self._strays.append((before_s, topic, self._rows[topic] - 1, stamp_s))
        if reading.back_s > 0.0 or reading.ahead_s > 0.0:
            del self._strays[1 - WITNESSES :]  # they were the first of the step
            what, done = f"gap of {reading.ahead_s:.1f} s", "what was believed ages meanwhile"
            if reading.back_s > 0.0:
                what = f"the clock goes back by {reading.back_s:.1f} s"
                done = "later times are shifted"
            self._findings.append(LogFinding.at(before_s, what, done))
        return reading.t_s

    def findings(self) -> list[LogFinding]:
        """Steps, and one finding for each topic's stray stamps."""
        of_topic: dict[str, list[tuple[float, str, int, float]]] = {}
        for stray in self._strays:
            of_topic.setdefault(stray[1], []).append(stray)
        return self._findings + [stray_stamps(*of[0], len(of)) for of in of_topic.values()]


@dataclass(frozen=True, slots=True)
class RunningTime:
    """`t_s` (k,) rising, of the rows `kept` (k,); what was wrong is in `findings`."""

    t_s: Floats
    kept: NDArray[np.intp]
    findings: tuple[LogFinding, ...]


def running_time(stamps_s: Floats, where: Callable[[int], str]) -> RunningTime:
    """Return the stamps as a time that only grows.

    A clock that goes back and stays back is laid on from where it was; a leap ahead is a gap.
    Stamps a day from the middle one are none.
    """
    known_s = stamps_s[np.isfinite(stamps_s)]
    middle_s = float(np.median(known_s)) if known_s.size else 0.0
    steps = np.diff(stamps_s)
    rising = steps[steps > 0.0]
    usual_s = float(np.median(rising)) if rising.size else 0.1
    leap_s = max(LEAP_S, 20.0 * usual_s)
    near = np.abs(stamps_s - middle_s) <= LONGEST_S  # NaN and infinities are not
    if bool(near.all() and (steps > 0.0).all() and (steps <= leap_s).all()):
        return RunningTime(stamps_s, np.arange(stamps_s.size), ())
    return _Watch(stamps_s, middle_s, usual_s, leap_s, where).run()


class _Watch:
    """Goes through the stamps once."""

    def __init__(
        self,
        stamps_s: Floats,
        middle_s: float,
        usual_s: float,
        leap_s: float,
        where: Callable[[int], str],
    ) -> None:
        self._stamps = stamps_s.tolist()
        self._middle_s = middle_s
        self._usual_s, self._leap_s, self._where = usual_s, leap_s, where
        self._newest_s: float | None = None
        self._offset_s = 0.0
        self._doubtful: list[int] = []
        self._times: list[float] = []
        self._kept: list[int] = []
        self._left_out: dict[str, list[int]] = {}
        self._findings: list[LogFinding] = []

    def run(self) -> RunningTime:
        for row, stamp_s in enumerate(self._stamps):
            self._take(row, stamp_s)
        for row in self._doubtful:
            self._leave_out("time stamp far from its neighbours", row)
        for what, rows in self._left_out.items():
            self._findings.append(told(rows, self._where, what, "left out"))
        return RunningTime(np.array(self._times), np.array(self._kept, int), tuple(self._findings))

    def _take(self, row: int, stamp_s: float) -> None:
        if stamp_s != stamp_s or stamp_s in (np.inf, -np.inf):
            self._leave_out("no time stamp", row)
            return
        if abs(stamp_s - self._middle_s) > LONGEST_S:
            self._leave_out("time stamp far from its neighbours", row)
            return
        if self._newest_s is None:
            self._accept(row, stamp_s)
            return
        step_s = stamp_s - self._newest_s
        if -LATE_S <= step_s <= self._leap_s:
            for stray in self._doubtful:
                self._leave_out("time stamp far from its neighbours", stray)
            self._doubtful.clear()
            if step_s > 0.0:
                self._accept(row, stamp_s)
            else:
                self._leave_out("time stamp repeated or late", row)
            return
        self._doubt(row, stamp_s)

    def _doubt(self, row: int, stamp_s: float) -> None:
        if self._doubtful and not 0.0 < stamp_s - self._stamps[self._doubtful[-1]] <= self._leap_s:
            for stray in self._doubtful:
                self._leave_out("time stamp far from its neighbours", stray)
            self._doubtful.clear()
        self._doubtful.append(row)
        if len(self._doubtful) == WITNESSES:
            self._step(self._doubtful)
            self._doubtful = []

    def _step(self, rows: list[int]) -> None:
        """Several stamps agree: the clock really stands there now."""
        assert self._newest_s is not None
        first_s = self._stamps[rows[0]]
        step_s = first_s - self._newest_s
        if step_s < 0.0:
            self._offset_s += self._usual_s - step_s
            self._findings.append(
                LogFinding(
                    self._where(rows[0]),
                    f"time goes back by {-step_s:.1f} s (from {self._newest_s:.1f} to"
                    f" {first_s:.1f} s)",
                    f"later times are shifted by {self._offset_s:+.1f} s",
                )
            )
        else:
            self._findings.append(
                LogFinding(
                    self._where(rows[0]),
                    f"gap of {step_s:.1f} s (from {self._newest_s:.1f} to {first_s:.1f} s)",
                    "what was believed ages meanwhile",
                )
            )
        for row in rows:
            self._accept(row, self._stamps[row])

    def _accept(self, row: int, stamp_s: float) -> None:
        self._newest_s = stamp_s
        self._times.append(stamp_s + self._offset_s)
        self._kept.append(row)

    def _leave_out(self, what: str, row: int) -> None:
        self._left_out.setdefault(what, []).append(row)


def told(rows: list[int], where: Callable[[int], str], what: str, done: str) -> LogFinding:
    """Return one finding for what is wrong in many rows, by the first and their number."""
    more = f" and {len(rows) - 1} more" if len(rows) > 1 else ""
    return LogFinding(f"{where(min(rows))}{more}", what, done)
