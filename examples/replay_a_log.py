"""Replay a log: write three minutes of telemetry by closed form, and find the wind in it.

A multirotor flies circles in a steady wind. Its tilt balances drag and turn, so the wind is in the
log although no sensor measures it. Run it from a checkout or an installed package:

    python examples/replay_a_log.py
"""

import csv
import math
import tempfile
from pathlib import Path

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.analysis.replay.flight_replay import ReplayConfig, replay_flight
from companion.analysis.replay.summary import summarise_wind_in_flight
from companion.core.base.location import Location
from companion.core.mission.flight_file import Flight, Site, Vehicle
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe

WIND_TO_NE_MPS = (-3.0, 4.0)  # where the air moves to
SPEED_MPS, TURN_S = 6.0, 60.0  # over the ground; time of a circle
GRAVITY_MPS2 = 9.80665
COLUMNS = ("t_s", "vel_n_mps", "vel_e_mps", "vel_d_mps", "roll_deg", "pitch_deg", "yaw_deg")


def row_at(t_s: float, airframe: Airframe) -> list[float]:
    """Telemetry of a vehicle that keeps its nose north: thrust carries drag and acceleration."""
    rate = 2.0 * math.pi / TURN_S
    north, east = SPEED_MPS * math.cos(rate * t_s), SPEED_MPS * math.sin(rate * t_s)
    accel_n, accel_e = -rate * east, rate * north
    mass_kg = airframe.flying_mass_kg(payload_kg=0.0)
    air_n, air_e = north - WIND_TO_NE_MPS[0], east - WIND_TO_NE_MPS[1]
    flying = (mass_kg, REFERENCE_DENSITY_KGPM3)
    linear_n, linear_e = airframe.linear_drag_forward_right_n_per_mps(*flying)
    square_n, square_e = airframe.quadratic_drag_forward_right_n_per_mps2(*flying)
    speed = math.hypot(air_n, air_e)
    thrust_n = accel_n + (linear_n + square_n * speed) * air_n / mass_kg
    thrust_e = accel_e + (linear_e + square_e * speed) * air_e / mass_kg
    pitch = -math.atan(thrust_n / GRAVITY_MPS2)
    roll = math.atan(thrust_e * math.cos(pitch) / GRAVITY_MPS2)
    return [t_s, north, east, 0.0, math.degrees(roll), math.degrees(pitch), 0.0]


def write_log(path: Path, airframe: Airframe) -> None:
    """Three minutes at 10 Hz."""
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        table.writerows(row_at(0.1 * k, airframe) for k in range(1800))


def main() -> None:
    """Write, replay, compare."""
    airframe = read_airframe("m100")
    flight = Flight(
        format="flight/1",
        site=Site(customer=Location(east_m=0.0, north_m=0.0)),
        vehicle=Vehicle(airframe=airframe.name),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "circles.csv"
        write_log(path, airframe)
        log = read_log_of_any_format(path)
    terms = ReplayConfig(airframe, flight, read_wind_process("coast"), False, False)
    wind = summarise_wind_in_flight(replay_flight(log, terms))
    assert wind is not None
    print(
        f"wind blown:     {WIND_TO_NE_MPS[0]:+.2f} m/s to north, {WIND_TO_NE_MPS[1]:+.2f} to east"
    )
    print(
        f"wind estimated: {wind.mean_to_n_mps:+.2f} m/s to north, {wind.mean_to_e_mps:+.2f} to east"
    )
    print(f"its own error:  {wind.mean_std_mps:.2f} m/s")


if __name__ == "__main__":
    main()
