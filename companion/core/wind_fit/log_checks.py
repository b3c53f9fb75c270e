"""What is wrong with a wind recording, by row, and what of it can be used.

Samples that cannot be trusted are left out, never mended: a gap costs a process that is fitted to
the rest nothing but its length.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.base.geo import wrap_pi

GREATEST_WIND_MPS = 75.0  # [WMO] the strongest 10-minute winds near the ground; beyond: units
_SLOWEST_STEP_S = 5.0  # two samples in each 10 s mean
_STUCK_S = 60.0  # the very same reading for so long is a vane or a cup that froze
_FLIP_RAD = math.radians(140.0)
_FLIP_SAMPLES = 2
_FLIP_WINDOW_S = 15.0
_FLIP_LEAST_MPS = 2.0  # a vane in lighter air goes anywhere
_FLIP_SPEED_FRAC = 0.35
_RADIANS_LEAST = 100  # samples that never point beyond 2 pi before degrees are doubted
_NAMED_MOST = 5  # findings of one kind that are named one by one


@dataclass(frozen=True, slots=True)
class Samples:
    """Rows of a file that are numbers: line in the file, time s, speed m/s, where from in rad."""

    line: Ints
    t_s: Floats
    speed_mps: Floats
    from_rad: Floats

    def kept(self, which: Bools) -> "Samples":
        return Samples(
            self.line[which], self.t_s[which], self.speed_mps[which], self.from_rad[which]
        )

    @property
    def wind_to_ne_mps(self) -> Floats:
        """Where the air moves to, (n, 2)."""
        north = -self.speed_mps * np.cos(self.from_rad)
        return np.stack([north, -self.speed_mps * np.sin(self.from_rad)], axis=1)


@dataclass(frozen=True, slots=True)
class Checked:
    """Runs of samples between gaps and clock jumps, and what was found, in words with rows."""

    runs: tuple[Samples, ...]
    findings: tuple[str, ...]


def checked(samples: Samples, findings: tuple[str, ...] = ()) -> Checked:
    """The samples that can be used, in runs of rising time.

    Raises LeewayError where the units cannot be those of the columns' names.
    """
    said = list(findings)
    _refuse_units(samples)
    samples = _within_range(samples, said)
    runs: list[Samples] = []
    for stretch in _at_clock_jumps(samples, said):
        one = _without_repeats(stretch, said)
        one = _without_stuck(one, said)
        one = _without_turned(one, said)
        runs += _at_gaps(one, said)
    return Checked(tuple(runs), tuple(said))


def _refuse_units(samples: Samples) -> None:
    if samples.t_s.size < 2:
        raise LeewayError(f"{samples.t_s.size} rows of numbers: expected a recording")
    step_s = float(np.median(np.abs(np.diff(samples.t_s))))
    if step_s > _SLOWEST_STEP_S:
        raise LeewayError(
            f"t_s steps by {step_s:g}: expected at most {_SLOWEST_STEP_S:g} s (milliseconds?)"
        )
    speed = samples.speed_mps
    if float(np.median(speed)) > 0.5 * GREATEST_WIND_MPS:
        raise LeewayError(
            f"wind_speed_mps is {np.median(speed):g} in the middle: expected m/s (km/h? cm/s?)"
        )
    degrees = np.degrees(samples.from_rad)
    many = degrees.size >= _RADIANS_LEAST and float(speed.mean()) > _FLIP_LEAST_MPS
    if many and float(np.abs(degrees).max()) <= 2.0 * math.pi and np.unique(degrees).size > 20:
        raise LeewayError(
            f"wind_from_deg is never over {np.abs(degrees).max():.2f}: expected degrees (radians?)"
        )


def _within_range(samples: Samples, said: list[str]) -> Samples:
    degrees = np.degrees(samples.from_rad)
    fast = (samples.speed_mps < 0.0) | (samples.speed_mps > GREATEST_WIND_MPS)
    off = (degrees < -1e-9) | (degrees > 360.0 + 1e-9)
    _name(said, samples.line[fast], f"wind_speed_mps outside 0 to {GREATEST_WIND_MPS:g}: left out")
    _name(said, samples.line[off], "wind_from_deg outside 0 to 360: left out")
    return samples.kept(~(fast | off))


def _at_clock_jumps(samples: Samples, said: list[str]) -> list[Samples]:
    """Time that falls begins a run of its own: a clock that was set, or a file that was joined."""
    back = np.flatnonzero(np.diff(samples.t_s) < 0.0) + 1
    for i in back:
        said.append(
            f"line {samples.line[i]}: t_s goes back from {samples.t_s[i - 1]:g} to"
            f" {samples.t_s[i]:g}: a recording of its own from here"
        )
    edges = [0, *back.tolist(), samples.t_s.size]
    whole = np.arange(samples.t_s.size)
    return [samples.kept((whole >= a) & (whole < b)) for a, b in itertools.pairwise(edges)]


def _without_repeats(samples: Samples, said: list[str]) -> Samples:
    repeat = np.zeros(samples.t_s.size, bool)
    repeat[1:] = np.diff(samples.t_s) <= 0.0
    _name(said, samples.line[repeat], "t_s repeats: left out")
    return samples.kept(~repeat)


def _without_stuck(samples: Samples, said: list[str]) -> Samples:
    """Long runs of one and the same reading."""
    if samples.t_s.size < 2:
        return samples
    change = (np.diff(samples.speed_mps) != 0.0) | (np.diff(samples.from_rad) != 0.0)
    edges = [0, *(np.flatnonzero(change) + 1).tolist(), samples.t_s.size]
    keep = np.ones(samples.t_s.size, bool)
    for a, b in itertools.pairwise(edges):
        if samples.t_s[b - 1] - samples.t_s[a] >= _STUCK_S:
            keep[a:b] = False
            said.append(
                f"lines {samples.line[a]} to {samples.line[b - 1]}: the same reading for"
                f" {samples.t_s[b - 1] - samples.t_s[a]:.0f} s (stuck?): left out"
            )
    return samples.kept(keep)


def _without_turned(samples: Samples, said: list[str]) -> Samples:
    """Leave out stretches in which the station's direction is turned by half a circle.

    A flip is a turn of about 180 degrees within two samples, while the speed stays and the
    directions before and after it hold for a while: air does not do that. Of the two senses, the
    one of less of the recording is taken for the turned one.
    """
    flips = _flips(samples)
    if not flips:
        return samples
    sense = np.zeros(samples.t_s.size, np.int64)
    for i in flips:
        sense[i:] = 1 - sense[i:]
    turned = sense == (1 if 2 * int(sense.sum()) <= sense.size else 0)
    edges = np.flatnonzero(np.diff(turned.astype(np.int64))) + 1
    for part in np.split(np.arange(turned.size), edges):
        if part.size and turned[part[0]]:
            a, b = int(part[0]), int(part[-1])
            said.append(
                f"lines {samples.line[a]} to {samples.line[b]}: direction turned by half a circle"
                f" at once, for {samples.t_s[b] - samples.t_s[a]:.0f} s: left out"
            )
    return samples.kept(~turned)


def _flips(samples: Samples) -> list[int]:
    """Indices of the first sample after each flip."""
    n = samples.t_s.size
    if n <= _FLIP_SAMPLES:
        return []
    step_s = float(np.median(np.diff(samples.t_s)))
    turn = np.abs(wrap_pi(samples.from_rad[_FLIP_SAMPLES:] - samples.from_rad[:-_FLIP_SAMPLES]))
    flips: list[int] = []
    window = max(round(_FLIP_WINDOW_S / step_s), 3)
    for k in np.flatnonzero(turn >= _FLIP_RAD):
        i = int(k) + 1 if _beyond(samples, int(k), int(k) + 1) else int(k) + _FLIP_SAMPLES
        if flips and i - flips[-1] < window:
            continue
        if _is_flip(samples, i, window):
            flips.append(i)
    return flips


def _beyond(samples: Samples, a: int, b: int) -> bool:
    return bool(abs(wrap_pi(samples.from_rad[b] - samples.from_rad[a])) >= 0.5 * _FLIP_RAD)


def _is_flip(samples: Samples, i: int, window: int) -> bool:
    """Whether the means before and after sample i point opposite ways at about one speed."""
    wind = samples.wind_to_ne_mps
    before, after = wind[max(i - window, 0) : i], wind[i : i + window]
    if min(len(before), len(after)) < 3:
        return False
    if samples.t_s[i] - samples.t_s[i - 1] > _FLIP_WINDOW_S:  # after a gap the wind may have turned
        return False
    a, b = before.mean(axis=0), after.mean(axis=0)
    speed_a, speed_b = math.hypot(*a), math.hypot(*b)
    if min(speed_a, speed_b) < _FLIP_LEAST_MPS:
        return False
    opposed = float(a @ b) / (speed_a * speed_b) <= math.cos(_FLIP_RAD)
    return opposed and abs(speed_a - speed_b) <= _FLIP_SPEED_FRAC * max(speed_a, speed_b)


def _at_gaps(samples: Samples, said: list[str]) -> list[Samples]:
    """Runs without a gap of more than five steps and two seconds."""
    if samples.t_s.size < 2:
        return []
    steps = np.diff(samples.t_s)
    wide = np.flatnonzero(steps > max(5.0 * float(np.median(steps)), 2.0)) + 1
    gaps = [f"line {samples.line[i]}: {steps[i - 1]:g} s without a sample" for i in wide]
    said += gaps[:_NAMED_MOST]
    if len(gaps) > _NAMED_MOST:
        said.append(f"and {len(gaps) - _NAMED_MOST} more gaps")
    return [
        Samples(*(np.split(column, wide)[k] for column in _columns(samples)))
        for k in range(wide.size + 1)
    ]


def _columns(samples: Samples) -> tuple[NDArray, ...]:
    return samples.line, samples.t_s, samples.speed_mps, samples.from_rad


def _name(said: list[str], lines: Ints, words: str) -> None:
    if lines.size:
        first = ", ".join(str(n) for n in lines[:_NAMED_MOST])
        more = f" and {lines.size - _NAMED_MOST} more" if lines.size > _NAMED_MOST else ""
        said.append(f"line{'s' if lines.size > 1 else ''} {first}{more}: {words}")
