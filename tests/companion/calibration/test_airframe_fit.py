"""Airframe calibration on flights simulated in this file: recovered values and refusals."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.adapters.files.airframe_toml import write_airframe
from companion.adapters.files.params import params_dir, read_airframe
from companion.analysis.calibration.airframe_fit import (
    fit_airframe_to_flights,
    predict_flight_energy,
)
from companion.analysis.calibration.battery import fit_battery
from companion.analysis.calibration.drag import (
    DRAG_KEYS,
    DragPriors,
    EstimatedWind,
    drag_parameter_vector,
    fit_drag,
)
from companion.analysis.calibration.flight import (
    CHANGE_SPEED,
    WAYPOINT,
    PlanOptions,
    calibration_mission_items,
)
from companion.analysis.calibration.power import fit_power
from companion.analysis.calibration.quantities import (
    avionics_power_std_w,
    level_power_and_derivatives_w,
)
from companion.analysis.calibration.records import (
    BLOCK_S,
    Blocks,
    FlightRecord,
    convert_record_to_blocks,
)
from companion.core.base.errors import LeewayError
from companion.core.vehicle.power import multirotor_power_w
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.steady_flight import SteadyFlight

G = 9.80665
DT_S = 0.2
SPEEDS = np.arange(0.0, 25.0, 0.5)


class World:
    """A vehicle as in params/truth, at sea level density: N per m/s, N per (m/s)^2, W."""

    def __init__(self, name, loads_kg):
        self.truth = load_airframe(params_dir() / "truth" / f"{name}.toml")
        drag = self.truth.drag
        self.mass_kg = self.truth.empty_mass_kg
        self.linear = (drag.rotor_forward_nspm, drag.rotor_sideways_nspm)
        self.quadratic = (0.6125 * drag.parasite_forward_m2, 0.6125 * drag.parasite_sideways_m2)
        self.parcel = 0.6125 * drag.parcel_area_m2
        self.vertical = 0.6125 * drag.parasite_vertical_m2
        steady = SteadyFlight(self.truth)
        self.power_w = {
            kg: np.array([steady.level_flight_power_w(v, kg) for v in SPEEDS]) for kg in loads_kg
        }


M100, OCTO8 = World("m100", (0.0, 0.4, 0.8)), World("octo8", (0.0, 8.0))
TRUTH, LINEAR, QUADRATIC, POWER = M100.truth, M100.linear, M100.quadratic, M100.power_w
MEASURED = Path(__file__).resolve().parents[4] / "shared" / "data" / "energy" / "measured_power.csv"


def wrong_start():
    """Return an initial airframe whose fitted parameters are all off by at least a quarter."""
    m100 = read_airframe("m100")
    drag = msgspec.structs.replace(
        m100.drag,
        linear_forward_n_per_mps=0.45,
        linear_right_n_per_mps=0.45,
        quadratic_forward_n_per_mps2=0.03,
        quadratic_right_n_per_mps2=0.03,
        parcel_quadratic_n_per_mps2=0.004,
    )
    rotor = msgspec.structs.replace(
        m100.power_rotor,
        induced_factor=1.2,
        drive_efficiency=0.75,
        blade_drag_coefficient=0.02,
        avionics_w=10.0,
    )
    return msgspec.structs.replace(m100, drag=drag, power_rotor=rotor)


def square(speeds, legs=12, side_m=150.0, heading=None):
    """Return (seconds, north m/s, east m/s, heading or None for the course) for each leg."""
    for leg in range(legs):
        speed = speeds[leg % len(speeds)]
        course = math.radians(90.0 * leg)
        yield side_m / speed, speed * math.cos(course), speed * math.sin(course), heading


def fly(
    segments, *, seed=1, payload_kg=0.0, wind_ne=(2.0, -1.5), name="log", stand_s=20.0, world=M100
):
    """Return a record: velocity ramps at 2.5 m/s^2, tilt balances drag and acceleration."""
    rng = np.random.default_rng(seed)
    mass = world.mass_kg + payload_kg
    vel, yaws, aloft = [[0.0, 0.0]] * round(stand_s / DT_S), [0.0] * round(stand_s / DT_S), []
    aloft = [False] * len(vel)
    now, yaw = np.zeros(2), 0.0
    for seconds, north, east, heading in [(5.0, 0.5, 0.0, None), *segments]:
        target = np.array([north, east])
        yaw = math.atan2(east, north) if heading is None else heading
        for _ in range(round(seconds / DT_S)):
            step = target - now
            size = float(np.hypot(*step))
            now = target if size < 2.5 * DT_S else now + step * (2.5 * DT_S / size)
            vel.append(now.tolist())
            yaws.append(yaw)
            aloft.append(True)
    v, yaw_rad, up = np.array(vel), np.array(yaws), np.array(aloft)
    n = len(v)
    gusts = np.zeros((n, 2))
    for i in range(1, n):  # Ornstein-Uhlenbeck, 0.5 m/s over 15 s
        gusts[i] = gusts[i - 1] * (1 - DT_S / 15.0) + rng.normal(
            0, 0.5 * math.sqrt(2 * DT_S / 15.0), 2
        )
    air = v - np.array(wind_ne) - gusts
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    forward, right = cos * air[:, 0] + sin * air[:, 1], cos * air[:, 1] - sin * air[:, 0]
    speed = np.hypot(forward, right)
    parcel = world.parcel if payload_kg else 0.0
    root = math.sqrt(mass / world.mass_kg)
    accel = np.gradient(v, DT_S, axis=0)
    thrust_f = cos * accel[:, 0] + sin * accel[:, 1]
    thrust_f += (world.linear[0] * root + (world.quadratic[0] + parcel) * speed) * forward / mass
    thrust_r = cos * accel[:, 1] - sin * accel[:, 0]
    thrust_r += (world.linear[1] * root + (world.quadratic[1] + parcel) * speed) * right / mass
    pitch = np.where(up, -np.arctan(thrust_f / G), 0.0)
    roll = np.where(up, np.arctan(thrust_r * np.cos(pitch) / G), 0.0)
    power = np.where(up, np.interp(speed, SPEEDS, world.power_w[payload_kg]), 15.0)
    volts = 24.0 - np.cumsum(power) * DT_S / 3600.0 / 60.0 - 0.032 * power / 24.0
    return FlightRecord(
        name=name,
        t_s=np.arange(n) * DT_S,
        vel_ned_mps=np.c_[v + rng.normal(0, 0.03, v.shape), np.zeros(n)],
        roll_rad=roll + rng.normal(0, 0.002, n) + 0.005,
        pitch_rad=pitch + rng.normal(0, 0.002, n) - 0.004,
        yaw_rad=yaw_rad,
        voltage_v=volts,
        current_a=power / volts + rng.normal(0, 0.2, n),
        payload_kg=np.full(n, payload_kg),
        density_kgpm3=1.225,
    )


def blocks(record):
    return convert_record_to_blocks(record, 480.0, 6).blocks


HOVER = [(80.0, 0.0, 0.0, 0.0)]


@pytest.fixture(scope="module")
def squares():
    return [
        blocks(fly([*HOVER, *square((12.6, 4.9, 8.4))], seed=1, name="empty")),
        blocks(fly([*HOVER, *square((12.6, 4.9, 8.4))], seed=2, payload_kg=0.8, name="heavy")),
        blocks(fly([*HOVER, *square((12.6, 4.9, 8.4), heading=0.3)], seed=3, name="held")),
    ]


@pytest.fixture(scope="module")
def done(squares):
    return fit_airframe_to_flights(squares, wrong_start())


@pytest.mark.sample
def test_squares_identify_all_that_is_needed(done):
    assert not done.unidentified_required_quantities


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("speed", [5.0, 10.0, 14.0])
def test_drag_comes_back_within_three_of_its_own_standard_deviations(done, axis, speed):
    row = np.zeros(5)
    row[axis], row[axis + 2] = speed, speed**2
    true_n = LINEAR[axis] * speed + QUADRATIC[axis] * speed**2
    std_n = math.sqrt(row @ done.drag.cov @ row)
    assert abs(row @ done.drag.values - true_n) < 3.0 * std_n
    assert std_n < 0.1 * true_n


@pytest.mark.parametrize("payload_kg", [0.0, 0.4, 0.8])
def test_the_truths_power_curve_is_within_the_stated_intervals(done, payload_kg):
    """0 to 16 m/s: three standard deviations of the fit combined with the model's own error."""
    for speed, true_w in zip(SPEEDS, POWER[payload_kg], strict=True):
        if speed > 16.0:
            continue
        value_w, slope = level_power_and_derivatives_w(
            done.airframe, done.power.values, done.drag.values, payload_kg, speed
        )
        model_w = done.airframe.power_rotor.model_std_frac * value_w
        std_w = math.hypot(math.sqrt(slope @ done.power.cov @ slope), model_w)
        assert abs(value_w - true_w) < 3.0 * std_w
        assert abs(value_w / true_w - 1.0) < 0.05


