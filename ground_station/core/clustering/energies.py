"""The energy of each delivery from each possible stop, for hundreds of customers at once.

Over flat ground the energy of a sortie is a constant plus its length times a rate that depends on
the course. Both come from `Reach`, for each payload step and a set of courses.
"""

import math

import numpy as np

from companion.core.base.arrays import Floats
from ground_station.core.feasibility.reach import PAYLOAD_STEP_KG, Reach, SortieNeed

COURSES = 36
"""Every 10 degrees; between two courses the rate is interpolated."""

SHORT_M, LONG_M = 100.0, 1100.0


def energy_matrix(
    reach: Reach,
    places_ne_m: Floats,
    mass_kg: Floats,
    detour: Floats,
    charge_frac: float | None = None,
) -> Floats:
    """(n, n): mean Wh of a delivery to j from a stop at i; infinite where it is infeasible.

    `detour` (n, n) multiplies a sortie's energy where obstacles are in its way.
    """
    away = places_ne_m[None, :, :] - places_ne_m[:, None, :]
    length_m = np.hypot(away[..., 0], away[..., 1])
    course = np.arctan2(away[..., 1], away[..., 0])
    energy = np.empty_like(length_m)
    classes = np.ceil(mass_kg / PAYLOAD_STEP_KG - 1e-9) * PAYLOAD_STEP_KG
    for payload_kg in np.unique(classes):
        mine = classes == payload_kg
        energy[:, mine] = _of_class(
            reach,
            float(payload_kg),
            length_m[:, mine],
            course[:, mine],
            detour[:, mine],
            charge_frac,
        )
    np.fill_diagonal(energy, 0.0)
    return energy


def _of_class(
    reach: Reach,
    payload_kg: float,
    length_m: Floats,
    course: Floats,
    detour: Floats,
    charge_frac: float | None,
) -> Floats:
    if payload_kg > reach.airframe.mass.max_payload_kg:
        return np.full_like(length_m, np.inf)
    fan = np.linspace(-math.pi, math.pi, COURSES + 1)
    short = [_sortie(reach, payload_kg, SHORT_M, angle) for angle in fan]
    long = [_sortie(reach, payload_kg, LONG_M, angle) for angle in fan]
    mean_wh = detour * _along(fan, course, length_m, short, long, "mean_wh")
    std_wh = detour * _along(fan, course, length_m, short, long, "std_wh")
    flyable = np.interp(course, fan, [float(n.flyable) for n in long]) > 0.999
    budget_wh, budget_std_wh = reach.budget_wh(payload_kg, charge_frac)
    spare_wh = budget_wh - mean_wh - reach.sigmas * np.hypot(std_wh, budget_std_wh)
    return np.where(flyable & (spare_wh >= 0.0), mean_wh, np.inf)


def _sortie(reach: Reach, payload_kg: float, length_m: float, course_rad: float) -> SortieNeed:
    there = (length_m * math.cos(course_rad), length_m * math.sin(course_rad), 0.0)
    return reach.need(payload_kg, (0.0, 0.0, 0.0), there, (0.0, 0.0, 0.0))


def _along(
    fan: Floats,
    course: Floats,
    length_m: Floats,
    short: list[SortieNeed],
    long: list[SortieNeed],
    name: str,
) -> Floats:
    """A straight line in length through both sorties of each course."""
    near = np.array([getattr(need, name) for need in short])
    far = np.array([getattr(need, name) for need in long])
    rate = (far - near) / (LONG_M - SHORT_M)
    return np.interp(course, fan, near) + np.interp(course, fan, rate) * (length_m - SHORT_M)
