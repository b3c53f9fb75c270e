"""The route in a state message is that of the onboard mission."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.adapters.files.params import (
    flight_file_path,
    read_airframe,
    read_flight,
    read_obstacle_document,
)
from companion.app.flight import published_state
from companion.core.exports.exported import build_mission_export
from companion.core.exports.ground_plan import plan_flight_without_vehicle
from companion.core.mission.flight_plan import FlightPlan
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.fleet.messages import MAX_ROUTE_CHARS
from companion.fleet.polyline import decode_polyline


@pytest.fixture(scope="module")
def flown() -> FlightPlan:
    path = flight_file_path("default")
    flight = read_flight(path)
    energy = RouteEnergy(read_airframe(flight.vehicle.airframe), REFERENCE_DENSITY_KGPM3)
    return plan_flight_without_vehicle(flight, energy, read_obstacle_document(flight, path))


def test_it_goes_by_the_waypoints_that_are_exported_to_other_tools(flown: FlightPlan):
    mission = build_mission_export(flown, "m")
    for text, points in zip(
        published_state.route_polylines(flown), (mission.outbound, mission.homeward), strict=True
    ):
        assert len(points) > 2, "it goes around something"
        assert len(text) < MAX_ROUTE_CHARS
        for told, point in zip(decode_polyline(text), points, strict=True):
            assert told == pytest.approx(point[:2], abs=0.6e-5)


def test_a_way_that_is_too_long_is_not_told_at_all(flown: FlightPlan):
    mission = flown.mission
    long = replace(mission, outbound=mission.outbound * MAX_ROUTE_CHARS)
    assert published_state.route_polylines(replace(flown, mission=long)) == ("", "")


@given(st.floats(0.01, 15.0), st.floats(0.01, 15.0), st.floats(0.0, 3.1416))
def test_a_covariance_is_told_in_few_digits_and_never_smaller_in_any_direction(
    one_mps: float, other_mps: float, angle_rad: float
):
    axes = np.array(
        [[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]]
    )
    cov = axes @ np.diag([one_mps**2, other_mps**2]) @ axes.T
    told = published_state.rounded_up_wind_cov_or_unset(cov)
    assert told is not msgspec.UNSET
    nn, ne, ee = told
    more = np.array([[nn, ne], [ne, ee]]) - cov
    assert np.linalg.eigvalsh(more).min() >= 0.0
    assert more.max() < 0.004
    assert max(len(str(number)) for number in told) <= 8


@pytest.mark.parametrize(
    "cov", [[[np.nan, 0.0], [0.0, 1.0]], [[1.0, 2.0], [2.0, 1.0]], [[401.0, 0.0], [0.0, 1.0]]]
)
def test_what_is_no_covariance_is_not_told(cov: list[list[float]]):
    assert published_state.rounded_up_wind_cov_or_unset(np.array(cov)) is msgspec.UNSET
