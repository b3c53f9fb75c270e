"""Inputs of the estimators: no unknown values, no stale values, no update without data."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from companion.adapters.files.params import read_airframe, read_flight, read_wind_process
from companion.core.mission import events as ev
from companion.core.pilot.estimates import EstimatesSnapshot, FlightEstimates
from companion.core.pilot.estimators.release_watch import ReleaseMonitor
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.return_budget.budget import Assessment
from companion.core.return_budget.remaining_from_plan import remaining_outbound
from companion.core.return_budget.remaining_mission import RemainingMission, with_min_airspeed
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import Plan
from companion.core.vehicle.air import Air
from companion.core.vehicle.speed_to_fly import SpeedRule, fastest_planning_airspeed_mps
from companion.core.wind.estimator import WindBelief, WindEstimator

FLIGHT = read_flight(Path(__file__).parents[3] / "params" / "flights" / "default.toml")
AIRFRAME = read_airframe("m100")
WIND_PROCESS = read_wind_process("coast")


def judgement(speed_rule: SpeedRule = "least_energy") -> FlightEstimates:
    energy = RouteEnergy(AIRFRAME, speed_rule=speed_rule)
    return FlightEstimates(FLIGHT, AIRFRAME, energy, WIND_PROCESS)


def standing(t_s: float, *events: ev.Event, now: TelemetryState | None = None) -> TelemetryState:
    now = now or TelemetryState()
    now.store_event(ev.VehicleState(t_s, ev.Mode.HOLD, "HOLD", armed=False))
    for event in events:
        now.store_event(event)
    now.store_event(ev.Tick(t_s))
    return now


def test_the_ledgers_first_look_is_at_a_battery_because_it_only_falls():
    judge = judgement()
    now = standing(1.0)
    judge.update_from_telemetry(now, ev.AutopilotKind.PX4)
    assert judge.energy is None, "nothing was heard of the battery yet"
    standing(2.0, ev.Battery(2.0, voltage_v=25.6, current_a=0.5), now=now)
    judge.update_from_telemetry(now, ev.AutopilotKind.PX4)
    assert judge.energy is not None
    assert judge.energy.source.startswith("resting voltage")
    # 25.6 V on six cells: 4.267 V a cell, above 90 % by the airframe's own curve.
    assert judge.energy.mean_wh > 0.9 * judge.energy.usable_full_wh


def test_the_mass_that_the_wind_estimate_needs_follows_the_parcel():
    judge = judgement()
    assert judge.payload_kg == FLIGHT.vehicle.payload_kg
    kept = judge.snapshot()
    assert kept["payload_kg"] == FLIGHT.vehicle.payload_kg


def test_the_autopilots_wind_is_believed_as_far_as_it_says():
    vehicle = replace(FLIGHT.vehicle, autopilot_wind=True)
    flight = replace(FLIGHT, vehicle=vehicle)
    spread = []
    for std_mps in (0.5, 3.0):
        judge = FlightEstimates(flight, AIRFRAME, RouteEnergy(AIRFRAME), WIND_PROCESS)
        judge.update_from_telemetry(
            standing(1.0, ev.AutopilotWind(1.0, 5.0, 2.0, std_mps)), ev.AutopilotKind.PX4
        )
        assert judge.wind is not None
        spread.append(float(np.trace(judge.wind.cov_ne_m2ps2)))
    # Its reports repeat for 10 s at 1 Hz: ten times the variance, against a prior of 10 m/s.
    assert spread[0] < 2.0 * 10.0 * (0.5**2 + 0.3**2) < 2.0 * 10.0 * 1.5**2 < spread[1]


def test_two_battery_messages_make_one_picture_and_old_fields_fade():
    now = TelemetryState()
    now.store_event(ev.Battery(1.0, voltage_v=22.0, current_a=20.0, remaining_frac=0.6))
    now.store_event(ev.Battery(1.5, consumed_ah=1.2, temperature_c=21.0))
    assert now.battery is not None
    assert (now.battery.voltage_v, now.battery.consumed_ah) == (22.0, 1.2)
    now.store_event(ev.Battery(9.0, consumed_ah=1.4))
    assert now.battery.voltage_v is None, "eight seconds old"


@pytest.mark.parametrize("kind", ["position", "attitude"])
def test_late_samples_never_replace_newer_ones(kind):
    now = TelemetryState()
    make = {
        "position": lambda t: ev.Position(t, 55.0, 8.0, t, t, 0.0, 0.0, 0.0),
        "attitude": lambda t: ev.Attitude(t, t, 0.0, 0.0),
    }[kind]
    now.store_event(make(5.0))
    now.store_event(make(4.0))
    assert getattr(now, kind).t_s == 5.0


def test_troubles_name_what_is_missing():
    now = TelemetryState()
    now.store_event(ev.Tick(10.0))
    assert set(now.command_faults()) == {
        "no recent position",
        "no data from the GNSS receiver",
        "no recent attitude",
        "no recent heartbeat",
        "no recent mission progress",
        "no recent battery reading",
    }


def hover(
    watch: ReleaseMonitor, start_s: float, end_s: float, power_w: float, noise_w: float
) -> None:
    steps = round((end_s - start_s) * 4)
    for k in range(steps):
        sign = 1.0 if k % 2 else -1.0
        watch.add_hover_sample(start_s + 0.25 * k, power_w + sign * noise_w, None)


@pytest.mark.parametrize(
    ("after_w", "delivered"), [(340.0, True), (370.0, True), (450.0, False), (470.0, False)]
)
def test_safety_rule_5_two_thirds_of_the_expected_fall_tells_a_release(after_w, delivered):
    # 470 W loaded and 340 W empty are 28 % apart: 65 % of that is 385 W.
    watch = ReleaseMonitor(power_frac=1.0 - 340.0 / 470.0, thrust_frac=0.2)
    hover(watch, 0.0, 10.0, 470.0, 20.0)
    watch.record_release_order(10.0)
    hover(watch, 10.0, 14.0, after_w, 20.0)
    assert (watch.release_evidence_text(14.0) is not None) == delivered


@pytest.mark.parametrize(
    ("payload", "after_w", "reports", "delivered"),
    [
        (0.35, 376.0, 2, True),  # the drop that was measured on a real autopilot's simulator
        (0.35, 376.0, 0, True),
        (0.35, 465.0, 2, False),  # the gripper reports success, the parcel stays
        (0.35, 500.0, 2, False),
        (0.04, 462.0, 1, True),  # a light parcel: the drop does not contradict the gripper
        (0.04, 462.0, 0, False),
        (0.04, 520.0, 2, False),
    ],
)
def test_safety_rule_5_gripper_and_power_are_weighed_together(payload, after_w, reports, delivered):
    watch = ReleaseMonitor(power_frac=payload, thrust_frac=0.0)
    hover(watch, 0.0, 10.0, 470.0, 10.0)
    watch.record_release_order(10.0)
    watch.gripper_reports = reports
    hover(watch, 10.0, 14.0, after_w, 10.0)
    assert (watch.release_evidence_text(14.0) is not None) == delivered


def test_safety_rule_5_without_a_current_sensor_the_thrust_command_tells():
    watch = ReleaseMonitor(power_frac=0.28, thrust_frac=0.2)
    for k in range(140):
        watch.add_hover_sample(0.1 * k, None, 0.52 if k < 100 else 0.44)
        if k == 100:
            watch.record_release_order(10.0)
    evidence = watch.release_evidence_text(13.9)
    assert evidence is not None
    assert "hover thrust fell by 15 %" in evidence


@pytest.mark.parametrize(("after", "delivered"), [(0.49, False), (0.48, True)])
def test_safety_rule_5_one_step_of_the_throttles_whole_per_cents_is_no_proof(after, delivered):
    # A parcel of 2 to 4 % of the mass: 0.50 to 0.49 is 2 %, within the variation of any hover.
    watch = ReleaseMonitor(power_frac=0.03, thrust_frac=0.02 if after == 0.49 else 0.04)
    for k in range(140):
        watch.add_hover_sample(0.1 * k, None, 0.50 if k < 100 else after)
        if k == 100:
            watch.record_release_order(10.0)
    assert (watch.release_evidence_text(13.9) is not None) == delivered


def test_safety_rule_5_a_fall_within_the_gusts_is_no_proof():
    watch = ReleaseMonitor(power_frac=0.05, thrust_frac=0.0)
    hover(watch, 0.0, 10.0, 470.0, 60.0)
    watch.record_release_order(10.0)
    hover(watch, 10.0, 14.0, 445.0, 60.0)  # 5 % less, with a power variation of 13 %
    assert watch.release_evidence_text(14.0) is None


def test_safety_rule_5_without_any_measurement_nothing_is_confirmed_but_by_the_gripper():
    watch = ReleaseMonitor(power_frac=0.28, thrust_frac=0.2)
    watch.record_release_order(10.0)
    assert watch.release_evidence_text(20.0) is None
    watch.gripper_reports = 1
    assert watch.release_evidence_text(20.0) == "reported by the gripper"


def in_flight(
    resting_v: float, speed_rule: SpeedRule = "least_energy"
) -> tuple[FlightEstimates, RemainingMission]:
    """Return estimates with a known wind and battery, over the depot of the default flight."""
    judge = judgement(speed_rule)
    battery = ev.Battery(1.0, voltage_v=resting_v, current_a=0.5, temperature_c=25.0)
    judge.update_from_telemetry(standing(1.0, battery), ev.AutopilotKind.PX4)
    judge.wind = WindBelief(60.0, np.array([2.0, -3.0]), 0.2 * np.eye(2), ("test",), True)
    depot, customer, level = (0.0, 0.0, 0.0), (0.0, -400.0, 0.0), -40.0
    plan = Plan(
        depot_ned_m=depot, customer_ned_m=customer,
        outbound_ned_m=((0.0, -200.0, level), (0.0, -400.0, level)),
        return_ned_m=((0.0, -200.0, level), (0.0, 0.0, level)),
        entry=(1, 0), rally=(), home_ground_speed_mps=9.0,
        energy_wh=0.0, time_s=0.0, route_std_wh=0.0,
    )  # fmt: skip
    return judge, remaining_outbound(plan, (0.0, 0.0, level), 0, judge.payload_kg, 6.0, 12.0)


def test_the_fastest_that_the_budget_allows_is_less_with_less_in_the_battery():
    speeds = []
    for voltage_v in (25.6, 22.94, 22.6):  # ample, close, too little to return
        judge, ahead = in_flight(voltage_v, "fastest")
        seen = judge.assess(ahead)
        assert seen is not None
        speeds.append(0.0 if judge.gate.fast_airspeed_mps is None else judge.gate.fast_airspeed_mps)
    top = fastest_planning_airspeed_mps(AIRFRAME, FLIGHT.vehicle.payload_kg, 1.225)
    assert speeds[0] == pytest.approx(top)
    assert 14.0 < speeds[1] < top - 1.0
    assert speeds[2] == 0.0


def test_the_fastest_is_commanded_and_keeps_the_promise():
    judge, ahead = in_flight(25.6, "fastest")
    slow = judge.ground_speed_to_command_mps((0.0, 0.0, -40.0), (0.0, -200.0, -40.0))
    assert judge.assess(ahead) is not None
    fast = judge.ground_speed_to_command_mps((0.0, 0.0, -40.0), (0.0, -200.0, -40.0))
    assert slow is not None
    assert fast is not None
    assert fast > slow + 2.0
    assert judge.gate.fast_airspeed_mps is not None
    unhurried = judgement_of(ahead, 25.6, None)
    in_haste = judgement_of(ahead, 25.6, judge.gate.fast_airspeed_mps)
    assert in_haste.p_home >= 1.0 - FLIGHT.mission.max_loss
    assert in_haste.energy_need_wh > unhurried.energy_need_wh


def judgement_of(
    ahead: RemainingMission, voltage_v: float, airspeed_mps: float | None
) -> Assessment:
    judge, _ = in_flight(voltage_v)
    seen = judge.assess(ahead if airspeed_mps is None else with_min_airspeed(ahead, airspeed_mps))
    assert seen is not None
    return seen


def armed(t_s: float, now: TelemetryState, *events: ev.Event) -> TelemetryState:
    now.store_event(ev.VehicleState(t_s, ev.Mode.LAND, "LAND", armed=True))
    for event in (*events, ev.Position(t_s, 55.0, 8.0, 12.0, 0.2, 0.0, 0.0, 0.0), ev.Tick(t_s)):
        now.store_event(event)
    return now


def counted_on_the_ground(throttle_frac: float, *, landed: bool) -> float:
    """Return the Wh counted in a minute when armed: 40 W reported, then no battery messages."""
    judge = judgement()
    now = standing(1.0, ev.Battery(1.0, voltage_v=25.6, current_a=0.5))
    judge.update_from_telemetry(now, ev.AutopilotKind.ARDUPILOT)
    state = ev.GroundState(
        2.0, ev.VehicleLandedState.ON_GROUND if landed else ev.VehicleLandedState.IN_AIR
    )
    for k in range(600):
        t_s = 2.0 + 0.1 * k
        current_a = 1.6 + 0.02 * (k % 3)  # a working sensor varies
        told = ev.Battery(t_s, voltage_v=25.6, current_a=current_a), ev.Throttle(t_s, throttle_frac)
        judge.update_from_telemetry(armed(t_s, now, state, *told), ev.AutopilotKind.ARDUPILOT)
    assert judge.energy is not None
    return judge.energy.used_wh


@pytest.mark.parametrize(("throttle_frac", "landed"), [(0.0, False), (0.2, True)])
def test_safety_rule_4_no_hover_power_is_counted_on_the_ground(throttle_frac, landed):
    # 41 W for a minute is 0.7 Wh; hover power would be 8.
    assert counted_on_the_ground(throttle_frac, landed=landed) < 1.0


def test_safety_rule_4_a_current_that_fails_in_a_hover_is_no_idling():
    assert counted_on_the_ground(0.4, landed=False) > 4.0


def test_another_packs_message_is_no_word_on_the_first_pack():
    now = TelemetryState()
    now.store_event(ev.Battery(1.0, voltage_v=22.0, remaining_frac=0.6, pack=0))
    now.store_event(ev.Battery(1.5, voltage_v=24.0, remaining_frac=0.8, pack=1))
    assert now.battery is not None
    assert (now.battery.voltage_v, now.battery.remaining_frac) == (22.0, 0.6)
    assert now.pack.messages[1].remaining_frac == 0.8


def test_two_packs_some_points_apart_ground_nothing():
    judge = judgement()
    now = standing(1.0, ev.Battery(1.0, voltage_v=25.6, current_a=0.5))
    left = []
    for k in range(40):
        t_s = 1.5 + 0.5 * k
        one = ev.Battery(t_s, voltage_v=25.6, current_a=0.5, remaining_frac=0.95, pack=0)
        other = ev.Battery(t_s, voltage_v=25.5, remaining_frac=0.90, pack=1)
        judge.update_from_telemetry(standing(t_s, one, other, now=now), ev.AutopilotKind.ARDUPILOT)
        assert judge.energy is not None
        left.append(judge.energy.mean_wh / judge.energy.usable_full_wh)
    assert left[-1] == left[0] == pytest.approx(0.90)


def test_settled_air_reaches_power_limits_wind_and_energy_and_lives_through_a_restart():
    judge, hot_and_high = judgement(), Air(70_109.0, 40.0, "test")
    hover_w, top_mps = (
        judge.route_energy.hover_power_w(0.0),
        fastest_planning_airspeed_mps(AIRFRAME, 0, 1.225),
    )
    judge.update_from_telemetry(
        standing(1.0, ev.Battery(1.0, voltage_v=25.6, current_a=0.5)), ev.AutopilotKind.PX4
    )
    full_wh = judge.energy.usable_full_wh
    judge.fix_air_properties(hot_and_high)
    judge.update_from_telemetry(
        standing(2.0, ev.Battery(2.0, voltage_v=25.6, current_a=0.5)), ev.AutopilotKind.PX4
    )
    # Momentum theory: power except the avionics' scales with density to the -1/2, here 1.253.
    thin_w = judge.route_energy.hover_power_w(0.0)
    assert (thin_w - 15.0) / (hover_w - 15.0) == pytest.approx((1.225 / 0.780) ** 0.5, rel=0.001)
    assert judge.route_energy.fastest_planning_airspeed_mps(0.0) > 1.2 * top_mps
    assert judge.energy.usable_full_wh < full_wh, "a pack gives less at a higher draw"
    again = judgement()
    again.restore(msgspec.convert(judge.snapshot(), EstimatesSnapshot))
    assert again.air == hot_and_high
    assert again.route_energy.hover_power_w(0.0) == thin_w


def test_the_wind_filter_is_told_the_air_in_each_observation():
    told = []

    class Listening(WindEstimator):
        def update(self, observation):
            told.append(observation.density_kgpm3)
            return super().update(observation)

    judge = FlightEstimates(
        FLIGHT, AIRFRAME, RouteEnergy(AIRFRAME), WIND_PROCESS, Listening(AIRFRAME)
    )
    judge.fix_air_properties(Air(70_109.0, 40.0, "test"))
    judge.update_from_telemetry(standing(1.0), ev.AutopilotKind.PX4)
    assert told == [pytest.approx(0.780, abs=0.001)]
