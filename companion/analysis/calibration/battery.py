"""Battery pack from flight logs: resistance, and usable energy from full to cut-off.

Resistance: voltage drop with current at equal charge (Ohm's law; a cubic in the charge drawn
models the open-circuit curve). Usable energy: from logs that discharge a full pack to a low charge.
Flights must not reach the cut-off, so the last few per cent are extrapolated with the prior resting
curve and add uncertainty. Without a deep discharge the prior usable energy is kept.
"""

from dataclasses import dataclass

import numpy as np

from companion.analysis.calibration.records import BLOCK_S, Blocks
from companion.analysis.calibration.residual_scatter import sandwich_and_inverse_information
from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import BatteryPack

_CURVE_COEFFICIENTS = 4
_MIN_START_CHARGE_FRAC = 0.95
_MAX_END_CHARGE_FRAC = 0.15  # of charge: with more left, the extrapolation is too long
_CURVE_ERROR_FRAC = 0.3  # [est] error of the extrapolated energy by the prior curve
_DISCHARGE_STD_FRAC = 0.005  # [est] of one discharge: initial charge and temperature
_END_BLOCKS = 5
_SENSOR_SCALE_STD = 0.02
_RESTING_S = 4.0
_RESTING_FRAC = 0.1  # of the flight's mean current


@dataclass(frozen=True, slots=True)
class UsableEnergy:
    """Usable share of the label: `frac` at `at_w`, less `loss_per_w` for each further watt.

    `extrapolated_frac`: mean share of the label that is extrapolated.
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
    """The pack's resistance; `usable` is None without a deep discharge."""

    resistance_ohm: float
    resistance_std_ohm: float
    usable: UsableEnergy | None = None


@dataclass(frozen=True, slots=True)
class _Discharge:
    """One log from full to low: usable share of the label, with its standard deviation."""

    name: str
    draw_w: float
    frac: float
    std_frac: float
    extrapolated_frac: float


def fit_battery(flights: list[Blocks], battery: BatteryPack) -> BatteryFit:
    """Fit resistance to all flights, and usable energy over draw to the deep discharges."""
    ohm, std = _fit_resistance(flights)
    discharges = [
        found
        for blocks in flights
        if (found := _discharge_if_full_to_low(blocks, battery)) is not None
    ]
    return BatteryFit(ohm, std, _fit_usable_energy(discharges, battery) if discharges else None)


def _fit_usable_energy(discharges: list[_Discharge], battery: BatteryPack) -> UsableEnergy:
    """Fit usable energy at the lightest draw and its loss per watt; the prior is the pack's.

    A vehicle's current sensor has one scale error in all flights: it changes the level and the
    slope by that share.
    """
    at_w = min(d.draw_w for d in discharges)
    regressors = np.array([[1.0, -(d.draw_w - at_w)] for d in discharges])
    weight = np.array([d.std_frac**-2 for d in discharges])
    prior = battery.usable_loss_per_w
    information = (regressors.T * weight) @ regressors + np.diag([0.0, prior**-2])
    information_vector = (regressors.T * weight) @ np.array(
        [d.frac for d in discharges]
    ) + np.array([0.0, 1.0 / prior])
    cov = np.linalg.inv(information)
    frac, loss = cov @ information_vector
    return UsableEnergy(
        frac=float(frac),
        std_frac=float(np.hypot(np.sqrt(cov[0, 0]), _SENSOR_SCALE_STD * frac)),
        at_w=at_w,
        loss_per_w=max(float(loss), 0.0),
        loss_std_per_w=float(np.hypot(np.sqrt(cov[1, 1]), _SENSOR_SCALE_STD * loss)),
        logs=tuple(d.name for d in discharges),
        extrapolated_frac=float(np.mean([d.extrapolated_frac for d in discharges])),
    )


def _fit_resistance(flights: list[Blocks]) -> tuple[float, float]:
    """Return resistance and standard deviation (ohm), with residuals clustered by minute."""
    columns: list[Floats] = []
    measured, minutes = [], []
    width = _CURVE_COEFFICIENTS * len(flights)
    for number, b in enumerate(flights):
        drawn = np.cumsum(b.current_a) * BLOCK_S
        share = drawn / max(float(drawn[-1]), 1e-9)
        rows = np.zeros((len(share), width + 1))
        rows[:, number * _CURVE_COEFFICIENTS : (number + 1) * _CURVE_COEFFICIENTS] = np.vander(
            share, _CURVE_COEFFICIENTS
        )
        rows[:, -1] = -b.current_a
        columns.append(rows)
        measured.append(b.voltage_v)
        minutes.append(b.t_s // 60.0 + 10_000.0 * number)
    regressors, volts, minute = (
        np.vstack(columns),
        np.concatenate(measured),
        np.concatenate(minutes),
    )
    solution, *_ = np.linalg.lstsq(regressors, volts, rcond=None)
    residuals_v = volts - regressors @ solution
    rows = (np.flatnonzero(minute == m) for m in np.unique(minute))
    variance = sandwich_and_inverse_information(regressors, residuals_v, rows)[0][-1, -1]
    return float(solution[-1]), float(np.sqrt(max(variance, 0.0)))


def _discharge_if_full_to_low(blocks: Blocks, battery: BatteryPack) -> _Discharge | None:
    """Evaluate a log that discharges a full pack to a low charge; None for any other log.

    The remaining energy is extrapolated with the prior resting curve: from the charge at the last
    loaded voltage to the charge at which the loaded voltage reaches the cut-off.
    """
    mean_a = float(blocks.current_a[blocks.airborne].mean())
    resting = np.flatnonzero(blocks.current_a < _RESTING_FRAC * mean_a)
    before = resting[resting < int(np.argmax(blocks.airborne))]
    if len(before) * BLOCK_S < _RESTING_S:
        return None
    rest_v = float(np.median(blocks.voltage_v[before]))
    if battery.charge_frac_from_resting_voltage(rest_v) < _MIN_START_CHARGE_FRAC:
        return None
    cutoff_v = battery.cells * battery.cutoff_cell_v
    under = np.flatnonzero(blocks.airborne & (blocks.voltage_v <= cutoff_v))
    last = int(under[0]) if len(under) else int(np.flatnonzero(blocks.airborne)[-1])
    end = slice(max(last - _END_BLOCKS + 1, 0), last + 1)
    end_v, end_a = float(blocks.voltage_v[end].mean()), float(blocks.current_a[end].mean())
    ohm = _fit_resistance([blocks])[0]
    charge = battery.charge_frac_from_resting_voltage(end_v + ohm * end_a)
    empty = battery.charge_frac_from_resting_voltage(cutoff_v + ohm * end_a)
    if charge > _MAX_END_CHARGE_FRAC:
        return None
    # A gap in the log counts with the power before it.
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
        float(np.hypot(_CURVE_ERROR_FRAC * left_frac, _DISCHARGE_STD_FRAC)),
        left_frac,
    )
