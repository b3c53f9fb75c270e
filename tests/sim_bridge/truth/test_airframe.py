"""Motion of the body: conservation of energy, closed forms, and the steady solver."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from sim_bridge.truth.airframe import Airframe
from sim_bridge.truth.atmosphere import air_density_kgpm3
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.rotor_power import RotorSet
from sim_bridge.truth.steady_flight import SteadyFlight

G = 9.80665
FOLDER = Path(__file__).parents[3] / "params" / "truth"
M100 = load_airframe(FOLDER / "m100.toml")
STILL = (0.0, 0.0, 0.0)


@pytest.mark.sample
def test_rotor_work_is_kinetic_plus_potential_energy_plus_parasite_loss() -> None:
    """Conservation of energy over 20 s of wild flight in still air, to 0.5 %."""
    body, mass_kg, dt_s = Airframe(M100), 3.65, 0.0005
    rng = np.random.default_rng(5)
    work_j = lost_j = 0.0
    drag = M100.drag
    for step in range(40_000):
        if step % 2000 == 0:
            roll, pitch = rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.0)
            thrust_n = mass_kg * G * rng.uniform(0.7, 1.5)
        body.advance_attitude_towards_setpoint(roll, pitch, 0.3, dt_s)
        body.integrate_motion(thrust_n, mass_kg, STILL, 1.225, 0.0, dt_s)
        work_j += body.propulsive_w * dt_s
        velocity = np.array([body.north_mps, body.east_mps, body.down_mps])
        u, v, w = _body_axes(body) @ velocity
        speed = np.linalg.norm(velocity)
        areas = (drag.parasite_forward_m2, drag.parasite_sideways_m2, drag.parasite_vertical_m2)
        lost_j += 0.5 * 1.225 * speed * np.dot(areas, (u * u, v * v, w * w)) * dt_s
    kinetic_j = 0.5 * mass_kg * (body.north_mps**2 + body.east_mps**2 + body.down_mps**2)
    potential_j = -mass_kg * G * body.down_m
    assert lost_j > 500.0
    assert work_j == pytest.approx(kinetic_j + potential_j + lost_j, rel=0.005)


def _body_axes(body: Airframe) -> np.ndarray:
    """Rows: forward, right, down of the body in NED (Rz Ry Rx of the Euler angles)."""
    roll, pitch, yaw = body.roll_rad, body.pitch_rad, body.yaw_rad
    rx = np.array(
        [[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]]
    )
    ry = np.array(
        [[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]]
    )
    rz = np.array(
        [[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]]
    )
    return (rz @ ry @ rx).T


def test_a_fall_without_motors_ends_at_terminal_velocity() -> None:
    """Closed form: v = sqrt(2 m g / (rho A)), no rotor drag without thrust."""
    body = Airframe(M100)
    for _ in range(3000):
        body.integrate_motion(0.0, 3.65, STILL, 1.225, 0.0, 0.01)
    expected = math.sqrt(2 * 3.65 * G / (1.225 * M100.drag.parasite_vertical_m2))
    assert body.down_mps == pytest.approx(expected, rel=1e-4)


def test_thrust_follows_its_command_as_a_first_order_lag() -> None:
    """63.2 % after one time constant; the discretisation at 10 ms is good to 5 %."""
    body = Airframe(M100)
    lag_s = M100.rotors.motor_lag_s
    for _ in range(round(lag_s / 0.001)):
        body.integrate_motion(40.0, 3.65, STILL, 1.225, 0.0, 0.001)
    assert body.thrust_n == pytest.approx(40.0 * (1 - math.exp(-1)), rel=0.02)


def test_tilt_and_rates_stay_within_their_limits() -> None:
    body = Airframe(M100)
    worst_rate = 0.0
    for _ in range(300):
        body.advance_attitude_towards_setpoint(1.5, -1.5, 3.0, 0.01)
        worst_rate = max(worst_rate, abs(body.rollspeed_rps), abs(body.pitchspeed_rps))
    tilt = math.hypot(body.roll_rad, body.pitch_rad)
    assert tilt == pytest.approx(math.radians(M100.attitude.max_tilt_deg), rel=0.01)
    assert worst_rate <= math.radians(M100.attitude.max_rate_degps) + 1e-9
    assert body.yaw_rad == pytest.approx(3.0, abs=0.02)


@pytest.mark.parametrize("name", ["m100", "octo8"])
@pytest.mark.parametrize(
    ("airspeed", "climb", "payload_share"),
    [(0, 0, 0), (5, 0, 1), (14, 0, 0), (19, 0, 1), (8, 3, 1), (6, -2, 0), (0, -1.5, 0)],
)
def test_the_dynamic_model_rests_where_the_steady_solver_says(
    name: str, airspeed: float, climb: float, payload_share: float
) -> None:
    """Put into the solver's state, the body does not accelerate, and power is the same."""
    params = load_airframe(FOLDER / f"{name}.toml")
    payload_kg = payload_share * params.max_payload_kg
    state = SteadyFlight(params).steady_state(airspeed, climb_mps=climb, payload_kg=payload_kg)
    body = Airframe(params)
    body.north_mps, body.down_mps = airspeed, -climb
    body.pitch_rad, body.thrust_n = -state.tilt_rad, state.thrust_n
    parcel_m2 = params.drag.parcel_area_m2 if payload_kg else 0.0
    mass_kg = params.empty_mass_kg + payload_kg
    body.integrate_motion(state.thrust_n, mass_kg, STILL, 1.225, parcel_m2, 0.01)
    assert (body.north_mps - airspeed) / 0.01 == pytest.approx(0.0, abs=1e-6)
    assert (body.down_mps + climb) / 0.01 == pytest.approx(0.0, abs=1e-6)
    power_w = RotorSet(params.rotors, 1.225).electrical_power_w(
        body.thrust_n, body.airspeed_mps, body.propulsive_w
    )
    assert power_w == pytest.approx(state.power_w, rel=1e-9)


