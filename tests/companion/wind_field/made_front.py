"""A front made by hand: it goes where the wind changes to, as one member's change alone tells."""

import math

import numpy as np

from companion.core.wind_field.fronts import FELT_STD_S, FeltChange, FrontAhead

SPEED_OVER_BEHIND, LEAST_SPEED_MPS = 0.75, 2.0
SPEED_STD_FRAC, NORMAL_STD_RAD = 0.35, math.radians(35.0)


def made_front(noticed_s: float, felt: FeltChange) -> FrontAhead:
    """At three quarters of the wind behind it, known to a third and to 35 degrees."""
    normal = np.array(felt.change_ne_mps) / felt.size_mps
    speed = max(SPEED_OVER_BEHIND * float(np.dot(felt.wind_ne_mps, normal)), LEAST_SPEED_MPS)
    turned = np.stack([normal, [-normal[1], normal[0]]], axis=1)
    spread = np.diag([SPEED_STD_FRAC / speed, NORMAL_STD_RAD / speed]) ** 2
    cov = np.zeros((3, 3))
    cov[0, 0] = FELT_STD_S**2
    cov[1:, 1:] = turned @ spread @ turned.T
    origin = np.array(felt.place_ne_m)
    return FrontAhead(noticed_s, (felt,), origin, felt.t_s, normal / speed, cov)
