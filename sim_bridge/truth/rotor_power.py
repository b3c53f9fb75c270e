"""Rotor power: induced, profile and parasite power, and the power from the battery.

Sources, by equation: Leishman, Principles of Helicopter Aerodynamics, 2nd ed. (2006): momentum
theory in hover, climb and forward flight 2.2, 2.13, 2.14; profile power with forward speed 5.4.2
(K = 4.65 covers the torque and the in-plane force of profile drag, and radial flow). Vortex ring
state: Johnson's fit as used in CAMRAD (NASA TM-81182, 1980).

Energy method. Let F be the force of all rotors on the airframe (thrust and rotor drag) and v the
vehicle's velocity through the air. Then shaft power = induced + profile + F.v in any flight state.
In steady level flight F.v is the airframe's parasite power; a climb adds weight times climb rate,
acceleration adds mass times acceleration times speed. Rotor drag (the disk plane tilts back under
forward speed) tilts the body forward but takes no power of its own.
"""

import math
from dataclasses import dataclass

from sim_bridge.truth.params import RotorParams

_NO_THRUST_N = 1e-3


@dataclass(frozen=True, slots=True)
class RotorPowerParts:
    """Shaft power in W by cause, all rotors. `propulsive_w` is F.v of the energy method."""

    induced_w: float
    profile_w: float
    propulsive_w: float

    @property
    def shaft_w(self) -> float:
        """Rotors that drive their motors give nothing back to the battery: never negative."""
        return max(self.induced_w + self.profile_w + self.propulsive_w, 0.0)


def induced_velocity_ratio(descent_ratio: float, inplane_ratio: float) -> float:
    """Induced velocity over its hover value v_h; both speeds are also over v_h.

    `descent_ratio` is the speed along the rotor axis against the thrust (positive in descent),
    `inplane_ratio` the speed across it. Glauert's momentum equation
    x sqrt(mu^2 + (x - d)^2) = 1 (Leishman eq. 2.126), with Newton steps from the side on which
    they converge monotonically; inside 1.5 mu^2 + (2 d - 3)^2 < 1, where the wake folds back and
    momentum theory does not apply, Johnson's fit x = d (1.991 - 0.373 d^2 - 0.598 mu^2).
    """
    d, mu2 = descent_ratio, inplane_ratio * inplane_ratio
    ring = 2.0 * d - 3.0
    if 1.5 * mu2 + ring * ring < 1.0:
        return d * (1.991 - 0.373 * d * d - 0.598 * mu2)
    if d <= 0.0:
        x = 1.0  # g(1) >= 0 and g is convex to its right root
    elif d <= 1.5:
        x = d + 1.0
    else:
        x = 0.0  # windmill-brake branch: g is concave up to its least root
    for _ in range(30):
        axial = x - d
        flow2 = mu2 + axial * axial
        flow = math.sqrt(flow2)
        if flow == 0.0:
            break
        step = (x * flow - 1.0) / (flow + x * axial / flow)
        x -= step
        if -1e-9 < step < 1e-9:
            break
    return x


class RotorSet:
    """The rotors of one vehicle in air of one density."""

    __slots__ = (
        "_avionics_w",
        "_disk_density",
        "_efficiency",
        "_induced_factor",
        "_profile_speed",
        "_profile_unit",
        "_tip_speed_unit",
        "disk_area_m2",
    )

    def __init__(self, params: RotorParams, density_kgpm3: float) -> None:
        self.disk_area_m2 = params.count * math.pi * params.radius_m**2
        self._disk_density = density_kgpm3 * self.disk_area_m2
        self._induced_factor = params.induced_factor
        self._profile_speed = params.profile_speed_factor
        self._efficiency = params.drive_efficiency_frac
        self._avionics_w = params.avionics_w
        # (Omega R)^2 = T / (rho A C_T); P_0 = rho A sigma c_d0 / 8 (Omega R)^3
        self._tip_speed_unit = 1.0 / math.sqrt(self._disk_density * params.thrust_coeff)
        self._profile_unit = self._disk_density * params.solidity * params.profile_drag_coeff / 8.0

    def shaft_power_parts(
        self, thrust_n: float, airspeed_mps: float, propulsive_w: float
    ) -> RotorPowerParts:
        """Shaft power by cause for a thrust, the speed through the air, and F.v (signed)."""
        if thrust_n < _NO_THRUST_N:
            return RotorPowerParts(0.0, 0.0, 0.0)
        hover_mps = math.sqrt(thrust_n / (2.0 * self._disk_density))
        axial_mps = propulsive_w / thrust_n
        inplane2 = airspeed_mps * airspeed_mps - axial_mps * axial_mps
        if inplane2 < 0.0:
            inplane2 = 0.0
        ratio = induced_velocity_ratio(-axial_mps / hover_mps, math.sqrt(inplane2) / hover_mps)
        tip_mps = self._tip_speed_unit * math.sqrt(thrust_n)
        advance2 = inplane2 / (tip_mps * tip_mps)
        return RotorPowerParts(
            induced_w=self._induced_factor * thrust_n * hover_mps * ratio,
            profile_w=self._profile_unit * tip_mps**3 * (1.0 + self._profile_speed * advance2),
            propulsive_w=propulsive_w,
        )

    def electrical_power_w(
        self, thrust_n: float, airspeed_mps: float, propulsive_w: float
    ) -> float:
        """Power at the battery's terminals: shaft power through motors and ESCs, and avionics."""
        shaft_w = self.shaft_power_parts(thrust_n, airspeed_mps, propulsive_w).shaft_w
        return shaft_w / self._efficiency + self._avionics_w
