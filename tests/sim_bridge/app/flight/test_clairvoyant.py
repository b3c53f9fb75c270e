"""The clairvoyant against energies calculated by hand from the truth's steady power."""

import math
from pathlib import Path

import pytest

from sim_bridge.app.flight.clairvoyant import (
    MissionProfile,
    ReturnRoute,
    SpeedLimits,
    TrueConditions,
    compute_clairvoyant_result,
)
from sim_bridge.app.flight.clairvoyant_flight import build_routes_to_landing_sites
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.steady_flight import SteadyFlight

TRUTH = load_airframe(Path(__file__).parents[4] / "params" / "truth" / "m100.toml")
STEADY = SteadyFlight(TRUTH)
CUSTOMER = (0.0, 600.0)
HOME = ReturnRoute([CUSTOMER, (0.0, 0.0)], 0.0)
PLAN = {
    "out_ne_m": [(0.0, 0.0), CUSTOMER],
    "return_routes": [HOME],
    "cruise_height_m": 40.0,
    "return_height_m": 40.0,
    "drop_up_m": 10.0,
    "settle_s": 10.0,
    "hover_s": 12.0,
    "speeds": SpeedLimits(4.0, 20.0, 18.0, 2.5),
    "takeoff_mps": 3.0,
    "climb_mps": 3.0,
    "descent_mps": 2.0,
    "landing_mps": 0.7,
    "slow_below_m": 10.0,
}


def flown(wind_at, charge_frac=1.0, **changes):
    means = TrueConditions(STEADY, wind_at, 0.6, 18.0, STEADY.hover_power_w())
    pack = Battery(TRUTH.battery, charge_frac=charge_frac)
    return compute_clairvoyant_result(MissionProfile(**(PLAN | changes)), means, pack, 0.0)


def calm(t_s: float, height_m: float) -> tuple[float, float]:
    return 0.0, 0.0


def steady_wind(north: float, east: float):
    return lambda t_s, height_m: (north, east)


def used_wh(end) -> float:
    full = Battery(TRUTH.battery).usable_wh(STEADY.hover_power_w())
    return full - 18.0 - end.margin_wh


def test_a_calm_flight_costs_what_its_parts_add_up_to() -> None:
    def power(speed: float, payload: float = 0.6, climb: float = 0.0) -> float:
        return STEADY.steady_state(speed, payload_kg=payload, climb_mps=climb).power_w

    loaded = min(power(v) / v for v in range(4, 19)) * 600.0
    empty = min(power(v, 0.0) / v for v in range(4, 19)) * 600.0
    upright_j = (
        power(0.0, climb=3.0) * 40.0 / 3.0
        + power(0.0) * 22.0
        + power(0.0, climb=-2.0) * 15.0
        + power(0.0, 0.0, 3.0) * 10.0
        + power(0.0, 0.0, -2.0) * 15.0
        + power(0.0, 0.0, -0.7) * 10.0 / 0.7
    )
    stops_j = 2 * 0.5 * (14.0 / 2.5) * (power(14.0) + power(14.0, 0.0))
    by_hand_wh = (upright_j + loaded + empty + stops_j) / 3600.0
    # The battery's loss under load is not in the sum: usable energy is counted at hover draw.
    assert used_wh(flown(calm)) == pytest.approx(by_hand_wh, abs=1.0)


def test_a_leg_is_flown_at_one_ground_speed_so_gusts_cost_and_are_not_ridden() -> None:
    def gusty(t_s: float, height_m: float) -> tuple[float, float]:
        return 0.0, 12.0 if int(t_s) % 2 else 4.0

    # In a mean headwind of 8 m/s power grows faster than speed: gusts increase the mean energy.
    assert used_wh(flown(gusty)) > used_wh(flown(steady_wind(0.0, 8.0))) + 0.5


def test_knowing_a_wind_that_turns_is_used() -> None:
    def turning(t_s: float, height_m: float) -> tuple[float, float]:
        return 0.0, 8.0 if t_s < 90.0 else -8.0  # a tailwind out, and a tailwind home

    assert used_wh(flown(turning)) < used_wh(flown(steady_wind(0.0, 8.0))) - 1.0


def test_it_lands_where_the_most_is_left() -> None:
    quay = ReturnRoute([CUSTOMER, (0.0, 300.0)], 2.0)
    against = steady_wind(0.0, 10.0)  # headwind on the return
    depot_only, either = flown(against), flown(against, return_routes=[HOME, quay])
    assert either.margin_wh > depot_only.margin_wh + 3.0
    charge = next(c / 100 for c in range(100) if flown(against, c / 100).margin_wh > -3.0)
    assert flown(against, charge).outcome == "ABRT"
    assert flown(against, charge, return_routes=[HOME, quay]).outcome == "SUC"


@pytest.mark.parametrize("wind", [(0.0, 25.0), (20.0, 0.0)])
def test_a_wind_that_lets_nobody_home_keeps_it_on_the_ground(wind: tuple[float, float]) -> None:
    assert flown(steady_wind(*wind)).outcome == "ABRT"


def test_a_pack_that_cuts_off_on_the_way_is_not_home() -> None:
    end = flown(calm, charge_frac=0.15)
    assert not end.home
    assert math.isfinite(end.margin_wh)


def test_a_way_back_in_a_higher_layer_costs_its_climb_and_its_longer_descent():
    higher = used_wh(flown(calm, return_height_m=52.0)) - used_wh(flown(calm))
    # 12 m more: 4 s of climb at 3 m/s, 6 s of descent at 2 m/s, both without parcel.
    empty = lambda climb: STEADY.steady_state(0.0, payload_kg=0.0, climb_mps=climb).power_w  # noqa: E731
    assert higher == pytest.approx((4.0 * empty(3.0) + 6.0 * empty(-2.0)) / 3600.0, abs=0.05)


def test_the_clairvoyant_lands_at_the_promised_stop_and_not_where_it_took_off():
    row = {
        "return_ned_m": [(0.0, 400.0, -40.0), (30.0, 250.0, -40.0)],
        "home_ned_m": (30.0, 250.0, -1.5),
        "rally": [],
    }
    (way,) = build_routes_to_landing_sites(row, CUSTOMER)
    assert way == ReturnRoute([CUSTOMER, (0.0, 400.0), (30.0, 250.0)], 1.5)
    # 600 m back to the launch pad, 353 m to the stop, at no less than the best of still air.
    saved = (600.0 - 200.0 - math.hypot(30.0, 150.0)) * min(
        STEADY.steady_state(v, payload_kg=0.0).power_w / v for v in range(4, 19)
    )
    nearer = used_wh(flown(calm)) - used_wh(flown(calm, return_routes=[way]))
    assert nearer == pytest.approx(saved / 3600.0, abs=0.3)
