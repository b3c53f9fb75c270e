"""Which phases of flight a set of logs measures the power of, and `power_flown` from those.

The ratio of measured to modelled energy over all flights; its standard deviation by the ratio
estimator with flights as clusters (Cochran, Sampling Techniques, 1977, 6.4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.calibration.quantities import Quantity
from companion.core.measured_energy.track_power import PHASES, PhaseEnergy
from companion.core.vehicle.airframe import FlownPower

_LEAST_FLIGHTS = 3
_LEAST_WH = 0.5  # of a flight in a phase: some seconds
_PRIOR_STD_FRAC = 0.1  # [est] of the model in a phase that nobody measured
_LIMIT_FRAC = 0.05
_LEAST_FRAC, _MOST_FRAC = 0.5, 2.0  # as `FlownPower` takes them
_FLIGHTS = {
    "climb": "three flights with a climb of 30 m or more",
    "level": "three flights with sides of 100 m or more",
    "descent": "three flights that come down from 30 m or more",
}


@dataclass(frozen=True, slots=True)
class IdentifiedPhases:
    """`table` is `None` where level flight is not identified; a climb or a descent that is not is
    priced as level flight. `quantities` in the order of PHASES."""

    table: FlownPower | None
    quantities: tuple[Quantity, ...]


def identify_phases(flights: Sequence[PhaseEnergy]) -> IdentifiedPhases:
    """What these flights tell of the power in each phase over the airframe's own model."""
    measured = np.array([f.measured_wh for f in flights]).reshape(-1, len(PHASES))
    modelled = np.array([f.modelled_wh for f in flights]).reshape(-1, len(PHASES))
    quantities = tuple(
        _quantity(phase, measured[:, i], modelled[:, i]) for i, phase in enumerate(PHASES)
    )
    climb, level, descent = (q.value if q.identified else None for q in quantities)
    if level is None:
        return IdentifiedPhases(None, quantities)
    table = FlownPower(
        climb_frac=level if climb is None else climb,
        level_frac=level,
        descent_frac=level if descent is None else descent,
    )
    return IdentifiedPhases(table, quantities)


def _quantity(phase: str, measured_wh: Floats, modelled_wh: Floats) -> Quantity:
    used = modelled_wh >= _LEAST_WH
    whole = float(modelled_wh[used].sum())
    frac = float(measured_wh[used].sum()) / whole if whole > 0.0 else 1.0
    std = _PRIOR_STD_FRAC
    count = int(used.sum())
    if count >= _LEAST_FLIGHTS and _LEAST_FRAC <= frac <= _MOST_FRAC:
        left = measured_wh[used] - frac * modelled_wh[used]
        scatter = math.sqrt(count / (count - 1) * float(left @ left)) / whole
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
