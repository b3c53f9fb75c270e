"""Electrical power in steady flight: the paper's model and a multirotor model.

The paper's `P = P_c + T V_A / c_T` (arXiv 2604.13441, III-B) hardly depends on payload in level
flight, because weight enters only through the climb angle. The multirotor model adds what a rotor
needs to carry weight: induced power (Glauert's momentum theory), blade profile power and parasite
power.
All functions take scalars or arrays that broadcast.
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


def drag_n(
    airframe: Airframe,
    mass_kg: float,
    airspeed_mps: ArrayLike,
    density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
) -> Floats:
    """Drag nose into the relative wind, N."""
    speed = np.asarray(airspeed_mps, float)
    linear, _ = airframe.drag_linear_n_per_mps(mass_kg, density_kgpm3)
    quadratic, _ = airframe.drag_quadratic_n_per_mps2(mass_kg, density_kgpm3)
    return linear * speed + quadratic * speed**2


def max_airspeed_mps(
    airframe: Airframe, mass_kg: float, density_kgpm3: float = REFERENCE_DENSITY_KGPM3
) -> float:
    """Level airspeed at which drag balances the horizontal thrust of the largest tilt.

    Solves `k1 V + k2 V^2 = m g tan(tilt)`.
    """
    force = mass_kg * GRAVITY_MPS2 * math.tan(airframe.speeds.max_tilt_rad)
    linear, _ = airframe.drag_linear_n_per_mps(mass_kg, density_kgpm3)
    quadratic, _ = airframe.drag_quadratic_n_per_mps2(mass_kg, density_kgpm3)
    if quadratic == 0.0:
        return force / linear
    return (math.sqrt(linear**2 + 4.0 * quadratic * force) - linear) / (2.0 * quadratic)


def paper_thrust_n(
    airframe: Airframe, mass_kg: float, airspeed_mps: ArrayLike, air_path_angle_rad: ArrayLike = 0.0
) -> Floats:
    """`T = max(D + m g sin gamma, 0)` (arXiv 2604.13441, equation 12), N, at the file's density."""
    weight_part = mass_kg * GRAVITY_MPS2 * np.sin(np.asarray(air_path_angle_rad, float))
    return np.maximum(drag_n(airframe, mass_kg, airspeed_mps) + weight_part, 0.0)


def paper_power_w(
    airframe: Airframe, mass_kg: float, airspeed_mps: ArrayLike, air_path_angle_rad: ArrayLike = 0.0
) -> Floats:
    """`P = P_c + T V_A / c_T` (arXiv 2604.13441, equation 13), W."""
    thrust = paper_thrust_n(airframe, mass_kg, airspeed_mps, air_path_angle_rad)
    speed = np.asarray(airspeed_mps, float)
    power = airframe.power_paper
    return power.constant_w + thrust * speed / power.thrust_power_coefficient


def induced_velocity_mps(
    hover_velocity_mps: ArrayLike, edgewise_mps: ArrayLike, through_mps: ArrayLike
) -> Floats:
    """Induced velocity v of Glauert's `v sqrt(Vx^2 + (Vz + v)^2) = v_h^2`, Newton's method.

    `edgewise` is the flow along the disc, `through` the flow down through it (climb positive);
    `through` must not be negative, where momentum theory ends (vortex ring).
    """
    hover, edgewise, through = np.broadcast_arrays(
        *(np.asarray(x, float) for x in (hover_velocity_mps, edgewise_mps, through_mps))
    )
    target = hover**2
    velocity = target / np.sqrt(np.maximum(edgewise**2 + through**2, target))
    for _ in range(_NEWTON_STEPS):
        resultant = np.maximum(np.hypot(edgewise, through + velocity), 1e-9)
        error = velocity * resultant - target
        slope = resultant + velocity * (through + velocity) / resultant
        velocity = np.maximum(velocity - error / slope, 0.0)
    return velocity


def multirotor_power_w(
    airframe: Airframe,
    mass_kg: float,
    airspeed_mps: ArrayLike,
    climb_mps: ArrayLike = 0.0,
    density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
) -> Floats:
    """Electrical power of a multirotor in steady flight, W.

    Induced `kappa T v_i`, parasite `D V`, climb `m g V_c`, profile
    `sigma C_d0 / 8 rho A (Omega R)^3 (1 + 4.65 mu^2)` with `Omega R = sqrt(T / (C_T rho A))`
    (Leishman, Principles of Helicopter Aerodynamics, 2.14 and 5.4), over the drive's efficiency,
    plus avionics. Descent is priced as level flight: no energy comes back (as in the paper), and
    multirotors measured in descent draw about hover power. All of it is scaled by what flights of
    this airframe drew, where its file says so (`flown_frac`).

    Where the airframe states `drag.vertical_quadratic_n_per_mps2`, thrust and parasite power follow
    the body's axes. Tilt is as before (drag along the rotors' axis does not change it), but thrust
    is `m g cos tilt` plus what the flow through the rotors presses on the vehicle's top, which
    parasite power pays too; and rotors' own drag, the linear part, costs no power beside the
    profile's growth with speed: 4.65 holds the in-plane force's work (Leishman, 5.4.2).
    """
    rotor = airframe.power_rotor
    speed = np.asarray(airspeed_mps, float)
    climb = np.maximum(np.asarray(climb_mps, float), 0.0)
    weight = mass_kg * GRAVITY_MPS2
    drag = drag_n(airframe, mass_kg, speed, density_kgpm3)
    thrust = np.hypot(weight, drag)
    sin_tilt, cos_tilt = drag / thrust, weight / thrust
    area = density_kgpm3 * rotor.disc_area_m2
    edgewise = speed * cos_tilt
    through = speed * sin_tilt + climb * cos_tilt
    parasite = drag * speed
    vertical = airframe.drag_vertical_n_per_mps2(density_kgpm3)
    if vertical is not None:
        edgewise = edgewise - climb * sin_tilt
        download = vertical * np.hypot(speed, climb) * through
        rotor_drag = airframe.drag_linear_n_per_mps(mass_kg, density_kgpm3)[0] * edgewise
        thrust = weight * cos_tilt + download
        parasite = download * through + (weight * sin_tilt - rotor_drag) * edgewise
    induced = induced_velocity_mps(np.sqrt(thrust / (2.0 * area)), edgewise, through)
    tip_speed = np.sqrt(thrust / (rotor.thrust_coefficient * area))
    advance = edgewise / tip_speed
    profile = (
        (rotor.solidity * rotor.blade_drag_coefficient / 8.0)
        * (area * tip_speed**3)
        * (1.0 + _PROFILE_ADVANCE * advance**2)
    )
    shaft = rotor.induced_factor * thrust * induced + parasite + weight * climb + profile
    return flown_frac(airframe, climb_mps) * (shaft / rotor.drive_efficiency + rotor.avionics_w)


def flown_frac(airframe: Airframe, climb_mps: ArrayLike) -> Floats:
    """Measured over modelled power at this climb rate, by `power_flown`; 1 without that table.

    From level flight to that of a climb or a descent in proportion to the rate, up to 1 m/s.
    """
    flown, climb = airframe.power_flown, np.asarray(climb_mps, float)
    if flown is None:
        return np.ones_like(climb)
    up, down = np.clip(climb, 0.0, 1.0), np.clip(-climb, 0.0, 1.0)
    level = flown.level_frac
    return level + (flown.climb_frac - level) * up + (flown.descent_frac - level) * down
