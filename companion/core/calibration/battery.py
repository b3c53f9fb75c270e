"""The pack from one's own flights: its resistance, and what it gives from full to cut-off.

Resistance from how voltage falls with current at the same charge (Ohm's law; a cubic in the charge
drawn stands for the open-circuit curve). Usable energy from logs that run from a full pack to a low
one: nobody should fly to the cut-off, so the last few per cent come from the believed resting
curve, and count as uncertain. Anything less deep leaves usable energy to belief.
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.calibration.records import BLOCK_S, Blocks
from companion.core.calibration.residual_scatter import clustered_covariance
from companion.core.vehicle.airframe import BatteryPack

_CURVE_TERMS = 4
_FULL_FRAC = 0.95
_LOW_FRAC = 0.15  # of charge: what is left above this is too much to leave to a believed curve
_CURVE_FRAC = 0.3  # [est] how wrong the believed curve may be about what a log did not draw
_OWN_STD_FRAC = 0.005  # [est] of one discharge: how full the pack was, how warm
_END_BLOCKS = 5
_SENSOR_SCALE_STD = 0.02
_RESTING_S = 4.0
_RESTING_FRAC = 0.1  # of the flight's mean current


@dataclass(frozen=True, slots=True)
class Usable:
    """`frac` of the label at `at_w`, less `loss_per_w` for each watt more, from discharges.

    `extrapolated_frac`: the share of the label that no log drew, on average.
    """

    frac: float
    std_frac: float
    at_w: float
    loss_per_w: float
    loss_std_per_w: float
    logs: tuple[str, ...]
    extrapolated_frac: float


@dataclass(frozen=True, slots=True)
class BatteryFit:
    """The pack's resistance; `usable` is None where no log is a deep discharge."""

    resistance_ohm: float
    resistance_std_ohm: float
    usable: Usable | None = None


@dataclass(frozen=True, slots=True)
class _Discharge:
    """One log from full to low: the share of the label that it tells, and its own uncertainty."""

    name: str
    draw_w: float
    frac: float
    own_std_frac: float
    extrapolated_frac: float


def fit_battery(flights: list[Blocks], battery: BatteryPack) -> BatteryFit:
    """Resistance over all flights, usable energy against draw from the deep discharges."""
    ohm, std = _resistance(flights)
    deep = [found for blocks in flights if (found := _discharge(blocks, battery)) is not None]
    return BatteryFit(ohm, std, _usable(deep, battery) if deep else None)


def _usable(deep: list[_Discharge], battery: BatteryPack) -> Usable:
    """Usable energy at the lightest draw and its loss by draw, the believed loss as the prior.

    One vehicle's current sensor is off by one factor in all its flights: it moves the level, and
    the slope by no more than that share of itself.
    """
    at_w = min(d.draw_w for d in deep)
    design = np.array([[1.0, -(d.draw_w - at_w)] for d in deep])
    weight = np.array([d.own_std_frac**-2 for d in deep])
    prior = battery.usable_loss_per_w
    information = (design.T * weight) @ design + np.diag([0.0, prior**-2])
    told = (design.T * weight) @ np.array([d.frac for d in deep]) + np.array([0.0, 1.0 / prior])
    cov = np.linalg.inv(information)
    frac, loss = cov @ told
    return Usable(
        frac=float(frac),
        std_frac=float(np.hypot(np.sqrt(cov[0, 0]), _SENSOR_SCALE_STD * frac)),
        at_w=at_w,
        loss_per_w=max(float(loss), 0.0),
        loss_std_per_w=float(np.hypot(np.sqrt(cov[1, 1]), _SENSOR_SCALE_STD * loss)),
        logs=tuple(d.name for d in deep),
        extrapolated_frac=float(np.mean([d.extrapolated_frac for d in deep])),
    )


def _resistance(flights: list[Blocks]) -> tuple[float, float]:
    """(ohm, its standard deviation), clustered by minutes."""
    columns: list[Floats] = []
    measured, minutes = [], []
    width = _CURVE_TERMS * len(flights)
    for number, b in enumerate(flights):
        drawn = np.cumsum(b.current_a) * BLOCK_S
        share = drawn / max(float(drawn[-1]), 1e-9)
        rows = np.zeros((len(share), width + 1))
        rows[:, number * _CURVE_TERMS : (number + 1) * _CURVE_TERMS] = np.vander(
            share, _CURVE_TERMS
        )
        rows[:, -1] = -b.current_a
        columns.append(rows)
        measured.append(b.voltage_v)
        minutes.append(b.t_s // 60.0 + 10_000.0 * number)
    design, volts, minute = np.vstack(columns), np.concatenate(measured), np.concatenate(minutes)
    solution, *_ = np.linalg.lstsq(design, volts, rcond=None)
    left = volts - design @ solution
    rows = (np.flatnonzero(minute == m) for m in np.unique(minute))
    variance = clustered_covariance(design, left, rows)[0][-1, -1]
    return float(solution[-1]), float(np.sqrt(max(variance, 0.0)))


def _discharge(blocks: Blocks, battery: BatteryPack) -> _Discharge | None:
    """What a log from a full pack to a low one tells; None unless it is one.

    What it did not draw is added by the believed resting curve: the charge that the last loaded
    voltage tells, down to where the loaded voltage would meet the cut-off.
    """
    mean_a = float(blocks.current_a[blocks.airborne].mean())
    resting = np.flatnonzero(blocks.current_a < _RESTING_FRAC * mean_a)
    before = resting[resting < int(np.argmax(blocks.airborne))]
    if len(before) * BLOCK_S < _RESTING_S:
        return None
    rest_v = float(np.median(blocks.voltage_v[before]))
    if battery.charge_frac_at_rest(rest_v) < _FULL_FRAC:
        return None
    cutoff_v = battery.cells * battery.cutoff_cell_v
    under = np.flatnonzero(blocks.airborne & (blocks.voltage_v <= cutoff_v))
    last = int(under[0]) if len(under) else int(np.flatnonzero(blocks.airborne)[-1])
    end = slice(max(last - _END_BLOCKS + 1, 0), last + 1)
    end_v, end_a = float(blocks.voltage_v[end].mean()), float(blocks.current_a[end].mean())
    ohm = _resistance([blocks])[0]
    charge = battery.charge_frac_at_rest(end_v + ohm * end_a)
    empty = battery.charge_frac_at_rest(cutoff_v + ohm * end_a)
    if charge > _LOW_FRAC:
        return None
    # What a log leaves out was drawn as before it.
    hours = np.diff(blocks.t_s[: last + 1], append=blocks.t_s[last] + BLOCK_S) / 3600.0
    drawn_wh = float(blocks.power_w[: last + 1] @ hours)
    drawn_ah = float(blocks.current_a[: last + 1] @ hours)
    left_ah = drawn_ah * max(charge - empty, 0.0) / (1.0 - charge)
    left_wh = left_ah * 0.5 * (end_v + cutoff_v)
    draw_w = float(blocks.power_w[: last + 1][blocks.airborne[: last + 1]].mean())
    left_frac = left_wh / battery.nominal_wh
    return _Discharge(
        blocks.name,
        draw_w,
        drawn_wh / battery.nominal_wh + left_frac,
        float(np.hypot(_CURVE_FRAC * left_frac, _OWN_STD_FRAC)),
        left_frac,
    )
