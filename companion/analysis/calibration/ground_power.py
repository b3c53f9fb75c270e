"""Power measured on the ground with the motors off.

It equals the draw of avionics if the current sensor's zero is correct. The zero error is common to
all logs of one vehicle, so more logs do not reduce it. A negative reading shows only the zero
error: the zero of an M100 varies between -0.17 and 0.13 A from log to log.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.analysis.calibration.records import Blocks, FlightRecord
from companion.core.base.arrays import Ints
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

_MAX_GROUND_SPEED_MPS = 0.15
_MAX_GROUND_POWER_FRAC = 0.15
_MIN_BLOCKS = 3
_MIN_DURATION_S = 20.0
_MAD_TO_STD = 1.4826  # of a normal distribution, as is the next
_MEDIAN_OVER_MEAN_STD = 1.2533


@dataclass(frozen=True, slots=True)
class StandingPower:
    """Medians of one log, or their mean over several; `std_w` excludes the sensor's zero error.

    `least_a`: the smallest current of these logs.
    """

    name: str
    power_w: float
    std_w: float
    voltage_v: float
    least_a: float

    @property
    def current_a(self) -> float:
        """Current as measured."""
        return self.power_w / self.voltage_v

    @property
    def is_avionics_measurable(self) -> bool:
        """Whether every log has a positive current."""
        return self.least_a > 0.0


def motors_off_block_indices(blocks: Blocks, airframe: Airframe) -> Ints:
    """Return the blocks on the ground with the motors off."""
    hover_w = float(multirotor_power_w(airframe, airframe.mass.empty_kg, 0.0))
    speed = np.hypot(np.hypot(blocks.north_mps, blocks.east_mps), blocks.climb_mps)
    still = (speed < _MAX_GROUND_SPEED_MPS) & (blocks.power_w < _MAX_GROUND_POWER_FRAC * hover_w)
    return np.flatnonzero(still & ~blocks.airborne)


def motors_off_power_before_flight(blocks: Blocks, airframe: Airframe) -> StandingPower | None:
    """Return the reading of one flight's log; None with too few blocks on the ground.

    Medians, because motors spin up or down in one or two of the blocks.
    """
    at = motors_off_block_indices(blocks, airframe)
    if len(at) < _MIN_BLOCKS:
        return None
    power_w = blocks.power_w[at]
    middle_w = float(np.median(power_w))
    scatter_w = _MAD_TO_STD * float(np.median(np.abs(power_w - middle_w)))
    std_w = _MEDIAN_OVER_MEAN_STD * scatter_w / math.sqrt(len(at))
    voltage_v = float(np.median(blocks.voltage_v[at]))
    return StandingPower(blocks.name, middle_w, std_w, voltage_v, middle_w / voltage_v)


def motors_off_power_of_flightless_log(
    record: FlightRecord, hover_w: float
) -> StandingPower | None:
    """Return the reading of a log without a flight; None for any other log.

    Such a log has 20 s or more without motion below a sixth of hover power: avionics alone,
    equipment switched on in steps, or idling motors.
    """
    known = np.isfinite(record.voltage_v) & np.isfinite(record.current_a)
    moved = np.linalg.norm(record.vel_ned_mps, axis=1)
    moved = moved[np.isfinite(moved)]
    if not known.any() or not len(moved) or record.t_s[-1] - record.t_s[0] < _MIN_DURATION_S:
        return None
    power_w = record.voltage_v[known] * record.current_a[known]
    still = float(np.percentile(moved, 95.0)) < _MAX_GROUND_SPEED_MPS
    if not still or float(np.percentile(power_w, 95.0)) > _MAX_GROUND_POWER_FRAC * hover_w:
        return None
    middle_w = float(np.median(power_w))
    std_w = _MEDIAN_OVER_MEAN_STD * float(np.std(power_w)) / math.sqrt(len(power_w))
    voltage_v = float(np.median(record.voltage_v[known]))
    return StandingPower(record.name, middle_w, std_w, voltage_v, middle_w / voltage_v)


def mean_standing_power(readings: Sequence[StandingPower]) -> StandingPower | None:
    """Combine several logs of a vehicle: mean, and scatter between them."""
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


def lowest_current_tests(tests: Sequence[StandingPower], tolerance_a: float) -> list[StandingPower]:
    """Return the ground tests near the smallest current: no other equipment was on."""
    if not tests:
        return []
    least_a = min(one.current_a for one in tests)
    return [one for one in tests if one.current_a - least_a <= tolerance_a]


def describe_ground_tests(tests: Sequence[StandingPower], tolerance_a: float) -> list[str]:
    """Describe each ground test: its reading, and its excess over the smallest."""
    base = mean_standing_power(lowest_current_tests(tests, tolerance_a))
    found = []
    for one in tests:
        words = f"{one.name}: on the ground: {one.current_a:.2f} A, {one.power_w:.1f} W"
        if base is not None and one.current_a - base.current_a > tolerance_a:
            words += f", {one.power_w - base.power_w:.1f} W more than the least"
        found.append(words)
    return found
