"""Vehicle of the studies: its true power at one airspeed, and the planner's model of it.

The shipped parameters hold at the airframe's own cruise speed. A study picks the airspeed that
gives the requested wind over airspeed. So the power model of the planner is fitted to a calibration
flight at that airspeed: cruise and hover, loaded and empty, in a steady wind.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from msgspec.structs import replace
from scipy.optimize import least_squares

from companion.adapters.files.params import params_dir, read_airframe
from companion.core.base.arrays import Floats
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w
from sim_bridge.research.promise.truth import Profile, TruePower
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.steady_flight import SteadyFlight

AIRFRAME = "m100"  # the planner's and the truth's
SLOWEST_MPS, FASTEST_MPS = 3.0, 30.0
WIND_OVER_AIR = {"hard": 0.4, "easy": 0.4, "stress": 0.63}
_HOVER_WIND_OVER_AIR = 0.4  # of the calibration flight
_FITTED = 4


@dataclass(frozen=True, slots=True)
class StudyVehicle:
    """True power and flight profile, and the planner's energy model."""

    power: TruePower
    route_energy: RouteEnergy


def airspeed_for_wind_mps(mean_wind_mps: float, wind_over_air: float) -> float:
    """Return the airspeed that gives mean wind over airspeed, within the vehicle's limits."""
    return min(max(mean_wind_mps / wind_over_air, SLOWEST_MPS), FASTEST_MPS)


@lru_cache(maxsize=2)
def vehicle_at_airspeed(airspeed_mps: float) -> StudyVehicle:
    """Return the vehicle that flies at this airspeed, built once per process."""
    profile = Profile(airspeed_mps)
    truth = load_airframe(params_dir() / "truth" / f"{AIRFRAME}.toml")
    steady = SteadyFlight(truth)
    hover_mps = _HOVER_WIND_OVER_AIR * profile.airspeed_mps
    power_w_by_payload_and_speed = {
        (payload, speed): steady.level_flight_power_w(speed, payload)
        for payload in (0.0, profile.payload_kg)
        for speed in (hover_mps, profile.airspeed_mps)
    }
    airframe = calibrate_airframe(read_airframe(AIRFRAME), power_w_by_payload_and_speed)
    speeds = replace(
        airframe.speeds,
        max_ground_mps=60.0,
        max_tilt_deg=60.0,
        climb_mps=profile.climb_mps,
        descent_mps=profile.descent_mps,
        landing_mps=profile.landing_mps,
        land_slow_height_m=profile.land_slow_height_m,
        accel_mps2=profile.accel_mps2,
    )
    route_energy = RouteEnergy(
        replace(airframe, speeds=speeds),
        cruise_airspeed_mps=profile.airspeed_mps,
        speed_rule="cruise",
        fixed_airspeed=True,
    )
    return StudyVehicle(TruePower(truth, profile), route_energy)


def calibrate_airframe(
    airframe: Airframe, power_w_by_payload_and_speed: dict[tuple[float, float], float]
) -> Airframe:
    """Airframe with drag, parcel drag, induced factor and drive efficiency fitted to mean powers.

    Nonlinear least squares on log power, with weak regularisation towards the given airframe.
    """
    measured_w = np.array(list(power_w_by_payload_and_speed.values()))

    def scaled_airframe(scale_factors: Floats) -> Airframe:
        forward, parcel, induced, efficiency = scale_factors.tolist()
        drag, rotor = airframe.drag, airframe.power_rotor
        parcel_drag = max(drag.parcel_quadratic_n_per_mps2 + 0.02 * (parcel - 1.0), 0.0)
        return replace(
            airframe,
            drag=replace(
                drag,
                quadratic_forward_n_per_mps2=drag.quadratic_forward_n_per_mps2 * forward,
                parcel_quadratic_n_per_mps2=parcel_drag,
            ),
            power_rotor=replace(
                rotor,
                induced_factor=rotor.induced_factor * induced,
                drive_efficiency=min(rotor.drive_efficiency * efficiency, 1.0),
            ),
        )

    def log_power_residuals(scale_factors: Floats) -> Floats:
        candidate = scaled_airframe(scale_factors)
        predicted_w = [
            float(multirotor_power_w(candidate, candidate.flying_mass_kg(payload_kg), airspeed_mps))
            for payload_kg, airspeed_mps in power_w_by_payload_and_speed
        ]
        return np.concatenate([np.log(predicted_w / measured_w), 0.01 * (scale_factors - 1.0)])

    return scaled_airframe(
        least_squares(log_power_residuals, np.ones(_FITTED), bounds=(0.6, 1.7)).x
    )
