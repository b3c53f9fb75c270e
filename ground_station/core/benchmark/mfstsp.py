"""The multiple flying sidekicks travelling salesman problem (mFSTSP) as a truck-and-drones problem.

C. C. Murray, R. Raj, "The multiple flying sidekicks traveling salesman problem: Parcel delivery
with multiple drones", Transportation Research C 110 (2020): the truck is at the depot for launches
there, the driver does one task at a time, and endurance is non-linear (their Etype 1). Its power
model is Liu, Sengupta, Kurzhanskiy, "A power consumption model for multi-rotor small unmanned
aircraft systems", ICUAS 2017.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from ground_station.core.truck_drones.problem import DroneKind, LegTables, TruckAndDrones

EARTH_RADIUS_M = 6_378_100.0  # the sphere of the problems' authors, part of the problem
POUND_KG = 0.453592
DRONE_MASS_KG = 1.5
GRAVITY_MPS2 = 9.8
HALF_TURN_DEG = 180.0

# Liu et al. (2017), with the numbers of the authors of the problems.
LIFT_SPEED_N_S2PM2 = 0.0279
INCIDENCE_RAD = math.radians(10.0)
DRAG_N_S2PM2 = 0.0296
INDUCED_FACTOR = 0.8554
INDUCED_SQRT_N_SPM = 0.3051
PROFILE_W_PN15 = 0.3177
PARASITE_W_S3PM3 = 0.0296


@dataclass(frozen=True, slots=True)
class MfstspDrone:
    """One row of a vehicle file."""

    takeoff_mps: float
    cruise_mps: float
    landing_mps: float
    yaw_rate_degps: float
    cruise_alt_m: float
    capacity_lb: float
    launch_s: float
    recover_s: float
    service_s: float
    battery_j: float

    @property
    def climb_and_turn_s(self) -> float:
        """Climb to cruise height, and a half turn."""
        return self.cruise_alt_m / self.takeoff_mps + HALF_TURN_DEG / self.yaw_rate_degps

    @property
    def landing_s(self) -> float:
        """Descent from cruise height."""
        return self.cruise_alt_m / self.landing_mps


@dataclass(frozen=True, slots=True)
class MfstspData:
    """A problem folder: node 0 is the depot, 1 to c the customers."""

    lat_deg: Floats
    lon_deg: Floats
    parcel_lb: Floats
    travel_s: Floats


def level_flight_thrust_n(parcel_kg: Floats, airspeed_mps: float) -> Floats:
    """Return the rotor thrust in level flight."""
    lift_n = LIFT_SPEED_N_S2PM2 * (airspeed_mps * math.cos(INCIDENCE_RAD)) ** 2
    weight_n = (DRONE_MASS_KG + parcel_kg) * GRAVITY_MPS2
    return np.hypot(weight_n - lift_n, DRAG_N_S2PM2 * airspeed_mps**2)


def induced_and_profile_power_w(rotor_thrust_n: Floats, vertical_mps: float) -> Floats:
    """Return the power of the rotors at this thrust."""
    half = vertical_mps / 2.0
    induced_w = (
        INDUCED_FACTOR
        * rotor_thrust_n
        * (half + np.sqrt(half**2 + rotor_thrust_n / INDUCED_SQRT_N_SPM**2))
    )
    return induced_w + PROFILE_W_PN15 * rotor_thrust_n**1.5


def cruise_power_w(parcel_kg: Floats, airspeed_mps: float) -> Floats:
    """Return the power of level flight."""
    rotors_w = induced_and_profile_power_w(level_flight_thrust_n(parcel_kg, airspeed_mps), 0.0)
    return rotors_w + PARASITE_W_S3PM3 * airspeed_mps**3


def take_off_and_landing_energy_j(drone: MfstspDrone, parcel_kg: Floats) -> Floats:
    """Return the energy of a take-off and a landing."""
    rotor_thrust_n = level_flight_thrust_n(parcel_kg, 0.0)
    up_w = induced_and_profile_power_w(rotor_thrust_n, drone.takeoff_mps)
    down_w = induced_and_profile_power_w(rotor_thrust_n, drone.landing_mps)
    return drone.climb_and_turn_s * up_w + drone.landing_s * down_w


def haversine_distances_m(lat_deg: Floats, lon_deg: Floats) -> Floats:
    """Return the distances between all nodes (haversine)."""
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    half_chord_2 = (
        np.sin((lat[:, None] - lat[None, :]) / 2.0) ** 2
        + np.cos(lat[:, None])
        * np.cos(lat[None, :])
        * np.sin((lon[:, None] - lon[None, :]) / 2.0) ** 2
    )
    return 2.0 * EARTH_RADIUS_M * np.arcsin(np.sqrt(half_chord_2))


@dataclass(frozen=True, slots=True)
class EtypeOneEndurance:
    """The authors' non-linear endurance as a sortie model: one kind of drone."""

    drone: MfstspDrone
    parcel_kg: Floats
    distance_m: Floats

    def leg_tables(self, drone_kind: int) -> LegTables:
        """Return take-off, flight, landing, and outbound the service, which costs no energy."""
        drone, empty_kg = self.drone, np.zeros(1)
        flight_s = self.distance_m / drone.cruise_mps
        leg_s = drone.climb_and_turn_s + flight_s + drone.landing_s
        hover_w = float(induced_and_profile_power_w(level_flight_thrust_n(empty_kg, 0.0), 0.0)[0])
        out_j = take_off_and_landing_energy_j(drone, self.parcel_kg) + flight_s * cruise_power_w(
            self.parcel_kg, drone.cruise_mps
        )
        back_j = take_off_and_landing_energy_j(drone, empty_kg) + flight_s * cruise_power_w(
            empty_kg, drone.cruise_mps
        )
        return LegTables(
            out_s=leg_s + drone.service_s,
            back_s=leg_s,
            out_hover_s=out_j / hover_w,
            back_hover_s=back_j / hover_w,
            endurance_hover_s=drone.battery_j / hover_w,
        )


def truck_and_drones_problem(
    data: MfstspData, drone: MfstspDrone, drone_count: int, truck_delivery_s: float
) -> TruckAndDrones:
    """Return the problem with the depot's copy appended as the last node."""
    customers = len(data.travel_s) - 1
    at = np.append(np.arange(customers + 1), 0)
    parcel_lb = np.append(data.parcel_lb, 0.0)
    parcel_lb[0] = 0.0
    is_customer = np.ones(customers + 2, dtype=np.bool_)
    is_customer[[0, -1]] = False
    model = EtypeOneEndurance(
        drone, parcel_lb * POUND_KG, haversine_distances_m(data.lat_deg[at], data.lon_deg[at])
    )
    kind = DroneKind(
        count=drone_count,
        launch_s=drone.launch_s,
        recover_s=drone.recover_s,
        can_serve=is_customer & (parcel_lb <= drone.capacity_lb),
    )
    return TruckAndDrones(
        travel_s=data.travel_s[np.ix_(at, at)],
        deliver_s=np.where(is_customer, truck_delivery_s, 0.0),
        kinds=(kind,),
        leg_tables=(model.leg_tables(0),),
        truck_can_serve=is_customer,
    )