def octo_guess(vertical):
    """Return an airframe by data sheet: drag a third too low, blade drag of small rotors."""
    octo = read_airframe("octo8")
    drag = msgspec.structs.replace(
        octo.drag,
        linear_forward_n_per_mps=0.8,
        linear_right_n_per_mps=0.8,
        quadratic_forward_n_per_mps2=0.0735,
        quadratic_right_n_per_mps2=0.0735,
        parcel_quadratic_n_per_mps2=0.05,
        vertical_quadratic_n_per_mps2=vertical,
    )
    rotor = msgspec.structs.replace(
        octo.power_rotor,
        induced_factor=1.25,
        drive_efficiency=0.8,
        blade_drag_coefficient=0.03,
        avionics_w=30.0,
    )
    return msgspec.structs.replace(octo, drag=drag, power_rotor=rotor)


@pytest.fixture(scope="module")
def octo_squares():
    flown = []
    for seed, payload_kg, speeds in ((1, 0.0, (18.0, 9.0, 18.0)), (2, 8.0, (13.5, 5.2, 9.0))):
        legs = [*HOVER, *square(speeds, legs=8, side_m=250.0)]
        record = fly(legs, seed=seed, payload_kg=payload_kg, name=f"{payload_kg}", world=OCTO8)
        flown.append(convert_record_to_blocks(record, 1080.0, 6).blocks)
    return flown


