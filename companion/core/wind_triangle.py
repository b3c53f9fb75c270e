"""Row 1: ground speed along a path in wind (arXiv 2604.13441, III-A, equations 4 to 10).

Wind vectors point where the air moves to, (north, east[, down]) m/s.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Track:
    """How a path is flown: ground speed along it, and the air-frame heading and angle needed."""

    ground_speed_mps: float
    air_heading_rad: float
    air_path_angle_rad: float


@dataclass(frozen=True, slots=True)
class Infeasible:
    """The path cannot be flown in this wind; `reason` says why in words."""

    reason: str


def fly_course(
    course_rad: float, airspeed_mps: float, wind_to_ne_mps: FloatArray
) -> Track | Infeasible:
    """Level flight along a course (clockwise from north)."""
    raise NotImplementedError


def fly_path(
    direction_ned: FloatArray,
    airspeed_mps: float,
    wind_to_ned_mps: FloatArray,
    air_path_angle_min_rad: float = -np.pi / 2,
    air_path_angle_max_rad: float = np.pi / 2,
) -> Track | Infeasible:
    """Flight along a 3-D direction, with flight-path limits in the AIR frame."""
    raise NotImplementedError


def ground_speeds_mps(
    airspeed_mps: FloatArray | float, along_mps: FloatArray, across_mps: FloatArray
) -> FloatArray:
    """`sqrt(V_A^2 - W_perp^2) + W_par`; NaN where |W_perp| > V_A or the result is not positive."""
    raise NotImplementedError


def airspeeds_needed_mps(
    ground_speed_mps: FloatArray | float, along_mps: FloatArray, across_mps: FloatArray
) -> FloatArray:
    """Airspeed that makes this ground speed along a path with this wind along and across it."""
    raise NotImplementedError
