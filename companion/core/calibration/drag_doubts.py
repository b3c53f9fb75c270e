"""What a calibration leaves open of drag and attitude, as the wind estimator is told it.

An estimator that is told too much of it learns drag from changes of speed, where a real vehicle's
thrust, attitude and velocity agree less well than in steady flight.
"""

import math
from collections.abc import Sequence

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.calibration.drag import DragFit
from companion.core.calibration.power import air_speeds
from companion.core.calibration.records import Blocks
from companion.core.calibration.trim import turning_trims_deg

LEAST_GAIN_STD_FRAC = 0.02
"""Drag goes with the air's density, and where nobody measures the temperature that is known to
about 6 degrees."""
LEAST_AXIS_STD_FRAC = 0.01
LEAST_TRIM_STD_DEG = 0.2
MODEL_STD_FRAC = 0.03
"""[est] What two coefficients an axis leave over on real vehicles."""
_LEAST_FLIGHTS = 5
"""For the scatter of their trims."""


def drag_doubts(flights: Sequence[Blocks], drag: DragFit) -> dict[str, float]:
    """Fields of the airframe's `[drag]`: of the fit's covariance at the airspeed that was flown
    (root mean square), and of the flights' own trims.
    """
    met = [air_speeds(b, wind)[0] for b, wind in zip(flights, drag.winds, strict=True)]
    both, own = _gain_stds(drag, float(np.sqrt(np.mean(np.concatenate(met) ** 2))))
    found = {
        "gain_std_frac": float(np.clip(both, LEAST_GAIN_STD_FRAC, 1.0)),
        "axis_gain_std_frac": float(np.clip(own, LEAST_AXIS_STD_FRAC, 1.0)),
        "model_std_frac": MODEL_STD_FRAC,
    }
    trims = turning_trims_deg(flights, drag)
    if len(trims) >= _LEAST_FLIGHTS:
        scatter = math.sqrt(float(np.var(trims, axis=0, ddof=1).mean()))
        found["trim_std_deg"] = max(scatter, LEAST_TRIM_STD_DEG)
    return found


def _gain_stds(drag: DragFit, airspeed_mps: float) -> tuple[float, float]:
    """Relative standard deviation of both axes' drag together, and of either beside that."""
    forward = np.array([airspeed_mps, 0.0, airspeed_mps**2, 0.0, 0.0])
    right = np.array([0.0, airspeed_mps, 0.0, airspeed_mps**2, 0.0])

    def relative(row: Floats) -> Floats:
        return row / max(float(row @ drag.values), 1e-9)

    half = 0.5 * (relative(forward) - relative(right))
    mean = 0.5 * (relative(forward) + relative(right))
    of_half, of_mean = float(half @ drag.cov @ half), float(mean @ drag.cov @ mean)
    return math.sqrt(max(of_mean - of_half, 0.0)), math.sqrt(2.0 * of_half)