def power_errors(airframe, speeds_mps):
    """Return predicted over true power minus 1, empty and with 8 kg."""
    return np.array(
        [
            float(multirotor_power_w(airframe, airframe.flying_mass_kg(kg), v))
            / float(np.interp(v, SPEEDS, OCTO8.power_w[kg]))
            - 1.0
            for kg in OCTO8.power_w
            for v in speeds_mps
        ]
    )


@pytest.mark.sample
def test_drag_from_above_is_told_by_fast_flight_and_power_at_the_tilt_limit_with_it(octo_squares):
    """params/truth/octo8.toml: vertical drag area 0.40 m^2; the initial value is 0.16."""
    found = fit_airframe_to_flights(octo_squares, octo_guess(0.1))
    above = next(q for q in found.quantities if q.name == "drag from above")
    assert above.is_identifiable
    assert abs(above.value - OCTO8.vertical) < 3.0 * above.std
    assert above.value == found.airframe.drag.vertical_quadratic_n_per_mps2
    assert np.abs(power_errors(found.airframe, (0.0, 5.0, 10.0, 15.0, 17.0, 19.0))).max() < 0.05
    assert found.airframe.power_rotor.blade_drag_coefficient > 0.01


@pytest.mark.sample
def test_without_drag_from_above_blades_without_drag_are_said_and_the_number_to_state(octo_squares):
    """The canary of the test above: the same flights; power at 19 m/s, empty, is over 5 % low."""
    found = fit_airframe_to_flights(octo_squares, octo_guess(None))
    assert power_errors(found.airframe, (19.0,)).min() < -0.05
    said = next(note for note in found.notes if note.startswith("blade drag is 0.00"))
    assert "drag.vertical_quadratic_n_per_mps2 in octo8" in said


def test_fast_sides_hold_the_fastest_speed_for_8_seconds_after_gaining_and_before_losing_it():
    octo = read_airframe("octo8")
    items = calibration_mission_items(octo, PlanOptions(fast=True))
    told = [item.params[1] for item in items if item.command == CHANGE_SPEED]
    assert told.count(18.0) >= 2 * (told.count(9.0) - 1) - 1  # the return leg is at 9 m/s as well
    corners = [item.position_neu_m for item in items if item.command == WAYPOINT]
    sides = [math.dist(a, b) for a, b in pairwise(corners) if a[2] == b[2] and a != b]
    gained_m = 18.0**2 / (2.0 * octo.speeds.accel_mps2)
    assert min(sides) >= 8.0 * 18.0 + 2.0 * gained_m
    slow = calibration_mission_items(octo, PlanOptions())
    assert all(item.params[1] < 14.0 for item in slow if item.command == CHANGE_SPEED)


