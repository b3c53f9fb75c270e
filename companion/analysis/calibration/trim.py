"""Mean trim of a vehicle: angle between thrust and reported attitude, averaged over flights.

A flight's mean residual of the drag fit is gravity times its trim. Only flights with several
headings identify it: on one heading a trim is equivalent to a wind.
"""

import math
from collections.abc import Sequence

import numpy as np

from companion.analysis.calibration.drag import DragFit, DragPriors
from companion.analysis.calibration.quantities import Quantity
from companion.analysis.calibration.records import Blocks
from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import GRAVITY_MPS2

TRIM_KEYS = {"trim forward": "trim_forward_deg", "trim right": "trim_right_deg"}
_MIN_FLIGHTS = 3
_LIMIT_DEG = 0.3
"""At 10 m/s and with the M100's drag this is a wind of 0.25 m/s."""
_MAX_HEADING_VECTOR = 0.8
"""Length of the mean heading vector; 1 is one heading throughout."""


def trim_quantities(
    flights: Sequence[Blocks], prior_airframe: Airframe, drag: DragFit
) -> tuple[Quantity, Quantity]:
    """Return both trims, degrees: the start's plus the mean over flights with turns."""
    degrees = additional_trim_by_flight_deg(flights, drag)
    own = prior_airframe.drag.trim_forward_deg, prior_airframe.drag.trim_right_deg
    forward, right = (
        _trim_quantity(name, before, degrees[:, axis])
        for axis, (name, before) in enumerate(zip(TRIM_KEYS, own, strict=True))
    )
    return forward, right


def additional_trim_by_flight_deg(flights: Sequence[Blocks], drag: DragFit) -> Floats:
    """Return the trim (n, 2) of each flight with turns, in addition to the start airframe's."""
    mean_residuals_mps2 = [
        residuals_mps2.mean(axis=0)
        for blocks, residuals_mps2 in zip(flights, drag.residual_mps2, strict=True)
        if _mean_heading_vector_length(blocks) < _MAX_HEADING_VECTOR
    ]
    return np.degrees(np.array(mean_residuals_mps2).reshape(-1, 2) / GRAVITY_MPS2)


def _mean_heading_vector_length(blocks: Blocks) -> float:
    flown = blocks.select(blocks.airborne)
    return math.hypot(float(flown.cos_yaw.mean()), float(flown.sin_yaw.mean()))


def _trim_quantity(name: str, prior_trim_deg: float, additional_trims_deg: Floats) -> Quantity:
    """Build a quantity; its std is of the mean over flights, or the prior's below three."""
    prior_deg = math.degrees(DragPriors().trim_std_rad)
    count = len(additional_trims_deg)
    std = prior_deg
    if count >= _MIN_FLIGHTS:
        std = min(float(np.std(additional_trims_deg, ddof=1)) / math.sqrt(count), prior_deg)
    return Quantity(
        name,
        "deg",
        prior_trim_deg + (float(additional_trims_deg.mean()) if count else 0.0),
        std,
        prior_deg,
        0.0,
        False,
        f"{_MIN_FLIGHTS} flights or more with sides in all directions, nose along the course",
        _LIMIT_DEG,
    )
