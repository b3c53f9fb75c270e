"""What the current sensor reads while the vehicle stands with its motors off.

That is what avionics alone draw, as far as the sensor's zero holds. Its error is one for all logs
of one vehicle: many logs tell it no better than one. Where one of them reads less than nothing, the
sensor tells of its zero only: that of an M100 moves between -0.17 and 0.13 A from log to log.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Ints
from companion.core.calibration.records import Blocks, FlightRecord
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

_STANDING_MPS = 0.15
_STANDING_W_FRAC = 0.15
_LEAST_BLOCKS = 3
_LEAST_S = 20.0
_MAD_TO_STD = 1.4826  # of a normal distribution, as is the next
_MEDIAN_OVER_MEAN_STD = 1.2533


@dataclass(frozen=True, slots=True)
class StandingPower:
    """Medians of one log, or their mean over several; `std_w` without the sensor's zero.

    `least_a`: the least current of these logs.
    """

    name: str
    power_w: float
    std_w: float
    voltage_v: float
    least_a: float

    @property
    def current_a(self) -> float:
        """As the sensor reads it."""
        return self.power_w / self.voltage_v

    @property
    def tells_avionics(self) -> bool:
        """Whether no log reads less than nothing."""
        return self.least_a > 0.0


def standing_blocks(blocks: Blocks, airframe: Airframe) -> Ints:
    """Blocks on the ground with the motors off."""
    hover_w = float(multirotor_power_w(airframe, airframe.mass.empty_kg, 0.0))
    speed = np.hypot(np.hypot(blocks.north_mps, blocks.east_mps), blocks.climb_mps)
    still = (speed < _STANDING_MPS) & (blocks.power_w < _STANDING_W_FRAC * hover_w)
    return np.flatnonzero(still & ~blocks.airborne)


def standing_in(blocks: Blocks, airframe: Airframe) -> StandingPower | None:
    """Of one flight's log; None where it has too little of it.

    Medians: motors that spin up or down are in one or two of the blocks.
    """
    at = standing_blocks(blocks, airframe)
    if len(at) < _LEAST_BLOCKS:
        return None
    power_w = blocks.power_w[at]
    middle_w = float(np.median(power_w))
    scatter_w = _MAD_TO_STD * float(np.median(np.abs(power_w - middle_w)))
    std_w = _MEDIAN_OVER_MEAN_STD * scatter_w / math.sqrt(len(at))
    voltage_v = float(np.median(blocks.voltage_v[at]))
    return StandingPower(blocks.name, middle_w, std_w, voltage_v, middle_w / voltage_v)


def ground_test(record: FlightRecord, hover_w: float) -> StandingPower | None:
    """The reading of a log that never leaves the ground; None of any other.

    It lasts 20 s or more, does not move, and draws under a sixth of hover power: avionics alone,
    equipment switched on one after another, or motors that idle.
    """
    known = np.isfinite(record.voltage_v) & np.isfinite(record.current_a)
    moved = np.linalg.norm(record.vel_ned_mps, axis=1)
    moved = moved[np.isfinite(moved)]
    if not known.any() or not len(moved) or record.t_s[-1] - record.t_s[0] < _LEAST_S:
        return None
    power_w = record.voltage_v[known] * record.current_a[known]
    still = float(np.percentile(moved, 95.0)) < _STANDING_MPS
    if not still or float(np.percentile(power_w, 95.0)) > _STANDING_W_FRAC * hover_w:
        return None
    middle_w = float(np.median(power_w))
    std_w = _MEDIAN_OVER_MEAN_STD * float(np.std(power_w)) / math.sqrt(len(power_w))
    voltage_v = float(np.median(record.voltage_v[known]))
    return StandingPower(record.name, middle_w, std_w, voltage_v, middle_w / voltage_v)


def pooled(readings: Sequence[StandingPower]) -> StandingPower | None:
    """One reading of several logs of a vehicle: their mean, and the scatter between them."""
    if not readings:
        return None
    power_w = np.array([one.power_w for one in readings])
    std_w = math.hypot(*(one.std_w for one in readings)) / len(readings)
    if len(readings) > 1:
        std_w = max(std_w, float(np.std(power_w, ddof=1)) / math.sqrt(len(readings)))
    voltage_v = float(np.mean([one.voltage_v for one in readings]))
    name = readings[0].name if len(readings) == 1 else f"{len(readings)} logs"
    least_a = min(one.least_a for one in readings)
    return StandingPower(name, float(power_w.mean()), std_w, voltage_v, least_a)


def least_drawing(tests: Sequence[StandingPower], within_a: float) -> list[StandingPower]:
    """Those ground tests that read as little as the least of them: nothing else was on there."""
    if not tests:
        return []
    least_a = min(one.current_a for one in tests)
    return [one for one in tests if one.current_a - least_a <= within_a]


def told_of(tests: Sequence[StandingPower], within_a: float) -> list[str]:
    """Each ground test in words: its reading, and what it draws beyond the least of them."""
    base = pooled(least_drawing(tests, within_a))
    found = []
    for one in tests:
        words = f"{one.name}: on the ground: {one.current_a:.2f} A, {one.power_w:.1f} W"
        if base is not None and one.current_a - base.current_a > within_a:
            words += f", {one.power_w - base.power_w:.1f} W more than the least"
        found.append(words)
    return found