def test_slow_flight_alone_leaves_drag_from_above_as_believed_and_the_fast_plan_is_named():
    slow = fly([*HOVER, *square((7.0, 4.0), legs=8, side_m=100.0)], world=OCTO8)
    found = fit_airframe_to_flights(
        [convert_record_to_blocks(slow, 1080.0, 6).blocks], octo_guess(0.2)
    )
    above = next(q for q in found.quantities if q.name == "drag from above")
    assert not above.is_identifiable
    assert any("calibrate-plan --fast" in n for n in found.notes if n.startswith("drag from above"))


def test_a_load_and_a_wind_that_were_not_seen_are_predicted(done):
    unseen = blocks(
        fly([*HOVER, *square((9.0, 6.0), legs=8)], seed=9, payload_kg=0.4, wind_ne=(-5.0, 3.0))
    )
    assert abs(predict_flight_energy(unseen, done.airframe).relative_energy_error) < 0.05


def test_the_packs_resistance_is_ohms_law(done):
    assert done.battery.resistance_ohm == pytest.approx(0.032, abs=0.004)


def said_missing(*flights):
    found = fit_airframe_to_flights([blocks(f) for f in flights], wrong_start())
    return {q.name: q.flight for q in found.unidentified_required_quantities}


def test_hover_alone_cannot_tell_drag_and_the_square_is_named():
    missing = said_missing(fly([(300.0, 0.0, 0.0, 0.0)], wind_ne=(0.5, 0.0)))
    assert "square at two speeds" in missing["drag forward at 14 m/s"]
    assert "power in hover, empty" not in missing


@pytest.mark.sample
def test_one_speed_alone_cannot_tell_linear_from_quadratic():
    """Circles of one minute at 12 m/s in nearly still air, after a ramp of two seconds."""
    courses = np.radians(np.arange(0.0, 1800.0, 6.0))
    circle = [(1.0, 12.0 * math.cos(c), 12.0 * math.sin(c), None) for c in courses]
    flown = blocks(fly(circle, wind_ne=(0.3, 0.0)))
    found = fit_airframe_to_flights([flown.select(flown.t_s > 40.0)], wrong_start())
    flights = {q.name: q.flight for q in found.unidentified_required_quantities}
    assert "two speeds" in flights["drag forward at 4.9 m/s"]


@pytest.mark.sample
def test_one_course_alone_cannot_tell_drag_from_wind():
    missing = said_missing(fly([(300.0, 10.0, 0.0, None)]))
    assert any(name.startswith("drag forward") for name in missing)


@pytest.mark.sample
def test_what_never_flew_sideways_keeps_the_right_axis_uncertain(squares):
    calm = fly([*HOVER, *square((12.6, 4.9, 8.4))], wind_ne=(0.0, 0.0), seed=4)
    found = fit_airframe_to_flights([blocks(calm)], wrong_start())
    right = next(q for q in found.quantities if q.name == "drag right at 14 m/s")
    held = fit_airframe_to_flights(squares[2:], wrong_start())
    better = next(q for q in held.quantities if q.name == "drag right at 14 m/s")
    assert right.std > 1.3 * better.std
    assert "MPC_YAW_MODE" in right.flight


def test_an_airframe_told_to_be_symmetric_has_to_the_right_the_drag_that_its_front_shows(squares):
    calm = [blocks(fly([*HOVER, *square((12.6, 4.9, 8.4))], wind_ne=(0.0, 0.0), seed=4))]
    start = wrong_start()
    free = fit_airframe_to_flights(calm, start, measure_holdout_error=False)
    held = fit_airframe_to_flights(
        calm, start, measure_holdout_error=False, priors=DragPriors.for_symmetric_airframe()
    )
    name = "drag right at 14 m/s"
    stds = [next(q.std for q in one.quantities if q.name == name) for one in (free, held)]
    assert stds[1] < 0.8 * stds[0]
    # Drag of both axes at 14 m/s, in the initial ratio within the stated 5 %.
    of_start, found = (
        np.dot((14.0, 14.0**2), one[1:4:2]) / np.dot((14.0, 14.0**2), one[0:4:2])
        for one in (drag_parameter_vector(start), held.drag.values)
    )
    assert found == pytest.approx(of_start, rel=0.1)


