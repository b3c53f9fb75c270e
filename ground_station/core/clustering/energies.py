"""The energy of each delivery from each possible stop, for hundreds of customers at once.

Over flat ground the energy of a sortie is a constant plus its length times a rate that depends on
the course. `SortieFeasibility` provides both, for each payload step and a set of courses.
"""

import math

import numpy as np

from companion.core.base.arrays import Floats
from ground_station.core.feasibility.reach import (
    PAYLOAD_STEP_KG,
    SortieFeasibility,
    SortieGeometry,
    SortieNeed,
)

COURSES = 36
"""One course every 10 degrees; the rate is interpolated between courses."""

SHORT_M, LONG_M = 100.0, 1100.0


def delivery_energy_matrix_wh(
    feasibility: SortieFeasibility,
    positions_ne_m: Floats,
    mass_kg: Floats,
    detour_factor: Floats,
    charge_frac: float | None = None,
) -> Floats:
    """Return (n, n): mean energy of a delivery to j from a stop at i, Wh; infinite if infeasible.

    `detour_factor` (n, n) multiplies the energy of sorties whose straight line an obstacle blocks.
    """
    away = positions_ne_m[None, :, :] - positions_ne_m[:, None, :]
    length_m = np.hypot(away[..., 0], away[..., 1])
    course_rad = np.arctan2(away[..., 1], away[..., 0])
    energy = np.empty_like(length_m)
    classes = np.ceil(mass_kg / PAYLOAD_STEP_KG - 1e-9) * PAYLOAD_STEP_KG
    for payload_kg in np.unique(classes):
        in_class = classes == payload_kg
        energy[:, in_class] = _payload_class_energy_wh(
            feasibility,
            float(payload_kg),
            length_m[:, in_class],
            course_rad[:, in_class],
            detour_factor[:, in_class],
            charge_frac,
        )
    np.fill_diagonal(energy, 0.0)
    return energy


def _payload_class_energy_wh(
    feasibility: SortieFeasibility,
    payload_kg: float,
    length_m: Floats,
    course_rad: Floats,
    detour_factor: Floats,
    charge_frac: float | None,
) -> Floats:
    if payload_kg > feasibility.airframe.mass.max_payload_kg:
        return np.full_like(length_m, np.inf)
    courses_rad = np.linspace(-math.pi, math.pi, COURSES + 1)
    short = [_sortie_need(feasibility, payload_kg, SHORT_M, angle) for angle in courses_rad]
    long = [_sortie_need(feasibility, payload_kg, LONG_M, angle) for angle in courses_rad]
    mean_wh = detour_factor * _interpolate_sortie_need(
        courses_rad, course_rad, length_m, short, long, "mean_wh"
    )
    std_wh = detour_factor * _interpolate_sortie_need(
        courses_rad, course_rad, length_m, short, long, "std_wh"
    )
    flyable = np.interp(course_rad, courses_rad, [float(n.flyable) for n in long]) > 0.999
    budget_wh, budget_std_wh = feasibility.usable_above_reserve_wh_and_std(payload_kg, charge_frac)
    spare_wh = budget_wh - mean_wh - feasibility.sigmas * np.hypot(std_wh, budget_std_wh)
    return np.where(flyable & (spare_wh >= 0.0), mean_wh, np.inf)


def _sortie_need(
    feasibility: SortieFeasibility, payload_kg: float, length_m: float, course_rad: float
) -> SortieNeed:
    customer_ned_m = (length_m * math.cos(course_rad), length_m * math.sin(course_rad), 0.0)
    depot = (0.0, 0.0, 0.0)
    return feasibility.sortie_need(SortieGeometry(payload_kg, depot, customer_ned_m, depot))


def _interpolate_sortie_need(
    sampled_courses_rad: Floats,
    course_rad: Floats,
    length_m: Floats,
    short_sortie_needs: list[SortieNeed],
    long_sortie_needs: list[SortieNeed],
    need_field: str,
) -> Floats:
    """Interpolate linearly in length between the short and the long sortie of each course."""
    near = np.array([getattr(need, need_field) for need in short_sortie_needs])
    far = np.array([getattr(need, need_field) for need in long_sortie_needs])
    rate = (far - near) / (LONG_M - SHORT_M)
    return np.interp(course_rad, sampled_courses_rad, near) + np.interp(
        course_rad, sampled_courses_rad, rate
    ) * (length_m - SHORT_M)
