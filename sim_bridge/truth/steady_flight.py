"""Tilt, thrust and power of steady flight: the equilibrium of the dynamic model.

Fast enough to integrate a whole mission, for a planner with perfect knowledge and experiments.
"""

import math
from dataclasses import dataclass

from sim_bridge.truth.airframe import rotor_drag_factor
from sim_bridge.truth.atmosphere import GRAVITY_MPS2, STANDARD_DENSITY_KGPM3
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.rotor_power import RotorSet


@dataclass(frozen=True, slots=True)
class SteadyState:
    """`tilt_rad` is positive nose down; `power_w` is electric, at the battery's terminals."""

    tilt_rad: float
    thrust_n: float
    power_w: float


class SteadyFlight:
    """Steady flight of one airframe, nose into the relative wind, in air of one density."""

    def __init__(
        self, params: AirframeTruth, density_kgpm3: float = STANDARD_DENSITY_KGPM3
    ) -> None:
        self._params = params
        self._density = density_kgpm3
        self._rotors = RotorSet(params.rotors, density_kgpm3)
        self._reference_thrust_n = params.empty_mass_kg * GRAVITY_MPS2

    def steady_state(
        self,
        airspeed_mps: float,
        *,
        payload_kg: float = 0.0,
        climb_mps: float = 0.0,
    ) -> SteadyState:
        """Steady state at a HORIZONTAL airspeed and a climb rate (negative: descent).

        Balance of forces along body x and z with the drag of `airframe.Airframe`, by fixed-point
        iteration on tilt and thrust.
        """
        drag = self._params.drag
        parcel_m2 = drag.parcel_area_m2 if payload_kg > 0.0 else 0.0
        weight_n = (self._params.empty_mass_kg + payload_kg) * GRAVITY_MPS2
        speed = math.hypot(airspeed_mps, climb_mps)
        pressure = 0.5 * self._density * speed
        tilt, thrust_n = 0.0, weight_n
        forward = down = rotor_n = 0.0
        for _ in range(200):
            flow = rotor_drag_factor(thrust_n / self._reference_thrust_n, self._density)
            rotor_k = drag.rotor_forward_nspm * flow
            sin_t, cos_t = math.sin(tilt), math.cos(tilt)
            forward = airspeed_mps * cos_t - climb_mps * sin_t
            down = -airspeed_mps * sin_t - climb_mps * cos_t
            rotor_n = rotor_k * forward
            axial_n = rotor_n + pressure * (drag.parasite_forward_m2 + parcel_m2) * forward
            lift_n = weight_n * cos_t - pressure * drag.parasite_vertical_m2 * down
            error = math.asin(max(-1.0, min(1.0, axial_n / weight_n))) - tilt
            change = abs(error) + abs(lift_n - thrust_n) / weight_n
            tilt += 0.7 * error
            thrust_n = max(lift_n, 0.0)
            if change < 1e-10:
                break
        propulsive_w = -thrust_n * down - rotor_n * forward
        return SteadyState(
            tilt, thrust_n, self._rotors.electrical_power_w(thrust_n, speed, propulsive_w)
        )

    def level_flight_power_w(self, airspeed_mps: float, payload_kg: float = 0.0) -> float:
        """Electric power in W in level flight at an airspeed (0: hover in still air)."""
        return self.steady_state(airspeed_mps, payload_kg=payload_kg).power_w

    def hover_power_w(self, payload_kg: float = 0.0) -> float:
        """Electric power in W of a hover in still air."""
        return self.level_flight_power_w(0.0, payload_kg)

    def level_airspeed_at_tilt_mps(self, tilt_rad: float, payload_kg: float = 0.0) -> float:
        """The airspeed at which level flight needs this tilt (bisection up to 60 m/s)."""
        low, high = 0.0, 60.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            if self.steady_state(middle, payload_kg=payload_kg).tilt_rad < tilt_rad:
                low = middle
            else:
                high = middle
        return low
