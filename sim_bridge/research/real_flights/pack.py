"""Voltage of recorded packs under load, predicted from the current with the identified model."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from companion.analysis.calibration.records import BLOCK_S, Blocks
from companion.core.vehicle.airframe import BatteryPack
from companion.core.vehicle.pack_model import LoadedVoltage, ResistanceEstimator

AHEAD_S = 60.0
"""Time by which each voltage is predicted ahead, with the resistance as identified until then."""

_CURRENT_STD_FRAC, _CURVE_STD_FRAC, _COVERED_SIGMAS = 0.05, 0.2, 1.645
_RESTING_FRAC = 0.1  # of the flight's maximum current


def voltage_prediction_errors(
    blocks: Blocks, resting_v: float, battery: BatteryPack
) -> tuple[list[float], list[float], float]:
    """Return errors (V) of the predictions with their standard deviations, and the resistance that
    was identified last (ohm).
    """
    estimator = ResistanceEstimator(battery, 20.0)
    capacity_ah = battery.nominal_wh / (battery.cells * float(np.mean(battery.ocv_cell_v)))
    start = charge = battery.charge_frac_from_resting_voltage(resting_v)
    errors_v, stds_v, known = [], [], []
    for row in np.flatnonzero(blocks.airborne):
        t_s, current_a = float(blocks.t_s[row]), float(blocks.current_a[row])
        charge -= current_a * BLOCK_S / 3600.0 / capacity_ah
        drop_v = battery.cells * (
            battery.resting_cell_voltage_v(start) - battery.resting_cell_voltage_v(charge)
        )
        open_v, measured_v = resting_v - drop_v, float(blocks.voltage_v[row])
        for part_s in (0.0, 0.5 * BLOCK_S):  # a sample counts for at most a second
            estimator.update_from_sample(
                LoadedVoltage(
                    t_s + part_s, measured_v, current_a, _CURRENT_STD_FRAC, open_v, drop_v
                )
            )
        known.append((t_s, *estimator.resistance_ohm_and_std_log()))
        earlier = [one for one in known if one[0] <= t_s - AHEAD_S]
        if earlier:
            _, ohm, std_log = earlier[-1]
            sag_v, curve_v = ohm * current_a, _CURVE_STD_FRAC * drop_v
            errors_v.append(open_v - sag_v - measured_v)
            stds_v.append(math.hypot(std_log * sag_v, curve_v, battery.resting_voltage_std_v))
    return errors_v, stds_v, estimator.resistance_ohm_and_std_log()[0]


def voltage_statistics(
    flights: Sequence[tuple[Blocks, float]], battery: BatteryPack
) -> dict[str, Any]:
    """Return RMS error (V), share of blocks within the 90 % interval, and resistances, of the logs
    that begin at rest.
    """
    found = [
        voltage_prediction_errors(blocks, rest_v, battery)
        for blocks, rest_v in flights
        if blocks.current_a[0] < _RESTING_FRAC * blocks.current_a.max()
    ]
    error = np.array([e for errors, _, _ in found for e in errors])
    std = np.array([s for _, stds, _ in found for s in stds])
    ohms = [ohm for errors, _, ohm in found if errors]
    return {
        "flights": len(ohms),
        "blocks": len(error),
        "rmse_v": float(np.sqrt(np.mean(error**2))) if len(error) else math.nan,
        "coverage90": float(np.mean(np.abs(error) <= _COVERED_SIGMAS * std))
        if len(error)
        else math.nan,
        "resistance_median_ohm": float(np.median(ohms)) if ohms else math.nan,
    }
