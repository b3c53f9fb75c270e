"""The mean trim of a vehicle: how far the thrust leans off the reported attitude over its flights.

A flight's mean residual of the drag fit is gravity times its trim. Only flights that turn tell it:
on one heading a trim is a wind.
"""

import math
from collections.abc import Sequence

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.calibration.drag import DragFit, DragPriors
from companion.core.calibration.quantities import Quantity
from companion.core.calibration.records import Blocks
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import GRAVITY_MPS2

TRIM_KEYS = {"trim forward": "trim_forward_deg", "trim right": "trim_right_deg"}
_LEAST_FLIGHTS = 3
_LIMIT_DEG = 0.3
"""At 10 m/s and with the M100's drag this is a wind of 0.25 m/s."""
_TURNS = 0.8
"""Length of the mean heading vector; 1 is one heading throughout."""


def trim_quantities(
    flights: Sequence[Blocks], start: Airframe, drag: DragFit
) -> tuple[Quantity, Quantity]:
    """Both trims, degrees: the start's plus the mean over flights that turn; NaN in none."""
    degrees = turning_trims_deg(flights, drag)
    own = start.drag.trim_forward_deg, start.drag.trim_right_deg
    forward, right = (
        _quantity(name, before, degrees[:, axis])
        for axis, (name, before) in enumerate(zip(TRIM_KEYS, own, strict=True))
    )
    return forward, right


def turning_trims_deg(flights: Sequence[Blocks], drag: DragFit) -> Floats:
    """Trim of each flight that turns, forward and right (n, 2), beside the start airframe's."""
    means = [
        left.mean(axis=0)
        for blocks, left in zip(flights, drag.residual_mps2, strict=True)
        if _heading_length(blocks) < _TURNS
    ]
    return np.degrees(np.array(means).reshape(-1, 2) / GRAVITY_MPS2)


def _heading_length(blocks: Blocks) -> float:
    flown = blocks.pick(blocks.airborne)
    return math.hypot(float(flown.cos_yaw.mean()), float(flown.sin_yaw.mean()))


def _quantity(name: str, before_deg: float, of_flights_deg: Floats) -> Quantity:
    """The std is that of a mean of flights; with fewer than three that of the prior."""
    prior_deg = math.degrees(DragPriors().trim_std_rad)
    count = len(of_flights_deg)
    std = prior_deg
    if count >= _LEAST_FLIGHTS:
        std = min(float(np.std(of_flights_deg, ddof=1)) / math.sqrt(count), prior_deg)
    return Quantity(
        name,
        "deg",
        before_deg + (float(of_flights_deg.mean()) if count else 0.0),
        std,
        prior_deg,
        0.0,
        False,
        f"{_LEAST_FLIGHTS} flights or more with sides in all directions, nose along the course",
        _LIMIT_DEG,
    )
