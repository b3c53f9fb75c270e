"""A synthetic front, in the direction of the wind change that one member reports."""

import math

import numpy as np

from companion.core.wind_field.fronts import DETECTION_STD_S, WindChange, WindFront

SPEED_OVER_BEHIND, LEAST_SPEED_MPS = 0.75, 2.0
SPEED_STD_FRAC, NORMAL_STD_RAD = 0.35, math.radians(35.0)


def made_front(noticed_s: float, felt: WindChange) -> WindFront:
    """At three quarters of the wind behind it, known to a third and to 35 degrees."""
    normal = np.array(felt.change_ne_mps) / felt.magnitude_mps
    speed = max(SPEED_OVER_BEHIND * float(np.dot(felt.wind_ne_mps, normal)), LEAST_SPEED_MPS)
    turned = np.stack([normal, [-normal[1], normal[0]]], axis=1)
    spread = np.diag([SPEED_STD_FRAC / speed, NORMAL_STD_RAD / speed]) ** 2
    cov = np.zeros((3, 3))
    cov[0, 0] = DETECTION_STD_S**2
    cov[1:, 1:] = turned @ spread @ turned.T
    origin = np.array(felt.position_ne_m)
    return WindFront(noticed_s, (felt,), origin, felt.t_s, normal / speed, cov)
