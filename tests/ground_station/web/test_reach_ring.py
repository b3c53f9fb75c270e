"""Remaining range of a drone on the map, against the energy model priced for each leg."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.special import ndtri

from companion.core.base.geo import ne_offset_m
from companion.core.routing.leg_energy import Leg, LegKind
from companion.fleet.messages import State
from ground_station.app.map.reach_ring import BEARING_COUNT, ReachableAreas
from ground_station.core.feasibility.reach import route_energy_model_for_day
from tests.ground_station.desk_parts import a_state
from tests.ground_station.web.map_site import HARBOUR

HERE = (55.475, 8.46)
WIND = (0.0, -4.0)


def state(**more: Any) -> State:
    fields: dict[str, Any] = {"energy_left_wh": 60.0, "height_rel_m": 40.0, "lat_deg": HERE[0],
                              "lon_deg": HERE[1], "wind_to_n_mps": WIND[0],
                              "wind_to_e_mps": WIND[1]}  # fmt: skip
    return a_state(phase="outbound", **(fields | more))


def radii(**more: Any) -> np.ndarray:
    ring = ReachableAreas(HARBOUR).reachable_boundary_points(state(**more), 0.4)
    assert ring is not None
    return np.array([math.hypot(*ne_offset_m(*HERE, *point)) for point in ring])


def test_at_its_edge_the_whole_leg_costs_what_is_left_above_the_reserve():
    """The leg at its full length by the model, all errors by central differences of that."""
    day = HARBOUR.day
    airframe = HARBOUR.airframes["m100"]
    energy, battery = route_energy_model_for_day(day, airframe), airframe.battery
    full_wh = battery.usable_energy_of_full_pack_wh(energy.hover_power_w(0.4), 20.0, 1.0)
    for bearing in (0, 12, 24, 36):
        far_m = radii()[bearing]
        angle = 2.0 * math.pi * bearing / BEARING_COUNT
        end = (far_m * math.cos(angle), far_m * math.sin(angle))
        legs = (
            Leg(LegKind.CRUISE, (0.0, 0.0, -40.0), (*end, -40.0), 0.4),
            Leg(LegKind.LAND, (*end, -40.0), (*end, 0.0), 0.4),
        )

        def price_wh(wind: tuple[float, float], legs: tuple[Leg, ...] = legs) -> float:
            return float(energy.leg_costs_wind_major(legs, np.array([wind])).energy_wh.sum())

        mean_wh, step = price_wh(WIND), 0.1
        slopes = [
            (price_wh((WIND[0] + n, WIND[1] + e)) - price_wh((WIND[0] - n, WIND[1] - e))) / 0.2
            for n, e in ((step, 0.0), (0.0, step))
        ]
        errors = (
            day.forecast.std_mps * math.hypot(*slopes),
            airframe.power_rotor.model_std_frac * mean_wh,
            battery.usable_std_frac * 60.0,
        )
        sigmas = float(ndtri(1.0 - day.mission.max_loss))
        spent_wh = mean_wh + sigmas * math.hypot(*errors)
        assert spent_wh == pytest.approx(60.0 - day.mission.reserve_frac * full_wh, rel=0.02)


def test_it_is_farthest_with_the_wind_and_nearest_against_it():
    found = radii()
    assert np.argmax(found) == 36  # to the west, where the air moves to
    assert np.argmin(found) == 12


def test_more_energy_is_farther_and_none_above_the_reserve_is_nowhere():
    assert (radii(energy_left_wh=70.0) > radii()).all()
    assert radii(energy_left_wh=5.0).max() < 0.01


def test_what_the_state_lacks_makes_no_ring():
    rings = ReachableAreas(HARBOUR)
    assert rings.reachable_boundary_points(state(energy_left_wh=None), 0.0) is None
    assert rings.reachable_boundary_points(state(lat_deg=None), 0.0) is None
    assert rings.reachable_boundary_points(replace(state(), vehicle="d9"), 0.0) is None