ORDINARY = fly([*HOVER, *square((12.0, 5.0), legs=6)])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"current_a": np.full_like(ORDINARY.current_a, np.nan)}, "current_a: no value"),
        ({"voltage_v": ORDINARY.voltage_v * 1000.0}, "row 0: voltage_v"),
        ({"current_a": ORDINARY.current_a * 100.0}, "current_a: voltage times current"),
        ({"yaw_rad": np.degrees(ORDINARY.yaw_rad)}, "yaw_rad"),
        ({"vel_ned_mps": ORDINARY.vel_ned_mps * 100.0}, "vel_ned_mps"),
        ({"voltage_v": ORDINARY.voltage_v / 6.0}, "6 cells"),
        ({"roll_rad": np.full_like(ORDINARY.roll_rad, np.nan)}, "roll_rad: no value"),
    ],
)
def test_what_cannot_be_used_is_named(change, words):
    with pytest.raises(LeewayError, match=r"log: .*") as error:
        convert_record_to_blocks(replace(ORDINARY, **change), 480.0, 6)
    assert words in str(error.value)


def test_a_cut_log_is_used_up_to_there_and_said():
    cut = {
        n: getattr(ORDINARY, n)[:900]
        for n in FlightRecord.__slots__
        if isinstance(getattr(ORDINARY, n), np.ndarray)
    }
    prepared = convert_record_to_blocks(replace(ORDINARY, **cut), 480.0, 6)
    assert any("cut off in flight" in note for note in prepared.notes)
    assert prepared.blocks.airborne.sum() > 30


def test_rows_of_nan_and_a_clock_that_jumps_back_are_left_out_and_said():
    pitch, t_s = ORDINARY.pitch_rad.copy(), ORDINARY.t_s.copy()
    pitch[600:650] = np.nan
    t_s[1000:] -= 3.0
    prepared = convert_record_to_blocks(replace(ORDINARY, pitch_rad=pitch, t_s=t_s), 480.0, 6)
    assert any("row 1000: time does not rise" in note for note in prepared.notes)
    assert any("excluded" in note and "attitude" in note for note in prepared.notes)
    assert np.isfinite(prepared.blocks.thrust_forward_mps2).all()


