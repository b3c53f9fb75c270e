"""Wind from a log: write three minutes of telemetry by closed form, and estimate its wind.

A multirotor flies circles in a steady wind. Its tilt balances drag and turn, so the wind is in the
log although no sensor measures it.

    python examples/wind_from_a_log.py
"""

# %%
import csv
import math
import tempfile
from pathlib import Path

import companion
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3

WIND_TO_NE_MPS = (-3.0, 4.0)  # where the air moves to
SPEED_MPS, TURN_S = 6.0, 60.0  # over the ground; time of a circle
GRAVITY_MPS2 = 9.80665
REFERENCE = ("wind_to_n_ref_mps", "wind_to_e_ref_mps")  # an anemometer's; no estimator reads it
COLUMNS = (
    "t_s",
    "vel_n_mps",
    "vel_e_mps",
    "vel_d_mps",
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
    *REFERENCE,
)


def row_at(t_s: float, airframe: companion.Airframe) -> list[float]:
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
    return [t_s, north, east, 0.0, math.degrees(roll), math.degrees(pitch), 0.0, *WIND_TO_NE_MPS]


def write_log(path: Path, airframe: companion.Airframe) -> None:
    """Three minutes at 10 Hz."""
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        table.writerows(row_at(0.1 * k, airframe) for k in range(1800))


def main() -> None:
    """Write, estimate, compare."""
    airframe = companion.read_airframe("m100")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "circles.csv"
        write_log(path, airframe)
        wind = companion.estimate_wind(path, airframe)
    to_n_mps, to_e_mps = wind.to_ne_mps[-1]
    print(
        f"wind blown:     {WIND_TO_NE_MPS[0]:+.2f} m/s to north, {WIND_TO_NE_MPS[1]:+.2f} to east"
    )
    print(f"wind estimated: {to_n_mps:+.2f} m/s to north, {to_e_mps:+.2f} to east")
    print(
        f"from {wind.from_deg[-1]:.0f} degrees, {len(wind.t_s)} rows: {', '.join(wind.to_dict())}"
    )


if __name__ == "__main__":
    main()
