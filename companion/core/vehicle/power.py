"""Electrical power in steady flight: the paper's model and a multirotor model.

The paper's `P = P_c + T V_A / c_T` (arXiv 2604.13441, III-B) hardly depends on payload in level
flight, because weight enters only through the climb angle. The multirotor model adds the power to
support the weight: induced power (Glauert's momentum theory), blade profile and parasite power.
All functions accept scalars or arrays that broadcast.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.arrays import Floats
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe

GRAVITY_MPS2 = 9.80665
_PROFILE_ADVANCE = 4.65  # growth of profile power with advance ratio squared (Bramwell, 2001, 3.55)
_NEWTON_STEPS = 12


def drag_with_nose_into_wind_n(
    airframe: Airframe,
    mass_kg: float,
    airspeed_mps: ArrayLike,
    density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
) -> Floats:
    """Return drag with the nose into the relative wind, N."""
    speed = np.asarray(airspeed_mps, float)
    linear, _ = airframe.linear_drag_forward_right_n_per_mps(mass_kg, density_kgpm3)
    quadratic, _ = airframe.quadratic_drag_forward_right_n_per_mps2(mass_kg, density_kgpm3)
    return linear * speed + quadratic * speed**2


def level_airspeed_at_max_tilt_mps(
    airframe: Airframe, mass_kg: float, density_kgpm3: float = REFERENCE_DENSITY_KGPM3
) -> float:
    """Return the level airspeed at which drag equals the horizontal thrust at maximum tilt.

    Solves `k1 V + k2 V^2 = m g tan(tilt)`.
    """
    force = mass_kg * GRAVITY_MPS2 * math.tan(airframe.speeds.max_tilt_rad)
    linear, _ = airframe.linear_drag_forward_right_n_per_mps(mass_kg, density_kgpm3)
    quadratic, _ = airframe.quadratic_drag_forward_right_n_per_mps2(mass_kg, density_kgpm3)
    if quadratic == 0.0:
        return force / linear
    return (math.sqrt(linear**2 + 4.0 * quadratic * force) - linear) / (2.0 * quadratic)


def paper_thrust_n(
    airframe: Airframe, mass_kg: float, airspeed_mps: ArrayLike, air_path_angle_rad: ArrayLike = 0.0
) -> Floats:
    """Return `T = max(D + m g sin gamma, 0)` (arXiv 2604.13441, eq. 12), N, at file density."""
    weight_part = mass_kg * GRAVITY_MPS2 * np.sin(np.asarray(air_path_angle_rad, float))
    return np.maximum(
        drag_with_nose_into_wind_n(airframe, mass_kg, airspeed_mps) + weight_part, 0.0
    )


def paper_power_w(
    airframe: Airframe, mass_kg: float, airspeed_mps: ArrayLike, air_path_angle_rad: ArrayLike = 0.0
) -> Floats:
    """Return `P = P_c + T V_A / c_T` (arXiv 2604.13441, equation 13), W."""
    thrust = paper_thrust_n(airframe, mass_kg, airspeed_mps, air_path_angle_rad)
    speed = np.asarray(airspeed_mps, float)
    power = airframe.power_paper
    return power.constant_w + thrust * speed / power.thrust_power_coefficient


def induced_velocity_mps(
    hover_velocity_mps: ArrayLike, edgewise_flow_mps: ArrayLike, axial_flow_mps: ArrayLike
) -> Floats:
    """Return v of Glauert's `v sqrt(Vx^2 + (Vz + v)^2) = v_h^2` by Newton's method.

    `edgewise` is the flow in the disc plane, `axial` the flow down through it (climb positive).
    `axial` must not be negative, where momentum theory is invalid (vortex ring).
    """
    hover, edgewise, axial = np.broadcast_arrays(
        *(np.asarray(x, float) for x in (hover_velocity_mps, edgewise_flow_mps, axial_flow_mps))
    )
    target = hover**2
    velocity = target / np.sqrt(np.maximum(edgewise**2 + axial**2, target))
    for _ in range(_NEWTON_STEPS):
        resultant = np.maximum(np.hypot(edgewise, axial + velocity), 1e-9)
        error = velocity * resultant - target
        slope = resultant + velocity * (axial + velocity) / resultant
        velocity = np.maximum(velocity - error / slope, 0.0)
    return velocity


def multirotor_power_w(
    airframe: Airframe,
    mass_kg: float,
    airspeed_mps: ArrayLike,
    climb_mps: ArrayLike = 0.0,
    density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
) -> Floats:
    """Return the electrical power of a multirotor in steady flight, W.

    Induced `kappa T v_i`, parasite `D V`, climb `m g V_c`, profile
    `sigma C_d0 / 8 rho A (Omega R)^3 (1 + 4.65 mu^2)` with `Omega R = sqrt(T / (C_T rho A))`
    (Leishman, Principles of Helicopter Aerodynamics, 2.14 and 5.4), over the drive's efficiency,
    plus avionics. Descent costs as much as level flight: no energy is recovered (as in the paper),
    and measured multirotors draw about hover power in descent. The sum is scaled by the measured
    power of this airframe, if its file has any (`measured_over_modelled_power`).

    With `drag.vertical_quadratic_n_per_mps2` in the airframe file, thrust and parasite power use
    the body axes. Tilt does not change, since drag along the rotor axis does not affect it. Thrust
    is `m g cos tilt` plus the download of the rotor flow on the body, which adds to parasite power.
    Rotor drag, the linear part, costs no power except the growth of profile power with speed: 4.65
    includes the work of the in-plane force (Leishman, 5.4.2).
    """
    rotor = airframe.power_rotor
    speed = np.asarray(airspeed_mps, float)
    climb = np.maximum(np.asarray(climb_mps, float), 0.0)
    weight = mass_kg * GRAVITY_MPS2
    drag = drag_with_nose_into_wind_n(airframe, mass_kg, speed, density_kgpm3)
    thrust = np.hypot(weight, drag)
    sin_tilt, cos_tilt = drag / thrust, weight / thrust
    area = density_kgpm3 * rotor.disc_area_m2
    edgewise = speed * cos_tilt
    axial = speed * sin_tilt + climb * cos_tilt
    parasite = drag * speed
    vertical = airframe.vertical_flow_drag_n_per_mps2(density_kgpm3)
    if vertical is not None:
        edgewise = edgewise - climb * sin_tilt
        download = vertical * np.hypot(speed, climb) * axial
        rotor_drag = (
            airframe.linear_drag_forward_right_n_per_mps(mass_kg, density_kgpm3)[0] * edgewise
        )
        thrust = weight * cos_tilt + download
        parasite = download * axial + (weight * sin_tilt - rotor_drag) * edgewise
    induced = induced_velocity_mps(np.sqrt(thrust / (2.0 * area)), edgewise, axial)
    tip_speed = np.sqrt(thrust / (rotor.thrust_coefficient * area))
    advance = edgewise / tip_speed
    profile = (
        (rotor.solidity * rotor.blade_drag_coefficient / 8.0)
        * (area * tip_speed**3)
        * (1.0 + _PROFILE_ADVANCE * advance**2)
    )
    shaft = rotor.induced_factor * thrust * induced + parasite + weight * climb + profile
    return measured_over_modelled_power(airframe, climb_mps) * (
        shaft / rotor.drive_efficiency + rotor.avionics_w
    )


def measured_over_modelled_power(airframe: Airframe, climb_mps: ArrayLike) -> Floats:
    """Return measured over modelled power at this climb rate, from `power_flown`; default 1.

    Linear in the rate from level flight to a climb or descent at 1 m/s, constant beyond.
    """
    flown, climb = airframe.power_flown, np.asarray(climb_mps, float)
    if flown is None:
        return np.ones_like(climb)
    up, down = np.clip(climb, 0.0, 1.0), np.clip(-climb, 0.0, 1.0)
    level = flown.level_frac
    return level + (flown.climb_frac - level) * up + (flown.descent_frac - level) * down
