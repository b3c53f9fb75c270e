"""The pack from one's own flights: its resistance, and what it gives from full to cut-off.

Resistance from how voltage falls with current at the same charge (Ohm's law; a cubic in the charge
drawn stands for the open-circuit curve). Usable energy only from a log that runs from a full pack
to the loaded cut-off: anything less leaves the last and most uncertain part to belief.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.airframe import Battery
from companion.core.calibration_records import BLOCK_S, Blocks

FloatArray = NDArray[np.float64]

_CURVE_TERMS = 4
_FULL_FRAC = 0.95
_NEAR_CUTOFF_V = 0.03  # of a cell: closer to the cut-off than this is there
_SENSOR_SCALE_STD = 0.02
_RESTING_S = 4.0
_RESTING_FRAC = 0.1  # of the flight's mean current


@dataclass(frozen=True, slots=True)
class BatteryFit:
    """`usable_frac` of the label at `usable_at_w`; None where no log runs from full to cut-off."""

    resistance_ohm: float
    resistance_std_ohm: float
    usable_frac: float | None = None
    usable_std_frac: float | None = None
    usable_at_w: float | None = None
    discharge_log: str = ""


def fit_battery(flights: list[Blocks], battery: Battery) -> BatteryFit:
    """Resistance over all flights, usable energy from the deepest discharge."""
    ohm, std = _resistance(flights)
    for blocks in flights:
        found = _usable(blocks, battery)
        if found is not None:
            frac, draw_w = found
            std_frac = _SENSOR_SCALE_STD * frac
            return BatteryFit(ohm, std, frac, std_frac, draw_w, blocks.name)
    return BatteryFit(ohm, std)


def _resistance(flights: list[Blocks]) -> tuple[float, float]:
    """(ohm, its standard deviation), clustered by minutes."""
    columns: list[FloatArray] = []
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
    bread = np.linalg.pinv(design.T @ design)
    meat = np.zeros_like(bread)
    for m in np.unique(minute):
        score = design[minute == m].T @ left[minute == m]
        meat += np.outer(score, score)
    variance = (bread @ meat @ bread)[-1, -1]
    return float(solution[-1]), float(np.sqrt(max(variance, 0.0)))


def _usable(blocks: Blocks, battery: Battery) -> tuple[float, float] | None:
    """(share of the label, mean draw in W) from full to cut-off; None unless the log has it."""
    mean_a = float(blocks.current_a[blocks.airborne].mean())
    resting = np.flatnonzero(blocks.current_a < _RESTING_FRAC * mean_a)
    before = resting[resting < int(np.argmax(blocks.airborne))]
    if len(before) * BLOCK_S < _RESTING_S:
        return None
    rest_v = float(np.median(blocks.voltage_v[before]))
    if battery.charge_frac_at_rest(rest_v) < _FULL_FRAC:
        return None
    down_to = battery.cells * (battery.cutoff_cell_v + _NEAR_CUTOFF_V)
    low = np.flatnonzero(blocks.airborne & (blocks.voltage_v < down_to))
    if not len(low):
        return None
    until = int(low[0]) + 1
    energy_wh = float(blocks.power_w[:until].sum()) * BLOCK_S / 3600.0
    draw_w = float(blocks.power_w[:until][blocks.airborne[:until]].mean())
    return energy_wh / battery.nominal_wh, draw_w
