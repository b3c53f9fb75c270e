"""Uncertainty of drag and trim after a calibration, as input of the wind estimator.

With too large an uncertainty the estimator adapts drag during speed changes, in which thrust,
attitude and velocity of a real vehicle are less consistent than in steady flight.
"""

import math
from collections.abc import Sequence

import numpy as np

from companion.analysis.calibration.drag import DragFit
from companion.analysis.calibration.power import airspeed_and_lateral_part_mps
from companion.analysis.calibration.records import Blocks
from companion.analysis.calibration.trim import additional_trim_by_flight_deg
from companion.core.base.arrays import Floats

MIN_GAIN_STD_FRAC = 0.02
"""Drag is proportional to air density; without a measurement the air temperature is known to
about 6 degrees."""
MIN_AXIS_STD_FRAC = 0.01
MIN_TRIM_STD_DEG = 0.2
MODEL_STD_FRAC = 0.03
"""[est] Residual of two coefficients per axis on real vehicles."""
_MIN_FLIGHTS = 5
"""Minimum number of flights for the scatter of trims."""


def drag_uncertainty_fields(flights: Sequence[Blocks], drag: DragFit) -> dict[str, float]:
    """Return fields of the airframe's `[drag]`, from the fit's covariance at the flown airspeed
    (root mean square) and from the trims of the flights.
    """
    airspeeds_mps = [
        airspeed_and_lateral_part_mps(b, wind)[0]
        for b, wind in zip(flights, drag.winds, strict=True)
    ]
    both, own = _common_and_per_axis_drag_std_frac(
        drag, float(np.sqrt(np.mean(np.concatenate(airspeeds_mps) ** 2)))
    )
    found = {
        "gain_std_frac": float(np.clip(both, MIN_GAIN_STD_FRAC, 1.0)),
        "axis_gain_std_frac": float(np.clip(own, MIN_AXIS_STD_FRAC, 1.0)),
        "model_std_frac": MODEL_STD_FRAC,
    }
    trims = additional_trim_by_flight_deg(flights, drag)
    if len(trims) >= _MIN_FLIGHTS:
        scatter = math.sqrt(float(np.var(trims, axis=0, ddof=1).mean()))
        found["trim_std_deg"] = max(scatter, MIN_TRIM_STD_DEG)
    return found


def _common_and_per_axis_drag_std_frac(drag: DragFit, airspeed_mps: float) -> tuple[float, float]:
    """Return the relative std of the drag common to both axes, and of each axis in addition."""
    forward = np.array([airspeed_mps, 0.0, airspeed_mps**2, 0.0, 0.0])
    right = np.array([0.0, airspeed_mps, 0.0, airspeed_mps**2, 0.0])

    def relative_to_fitted_drag(row: Floats) -> Floats:
        return row / max(float(row @ drag.values), 1e-9)

    half = 0.5 * (relative_to_fitted_drag(forward) - relative_to_fitted_drag(right))
    mean = 0.5 * (relative_to_fitted_drag(forward) + relative_to_fitted_drag(right))
    of_half, of_mean = float(half @ drag.cov @ half), float(mean @ drag.cov @ mean)
    return math.sqrt(max(of_mean - of_half, 0.0)), math.sqrt(2.0 * of_half)
