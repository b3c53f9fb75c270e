"""Validation of a wind recording: findings by row, and the usable samples.

Invalid samples are excluded and not corrected: a gap only reduces the amount of data for the fit.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.base.geo import wrap_pi

MAX_WIND_MPS = 75.0  # [WMO] the strongest 10-minute winds near the ground; beyond: units
_MAX_STEP_S = 5.0  # two samples in each 10 s mean
_STUCK_S = 60.0  # an identical reading for this time: a frozen vane or cup
_FLIP_RAD = math.radians(140.0)
_FLIP_SAMPLES = 2
_FLIP_WINDOW_S = 15.0
_MIN_FLIP_SPEED_MPS = 2.0  # in lighter wind the direction is random
_FLIP_SPEED_FRAC = 0.35
_MIN_UNIT_CHECK_SAMPLES = 100  # samples within 2 pi that indicate radians
_MAX_LISTING = 5  # findings of one kind that are listed individually


@dataclass(frozen=True, slots=True)
class Samples:
    """Numeric rows of a file: line number, time s, speed m/s, direction from in rad."""

    line: Ints
    t_s: Floats
    speed_mps: Floats
    from_rad: Floats

    def select(self, mask: Bools) -> "Samples":
        return Samples(self.line[mask], self.t_s[mask], self.speed_mps[mask], self.from_rad[mask])

    @property
    def wind_to_ne_mps(self) -> Floats:
        """Wind vector (direction to), north and east, (n, 2)."""
        north = -self.speed_mps * np.cos(self.from_rad)
        return np.stack([north, -self.speed_mps * np.sin(self.from_rad)], axis=1)


@dataclass(frozen=True, slots=True)
class CheckedRecording:
    """Continuous runs of samples between gaps and clock jumps, and findings as text."""

    segments: tuple[Samples, ...]
    findings: tuple[str, ...]


def split_into_usable_segments(
    samples: Samples, findings: tuple[str, ...] = ()
) -> CheckedRecording:
    """Return the usable samples, in runs of increasing time.

    Raises LeewayError for values that contradict the units of the column names.
    """
    messages = list(findings)
    _raise_if_units_implausible(samples)
    samples = _exclude_out_of_range(samples, messages)
    continuous_segments: list[Samples] = []
    for stretch in _split_at_clock_jumps(samples, messages):
        one = _exclude_repeated_times(stretch, messages)
        one = _exclude_constant_readings(one, messages)
        one = _exclude_reversed_directions(one, messages)
        continuous_segments += _split_at_gaps(one, messages)
    return CheckedRecording(tuple(continuous_segments), tuple(messages))


def _raise_if_units_implausible(samples: Samples) -> None:
    if samples.t_s.size < 2:
        raise LeewayError(f"{samples.t_s.size} rows of numbers: expected a recording")
    step_s = float(np.median(np.abs(np.diff(samples.t_s))))
    if step_s > _MAX_STEP_S:
        raise LeewayError(
            f"t_s steps by {step_s:g}: expected at most {_MAX_STEP_S:g} s (milliseconds?)"
        )
    speed = samples.speed_mps
    if float(np.median(speed)) > 0.5 * MAX_WIND_MPS:
        raise LeewayError(
            f"wind_speed_mps is {np.median(speed):g} in the middle: expected m/s (km/h? cm/s?)"
        )
    degrees = np.degrees(samples.from_rad)
    many = degrees.size >= _MIN_UNIT_CHECK_SAMPLES and float(speed.mean()) > _MIN_FLIP_SPEED_MPS
    if many and float(np.abs(degrees).max()) <= 2.0 * math.pi and np.unique(degrees).size > 20:
        raise LeewayError(
            f"wind_from_deg is never over {np.abs(degrees).max():.2f}: expected degrees (radians?)"
        )


def _exclude_out_of_range(samples: Samples, messages: list[str]) -> Samples:
    degrees = np.degrees(samples.from_rad)
    fast = (samples.speed_mps < 0.0) | (samples.speed_mps > MAX_WIND_MPS)
    off = (degrees < -1e-9) | (degrees > 360.0 + 1e-9)
    _append_line_message(
        messages, samples.line[fast], f"wind_speed_mps outside 0 to {MAX_WIND_MPS:g}: left out"
    )
    _append_line_message(messages, samples.line[off], "wind_from_deg outside 0 to 360: left out")
    return samples.select(~(fast | off))


def _split_at_clock_jumps(samples: Samples, messages: list[str]) -> list[Samples]:
    """Split at each decrease of time: a clock change, or concatenated files."""
    back = np.flatnonzero(np.diff(samples.t_s) < 0.0) + 1
    for i in back:
        messages.append(
            f"line {samples.line[i]}: t_s goes back from {samples.t_s[i - 1]:g} to"
            f" {samples.t_s[i]:g}: new recording from here"
        )
    edges = [0, *back.tolist(), samples.t_s.size]
    whole = np.arange(samples.t_s.size)
    return [samples.select((whole >= a) & (whole < b)) for a, b in itertools.pairwise(edges)]


def _exclude_repeated_times(samples: Samples, messages: list[str]) -> Samples:
    repeat = np.zeros(samples.t_s.size, bool)
    repeat[1:] = np.diff(samples.t_s) <= 0.0
    _append_line_message(messages, samples.line[repeat], "t_s repeats: left out")
    return samples.select(~repeat)


def _exclude_constant_readings(samples: Samples, messages: list[str]) -> Samples:
    """Exclude long runs of an identical reading."""
    if samples.t_s.size < 2:
        return samples
    change = (np.diff(samples.speed_mps) != 0.0) | (np.diff(samples.from_rad) != 0.0)
    edges = [0, *(np.flatnonzero(change) + 1).tolist(), samples.t_s.size]
    keep = np.ones(samples.t_s.size, bool)
    for a, b in itertools.pairwise(edges):
        if samples.t_s[b - 1] - samples.t_s[a] >= _STUCK_S:
            keep[a:b] = False
            messages.append(
                f"lines {samples.line[a]} to {samples.line[b - 1]}: the same reading for"
                f" {samples.t_s[b - 1] - samples.t_s[a]:.0f} s (stuck?): left out"
            )
    return samples.select(keep)


def _exclude_reversed_directions(samples: Samples, messages: list[str]) -> Samples:
    """Exclude intervals in which the station's direction is reversed by about 180 degrees.

    A flip is a change of about 180 degrees within two samples at constant speed, with a steady
    direction before and after it: real wind does not change so. Of the two orientations, the less
    frequent one counts as reversed.
    """
    flips = _direction_flip_indices(samples)
    if not flips:
        return samples
    orientation = np.zeros(samples.t_s.size, np.int64)
    for i in flips:
        orientation[i:] = 1 - orientation[i:]
    is_reversed = orientation == (1 if 2 * int(orientation.sum()) <= orientation.size else 0)
    edges = np.flatnonzero(np.diff(is_reversed.astype(np.int64))) + 1
    for part in np.split(np.arange(is_reversed.size), edges):
        if part.size and is_reversed[part[0]]:
            a, b = int(part[0]), int(part[-1])
            messages.append(
                f"lines {samples.line[a]} to {samples.line[b]}: direction turned by half a circle"
                f" at once, for {samples.t_s[b] - samples.t_s[a]:.0f} s: left out"
            )
    return samples.select(~is_reversed)


def _direction_flip_indices(samples: Samples) -> list[int]:
    """Return the indices of the first sample after each flip."""
    n = samples.t_s.size
    if n <= _FLIP_SAMPLES:
        return []
    step_s = float(np.median(np.diff(samples.t_s)))
    turn = np.abs(wrap_pi(samples.from_rad[_FLIP_SAMPLES:] - samples.from_rad[:-_FLIP_SAMPLES]))
    flips: list[int] = []
    window = max(round(_FLIP_WINDOW_S / step_s), 3)
    for k in np.flatnonzero(turn >= _FLIP_RAD):
        first_turn = abs(wrap_pi(samples.from_rad[k + 1] - samples.from_rad[k]))
        i = int(k) + (1 if first_turn >= 0.5 * _FLIP_RAD else _FLIP_SAMPLES)
        if flips and i - flips[-1] < window:
            continue
        if _is_direction_flip(samples, i, window):
            flips.append(i)
    return flips


def _is_direction_flip(samples: Samples, sample_index: int, window_samples: int) -> bool:
    """Return whether the means before and after sample i are opposite at about equal speed."""
    wind = samples.wind_to_ne_mps
    before, after = (
        wind[max(sample_index - window_samples, 0) : sample_index],
        wind[sample_index : sample_index + window_samples],
    )
    if min(len(before), len(after)) < 3:
        return False
    if (
        samples.t_s[sample_index] - samples.t_s[sample_index - 1] > _FLIP_WINDOW_S
    ):  # after a gap the wind may differ
        return False
    a, b = before.mean(axis=0), after.mean(axis=0)
    speed_a, speed_b = math.hypot(*a), math.hypot(*b)
    if min(speed_a, speed_b) < _MIN_FLIP_SPEED_MPS:
        return False
    opposed = float(a @ b) / (speed_a * speed_b) <= math.cos(_FLIP_RAD)
    return opposed and abs(speed_a - speed_b) <= _FLIP_SPEED_FRAC * max(speed_a, speed_b)


def _split_at_gaps(samples: Samples, messages: list[str]) -> list[Samples]:
    """Split into runs without a gap of more than five steps and two seconds."""
    if samples.t_s.size < 2:
        return []
    steps = np.diff(samples.t_s)
    wide = np.flatnonzero(steps > max(5.0 * float(np.median(steps)), 2.0)) + 1
    gaps = [f"line {samples.line[i]}: {steps[i - 1]:g} s without a sample" for i in wide]
    messages += gaps[:_MAX_LISTING]
    if len(gaps) > _MAX_LISTING:
        messages.append(f"and {len(gaps) - _MAX_LISTING} more gaps")
    return [
        Samples(*(np.split(column, wide)[k] for column in _columns(samples)))
        for k in range(wide.size + 1)
    ]


def _columns(samples: Samples) -> tuple[NDArray, ...]:
    return samples.line, samples.t_s, samples.speed_mps, samples.from_rad


def _append_line_message(messages: list[str], lines: Ints, message_text: str) -> None:
    if lines.size:
        first = ", ".join(str(n) for n in lines[:_MAX_LISTING])
        more = f" and {lines.size - _MAX_LISTING} more" if lines.size > _MAX_LISTING else ""
        messages.append(f"line{'s' if lines.size > 1 else ''} {first}{more}: {message_text}")