def test_only_relative_wind_matters() -> None:
    """Galileo: hovering in 10 m/s of wind and flying at 10 m/s in still air need the same."""
    hovering, flying = Airframe(M100), Airframe(M100)
    flying.north_mps = 10.0
    for body in (hovering, flying):
        body.pitch_rad, body.thrust_n = -0.2, 36.0
    hovering.integrate_motion(36.0, 3.65, (-10.0, 0.0, 0.0), 1.225, 0.0, 0.01)
    flying.integrate_motion(36.0, 3.65, STILL, 1.225, 0.0, 0.01)
    assert hovering.propulsive_w == pytest.approx(flying.propulsive_w)
    assert hovering.north_mps + 10.0 == pytest.approx(flying.north_mps)


def test_strong_headwind_saturates_tilt() -> None:
    """The M100 reaches 18 to 22 m/s at its 35 deg (DJI data sheet: 22 m/s without load)."""
    flight = SteadyFlight(M100)
    assert 18.0 < flight.level_airspeed_at_tilt_mps(math.radians(35.0)) < 22.0


def test_air_is_the_standard_atmospheres() -> None:
    """ISO 2533: 1.225 kg/m3 at sea level and 15 deg C; 1.0066 at 2000 m and 2 deg C."""
    assert air_density_kgpm3(0.0, 15.0) == pytest.approx(1.225, rel=1e-4)
    assert air_density_kgpm3(2000.0, 2.0) == pytest.approx(1.00655, rel=1e-3)


def test_rotor_drag_goes_with_the_root_of_density_and_that_of_the_body_with_density():
    """Closed form: level, at one speed and thrust, only drag along body x slows it."""

    def lost_mps(density, drag):
        body = Airframe(msgspec.structs.replace(M100, drag=drag))
        body.thrust_n, body.north_mps = 3.65 * G, 10.0
        body.integrate_motion(3.65 * G, 3.65, STILL, density, 0.0, 0.001)
        return 10.0 - body.north_mps

    none = dict.fromkeys(("parasite_forward_m2", "parasite_vertical_m2"), 0.0)
    rotors = msgspec.structs.replace(M100.drag, **none)
    bare = msgspec.structs.replace(M100.drag, rotor_forward_nspm=0.0)
    assert lost_mps(0.784, rotors) / lost_mps(1.225, rotors) == pytest.approx(0.8)
    assert lost_mps(0.784, bare) / lost_mps(1.225, bare) == pytest.approx(0.64)