def discharge(draw_w, charge_frac=1.0, down_to=0.0, sensor=1.0):
    """Return a hover at a constant draw on the simulator's pack, landed at a given charge; `sensor`
    is a factor on the current.
    """
    pack = Battery(TRUTH.battery, charge_frac=charge_frac)
    rows = []
    for second in range(3000):
        pack.discharge_at_power(15.0 if second < 30 else draw_w, 1.0)
        if pack.cut_off or pack.charge_frac < down_to:
            break
        rows.append((pack.voltage_v, sensor * pack.current_a, second >= 30))
    volts, amps, aloft = map(np.array, zip(*rows[: len(rows) // 2 * 2], strict=True))
    volts, amps = volts.reshape(-1, 2).mean(1), amps.reshape(-1, 2).mean(1)
    zero = np.zeros(len(volts))
    arrays = {n: zero for n in Blocks.__slots__ if n not in ("name", "density_kgpm3")}
    arrays |= {
        "t_s": np.arange(len(volts)) * BLOCK_S,
        "voltage_v": volts,
        "current_a": amps,
        "power_w": volts * amps,
        "airborne": aloft[::2],
    }
    return Blocks(name=f"{draw_w:.0f} W", density_kgpm3=1.225, **arrays), pack.delivered_j / 3600.0


# The planner's pack with the simulator's cut-off: "usable" must mean the same in both.
PACK = msgspec.structs.replace(read_airframe("m100").battery, cutoff_cell_v=3.2)


def true_usable_wh(draw_w):
    """Return the energy that the simulator's pack delivers from full to cut-off."""
    return discharge(draw_w)[1]


def test_a_discharge_to_cut_off_gives_the_usable_energy():
    flown, delivered_wh = discharge(478.0)
    fit = fit_battery([flown], PACK).usable
    assert fit is not None
    assert fit.frac * PACK.nominal_wh == pytest.approx(delivered_wh, rel=0.02)
    assert fit.at_w == pytest.approx(478.0, rel=0.01)
    assert fit.loss_per_w == pytest.approx(PACK.usable_loss_per_w)  # a single draw gives no slope


@pytest.mark.parametrize("sensor", [0.98, 1.0, 1.02])
def test_two_discharges_landed_at_a_tenth_recover_the_truths_usable_energy(sensor):
    """Within the stated intervals: the sensor is off by one sigma, the initial value by 10 %."""
    guess = msgspec.structs.replace(PACK, usable_frac=0.87, usable_loss_per_w=2.4e-4)
    flown = [discharge(draw, down_to=0.09, sensor=sensor)[0] for draw in (478.0, 700.0)]
    fit = fit_battery(flown, guess).usable
    assert fit is not None
    assert 0.02 < fit.extrapolated_frac < 0.12
    label = guess.nominal_wh
    light, heavy = true_usable_wh(478.0) / label, true_usable_wh(700.0) / label
    assert abs(fit.frac - light) < 2.0 * fit.std_frac
    assert fit.std_frac < 0.04
    slope = (light - heavy) / (700.0 - 478.0)
    assert abs(fit.loss_per_w - slope) < 2.0 * fit.loss_std_per_w
    assert fit.loss_std_per_w < 0.6 * guess.usable_loss_per_w  # identified by logs, not the guess


@pytest.mark.parametrize("how", [{"charge_frac": 0.7}, {"down_to": 0.4}])
def test_half_a_discharge_leaves_usable_energy_as_believed(how):
    flown, _ = discharge(478.0, **how)
    assert fit_battery([flown], read_airframe("m100").battery).usable is None


@pytest.mark.parametrize("vertical", [None, 0.2])
def test_an_airframe_file_reads_back_as_it_was_written(tmp_path, done, vertical):
    path = tmp_path / "mine.toml"
    drag = msgspec.structs.replace(done.airframe.drag, vertical_quadratic_n_per_mps2=vertical)
    written = msgspec.structs.replace(done.airframe, drag=drag)
    write_airframe(path, written, ["a header"], {("drag", "gain_std_frac"): "of the fit"})
    back = read_airframe(str(path))
    assert back.drag.vertical_quadratic_n_per_mps2 == vertical
    for table in ("mass", "speeds", "drag", "power_paper", "power_rotor"):
        for key, value in msgspec.to_builtins(getattr(written, table)).items():
            assert getattr(getattr(back, table), key) == pytest.approx(value, rel=1e-5)
    assert back.battery.ocv_cell_v == written.battery.ocv_cell_v


def level_blocks(name, speeds, watts, ground_w=()):
    """Return blocks of level flight, nose forward, in still air, after some at rest."""
    down = len(ground_w)
    zero = np.zeros(down + len(speeds))
    arrays = {n: zero for n in Blocks.__slots__ if n not in ("name", "density_kgpm3")}
    arrays |= {
        "t_s": np.arange(len(zero)) * BLOCK_S,
        "north_mps": np.r_[np.zeros(down), speeds],
        "forward_mps": np.r_[np.zeros(down), speeds],
        "cos_yaw": np.ones(len(zero)),
        "voltage_v": zero + 24.0,
        "power_w": np.r_[ground_w, watts],
        "airborne": np.arange(len(zero)) >= down,
    }
    return Blocks(name=name, density_kgpm3=1.225, **arrays)


def test_motors_that_spin_up_on_the_ground_are_not_taken_for_avionics():
    """15 W by params/truth/m100.toml; in two of ten blocks at rest the motors turn."""
    ground = np.array([15.5, 14.5, 16.0, 14.0, 15.0, 15.5, 14.0, 15.5, 65.0, 60.0])
    speeds = np.repeat(np.arange(0.0, 15.0, 3.0), 15)
    flown = level_blocks("m", speeds, np.interp(speeds, SPEEDS, POWER[0.0]), ground)
    still = np.zeros(len(speeds))
    fit = fit_power([flown], [EstimatedWind(still, still, still + 0.1, 0.0)], read_airframe("m100"))
    assert fit.values[3] == pytest.approx(15.0, abs=2.0)


def rests(watts, logs=1):
    """Return the fit to logs with these readings at rest, at 24 V."""
    speeds = np.repeat(np.arange(0.0, 15.0, 3.0), 15)
    still = np.zeros(len(speeds))
    power = np.interp(speeds, SPEEDS, POWER[0.0])
    flown = [level_blocks(f"m{i}", speeds, power, np.full(10, watts)) for i in range(logs)]
    return fit_power(
        flown, [EstimatedWind(still, still, still + 0.1, 0.0)] * logs, read_airframe("m100")
    )


def test_a_current_sensor_that_reads_less_than_nothing_at_rest_tells_no_avionics():
    """The M100's current sensor: -0.15 A with everything on and the motors off."""
    fit = rests(-4.0)
    assert fit.standing is not None
    assert fit.standing.least_a == pytest.approx(-4.0 / 24.0)
    assert avionics_power_std_w(fit) == pytest.approx(float(np.sqrt(fit.prior_cov[3, 3])))


def test_many_logs_tell_avionics_no_better_than_one_sensor_s_zero():
    fit = rests(15.0, logs=9)
    # 0.2 A at 24 V about the reading, and 9 W about the prior.
    zero, believed = 0.2 * 24.0, float(np.sqrt(fit.prior_cov[3, 3]))
    assert avionics_power_std_w(fit) >= (zero**-2 + believed**-2) ** -0.5 - 1e-9
    assert avionics_power_std_w(fit) < 0.6 * believed


PUBLISHED = {  # rms residual of the fit as a share of power; masses as in the publications
    "DJI Matrice 100": ("m100", 3.65, 0.04),
    "quadcopter 1.3 kg": ("px4_sih", 1.3, 0.04),
    "IRIS quadcopter": ("px4_sih", 1.3, 0.06),
}


@pytest.mark.skipif(not MEASURED.exists(), reason="../shared/data/energy is not there")
@pytest.mark.parametrize("vehicle", PUBLISHED)
def test_published_curves_are_met(vehicle):
    """shared/data/energy/measured_power.csv: airspeed and power of three multirotors."""
    name, mass_kg, limit = PUBLISHED[vehicle]
    rows = [line.split(",") for line in MEASURED.read_text().splitlines()[1:]]
    points = np.array([(float(r[3]), float(r[4])) for r in rows if r[1] == vehicle])
    start = read_airframe(name)
    start = msgspec.structs.replace(
        start, mass=msgspec.structs.replace(start.mass, empty_kg=mass_kg)
    )
    speeds, watts = np.repeat(points, 15, axis=0).T
    zero = np.zeros(len(speeds))
    fit = fit_power(
        [level_blocks(vehicle, speeds, watts)], [EstimatedWind(zero, zero, zero + 0.1, 0.0)], start
    )
    fitted = msgspec.structs.replace(
        start,
        power_rotor=msgspec.structs.replace(
            start.power_rotor,
            induced_factor=float(fit.values[0]),
            drive_efficiency=float(fit.values[1]),
            blade_drag_coefficient=float(fit.values[2]),
            avionics_w=float(fit.values[3]),
        ),
    )
    predicted = fit.sensor_scale[0] * multirotor_power_w(fitted, mass_kg, points[:, 0])
    errors = predicted / points[:, 1] - 1.0
    print(vehicle, np.round(100.0 * errors, 1).tolist(), "%")
    assert math.sqrt(np.mean(errors**2)) < limit


@pytest.mark.sample
def test_drag_that_was_flown_in_thin_air_is_fitted_at_the_files_density():
    """Reference density scaling: rotor drag with the root of density, body drag with density."""
    thin, density = World("m100", (0.0,)), 0.784
    thin.linear = tuple(0.8 * k for k in thin.linear)
    thin.quadratic = tuple(0.64 * q for q in thin.quadratic)
    record = fly([*HOVER, *square((12.6, 4.9, 8.4))], seed=1, world=thin)
    flown = replace(blocks(record), density_kgpm3=density)
    fit = fit_drag([flown], read_airframe("m100"))
    expected_n = LINEAR[0] * 14.0 + QUADRATIC[0] * 14.0**2
    fitted_n = fit.values[0] * 14.0 + fit.values[2] * 14.0**2
    assert fitted_n == pytest.approx(expected_n, rel=0.08)


def test_power_s_slope_is_known_where_an_ideal_rotor_is_the_limit():
    # The induced power of the ideal rotor is the lower bound of an airframe file.
    m100 = read_airframe("m100")
    values = np.array([1.0, 0.7, 0.02, 15.0])
    drag = np.array([getattr(m100.drag, key) for key in DRAG_KEYS])
    value, slopes = level_power_and_derivatives_w(m100, values, drag, 0.0, 0.0)
    assert value > 0.0
    assert slopes[0] > 0.0
    assert slopes[1] < 0.0
