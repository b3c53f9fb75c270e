"""Identification of power by flight phase from a set of logs, as `power_flown`.

The ratio of measured to modelled energy over all flights; its standard deviation by the ratio
estimator with flights as clusters (Cochran, Sampling Techniques, 1977, 6.4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.analysis.calibration.quantities import Quantity
from companion.analysis.measured_energy.track_power import PHASES, PhaseEnergy
from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import FlownPower

_MIN_FLIGHTS = 3
_MIN_PHASE_WH = 0.5  # of a flight in a phase: some seconds
_PRIOR_STD_FRAC = 0.1  # [est] of the model in an unmeasured phase
_LIMIT_FRAC = 0.05
_MIN_FRAC, _MAX_FRAC = 0.5, 2.0  # the range of `FlownPower`
_FLIGHTS = {
    "climb": "three flights with a climb of 30 m or more",
    "level": "three flights with sides of 100 m or more",
    "descent": "three flights that come down from 30 m or more",
}


@dataclass(frozen=True, slots=True)
class PhasePowerFit:
    """`table` is `None` unless level flight is identified; an unidentified climb or descent has the
    ratio of level flight. `quantities` in the order of PHASES."""

    table: FlownPower | None
    quantities: tuple[Quantity, ...]


def fit_phase_power_ratios(flights: Sequence[PhaseEnergy]) -> PhasePowerFit:
    """Fit the ratio of measured to modelled power in each phase."""
    measured = np.array([f.measured_wh for f in flights]).reshape(-1, len(PHASES))
    modelled = np.array([f.modelled_wh for f in flights]).reshape(-1, len(PHASES))
    quantities = tuple(
        _phase_power_ratio_quantity(phase, measured[:, i], modelled[:, i])
        for i, phase in enumerate(PHASES)
    )
    climb, level, descent = (q.value if q.is_identifiable else None for q in quantities)
    if level is None:
        return PhasePowerFit(None, quantities)
    table = FlownPower(
        climb_frac=level if climb is None else climb,
        level_frac=level,
        descent_frac=level if descent is None else descent,
    )
    return PhasePowerFit(table, quantities)


def _phase_power_ratio_quantity(phase: str, measured_wh: Floats, modelled_wh: Floats) -> Quantity:
    used = modelled_wh >= _MIN_PHASE_WH
    total_modelled_wh = float(modelled_wh[used].sum())
    frac = float(measured_wh[used].sum()) / total_modelled_wh if total_modelled_wh > 0.0 else 1.0
    std = _PRIOR_STD_FRAC
    count = int(used.sum())
    if count >= _MIN_FLIGHTS and _MIN_FRAC <= frac <= _MAX_FRAC:
        residuals_wh = measured_wh[used] - frac * modelled_wh[used]
        scatter = (
            math.sqrt(count / (count - 1) * float(residuals_wh @ residuals_wh)) / total_modelled_wh
        )
        std = min(scatter, _PRIOR_STD_FRAC)
    return Quantity(
        f"power in {phase} over the model's",
        "",
        frac,
        std,
        _PRIOR_STD_FRAC,
        _LIMIT_FRAC,
        False,
        _FLIGHTS[phase],
    )
