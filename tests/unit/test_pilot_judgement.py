"""What reaches the estimators: nothing unknown, nothing stale, and no first look at nothing."""

from pathlib import Path

import pytest

from companion.adapters.files import read_airframe, read_flight
from companion.core import events as ev
from companion.core.judgement import Judgement
from companion.core.release import ReleaseWatch
from companion.core.route_energy import RouteEnergy
from companion.core.situation import Situation

FLIGHT = read_flight(Path(__file__).parents[2] / "params" / "flights" / "default.toml")
AIRFRAME = read_airframe("m100")


def judgement() -> Judgement:
    return Judgement(FLIGHT, AIRFRAME, RouteEnergy(AIRFRAME))


def standing(t_s: float, *events: ev.Event, now: Situation | None = None) -> Situation:
    now = now or Situation()
    now.hear(ev.VehicleState(t_s, ev.Mode.HOLD, "HOLD", armed=False))
    for event in events:
        now.hear(event)
    now.hear(ev.Tick(t_s))
    return now


def test_the_ledgers_first_look_is_at_a_battery_because_it_only_falls():
    judge = judgement()
    now = standing(1.0)
    judge.observe(now, ev.Flavour.PX4)
    assert judge.energy is None, "nothing was heard of the battery yet"
    standing(2.0, ev.Battery(2.0, voltage_v=25.6, current_a=0.5), now=now)
    judge.observe(now, ev.Flavour.PX4)
    assert judge.energy is not None
    assert judge.energy.source.startswith("resting voltage")
    # 25.6 V on six cells: 4.267 V a cell, above 90 % by the airframe's own curve.
    assert judge.energy.mean_wh > 0.9 * judge.energy.usable_full_wh


def test_the_mass_that_the_wind_estimate_needs_follows_the_parcel():
    judge = judgement()
    assert judge.payload_kg == FLIGHT.vehicle.payload_kg
    kept = judge.snapshot()
    assert kept["payload_kg"] == FLIGHT.vehicle.payload_kg


def test_two_battery_messages_make_one_picture_and_old_fields_fade():
    now = Situation()
    now.hear(ev.Battery(1.0, voltage_v=22.0, current_a=20.0, remaining_frac=0.6))
    now.hear(ev.Battery(1.5, consumed_ah=1.2, temperature_c=21.0))
    assert now.battery is not None
    assert (now.battery.voltage_v, now.battery.consumed_ah) == (22.0, 1.2)
    now.hear(ev.Battery(9.0, consumed_ah=1.4))
    assert now.battery.voltage_v is None, "eight seconds old"


@pytest.mark.parametrize("kind", ["position", "attitude"])
def test_late_samples_never_replace_newer_ones(kind):
    now = Situation()
    make = {
        "position": lambda t: ev.Position(t, 55.0, 8.0, t, t, 0.0, 0.0, 0.0),
        "attitude": lambda t: ev.Attitude(t, t, 0.0, 0.0),
    }[kind]
    now.hear(make(5.0))
    now.hear(make(4.0))
    assert getattr(now, kind).t_s == 5.0


def test_troubles_name_what_is_missing():
    now = Situation()
    now.hear(ev.Tick(10.0))
    assert set(now.troubles()) == {
        "no fresh position",
        "nothing heard of the satellite receiver",
        "no fresh attitude",
        "no fresh heartbeat",
        "no fresh mission progress",
        "no fresh battery reading",
    }


def hover(
    watch: ReleaseWatch, start_s: float, end_s: float, power_w: float, noise_w: float
) -> None:
    steps = round((end_s - start_s) * 4)
    for k in range(steps):
        sign = 1.0 if k % 2 else -1.0
        watch.observe(start_s + 0.25 * k, power_w + sign * noise_w, None)


@pytest.mark.parametrize(
    ("after_w", "delivered"), [(340.0, True), (370.0, True), (450.0, False), (470.0, False)]
)
def test_safety_rule_5_two_thirds_of_the_expected_fall_tells_a_release(after_w, delivered):
    # 470 W loaded and 340 W empty are 28 % apart: 65 % of that is 385 W.
    watch = ReleaseWatch(power_frac=1.0 - 340.0 / 470.0, thrust_frac=0.2)
    hover(watch, 0.0, 10.0, 470.0, 20.0)
    watch.begin(10.0)
    hover(watch, 10.0, 14.0, after_w, 20.0)
    assert (watch.evidence(14.0) is not None) == delivered


def test_safety_rule_5_without_a_current_sensor_the_thrust_command_tells():
    watch = ReleaseWatch(power_frac=0.28, thrust_frac=0.2)
    for k in range(140):
        watch.observe(0.1 * k, None, 0.52 if k < 100 else 0.44)
        if k == 100:
            watch.begin(10.0)
    evidence = watch.evidence(13.9)
    assert evidence is not None
    assert "hover thrust fell by 15 %" in evidence


@pytest.mark.parametrize(("after", "delivered"), [(0.49, False), (0.48, True)])
def test_safety_rule_5_one_step_of_the_throttles_whole_per_cents_is_no_proof(after, delivered):
    # A parcel of 2 to 4 % of the mass: 0.50 to 0.49 is 2 %, and every hover does that by itself.
    watch = ReleaseWatch(power_frac=0.03, thrust_frac=0.02 if after == 0.49 else 0.04)
    for k in range(140):
        watch.observe(0.1 * k, None, 0.50 if k < 100 else after)
        if k == 100:
            watch.begin(10.0)
    assert (watch.evidence(13.9) is not None) == delivered


def test_safety_rule_5_a_fall_within_the_gusts_is_no_proof():
    watch = ReleaseWatch(power_frac=0.05, thrust_frac=0.0)
    hover(watch, 0.0, 10.0, 470.0, 60.0)
    watch.begin(10.0)
    hover(watch, 10.0, 14.0, 445.0, 60.0)  # 5 % less, in power that swings by 13 %
    assert watch.evidence(14.0) is None


def test_safety_rule_5_without_any_measurement_nothing_is_confirmed_but_by_the_gripper():
    watch = ReleaseWatch(power_frac=0.28, thrust_frac=0.2)
    watch.begin(10.0)
    assert watch.evidence(20.0) is None
    watch.feedback = True
    assert watch.evidence(20.0) == "the gripper says so"
