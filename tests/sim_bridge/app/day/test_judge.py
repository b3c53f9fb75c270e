"""The judge of a simulated day finds each violation put into a synthetic day (canaries), and none
in regular days.

Expected numbers are the geometry of the days below, calculated by hand."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_bridge.app.day.judge import (
    DayTruth,
    Handover,
    HomeReport,
    Pad,
    ParkedInterval,
    VehicleTrack,
    evaluate_day,
)
from sim_bridge.app.world.truth_record import COLUMNS, TruthRecord

CUSTOMER = (600.0, 0.0, -2.0)
PADS = [Pad("s1", name, (0.0, 30.0 * k)) for k, name in enumerate(("d1", "d2"))]


def track(
    t_s: np.ndarray,
    ned_m: np.ndarray,
    airborne: np.ndarray | None = None,
    *,
    vehicle: str = "d1",
    order: str = "o1",
    margin_wh: float = 10.0,
    override_time_s: float | None = None,
    **events: Any,
) -> VehicleTrack:
    """Return a track with these samples and events of its record; airborne by default."""
    table = np.zeros((t_s.size, len(COLUMNS)))
    table[:, 0], table[:, 1:4] = t_s, ned_m
    table[:, COLUMNS.index("airborne")] = 1.0 if airborne is None else airborne
    table[:, COLUMNS.index("usable_wh")] = margin_wh
    record = TruthRecord([tuple(row) for row in table.tolist()], **({"takeoff_s": 0.0} | events))
    return VehicleTrack(vehicle, "px4", order, record, 0.0, override_time_s)


def out_and_back(
    vehicle: str = "d1",
    order: str = "o1",
    *,
    start_s: float = 100.0,
    height_m: float = 40.0,
    east_m: float = 0.0,
    backwards: bool = False,
    **changes: Any,
) -> VehicleTrack:
    """60 s north at 10 m/s to 600 m and 60 s back, parcel released half way; samples at 5 Hz."""
    t_s = start_s + np.arange(0.0, 140.0, 0.2)
    since = t_s - start_s - 10.0
    north = 10.0 * np.clip(np.minimum(since, 120.0 - since), 0.0, None)
    if backwards:
        north = 600.0 - north
    flying = (since > 0.0) & (since < 120.0)
    ned = np.column_stack([north, np.full_like(t_s, east_m), np.where(flying, -height_m, 0.0)])
    release = {"released_s": start_s + 70.0, "released_ned_m": (600.0, 0.0, -7.0)}
    record = {"airborne": flying, "release_height_m": 5.0} | release
    return track(t_s, ned, vehicle=vehicle, order=order, **(record | changes))


def day(*tracks: VehicleTrack, **changes) -> DayTruth:
    world = DayTruth(
        customers={"o1": CUSTOMER, "o2": (600.0, 30.0, 0.0)},
        drop_height_m=6.0,
        tracks=list(tracks),
        parked_intervals=[ParkedInterval("s1", (0.0, 0.0), 0.0, math.inf)],
        pads=PADS,
        home_reports=[HomeReport(0.0, "d1", "s1")],
        handovers=[],
    )
    return replace(world, **changes)


def test_a_flight_out_and_back_is_home_and_its_order_delivered_once():
    verdict = evaluate_day(day(out_and_back()))
    (flight,) = verdict.flights
    assert (flight.outcome, flight.stop) == ("SUC", "s1")
    assert flight.launch_s == pytest.approx(110.2)
    assert flight.land_s == pytest.approx(229.8)
    assert verdict.delivered == {"o1": "d1"}
    assert (verdict.lost_flights, verdict.duplicate_orders, verdict.broken_promises) == ([], [], [])
    assert verdict.minimum_separation is None


def test_two_on_a_collision_course_are_found_between_their_samples():
    """Head on along one line at 10 m/s each: they meet where both are at 300 m, with 2 m
    between their heights; at 5 Hz the nearest samples differ by up to 4 m."""
    one = out_and_back()
    other = out_and_back("d2", "o2", start_s=100.07, height_m=42.0, backwards=True)
    near = evaluate_day(day(one, other)).minimum_separation
    assert near is not None
    assert near.distance_m == pytest.approx(2.0, abs=0.05)
    assert near.horizontal_m == pytest.approx(0.0, abs=0.05)
    assert near.vertical_m == pytest.approx(2.0)
    assert near.vehicles == ("d1", "d2")


def test_side_by_side_they_are_as_far_apart_as_their_pads():
    verdict = evaluate_day(day(out_and_back(), out_and_back("d2", "o2", east_m=30.0)))
    assert verdict.minimum_separation is not None
    assert verdict.minimum_separation.distance_m == pytest.approx(30.0)
    assert verdict.nearest_horizontal_m == pytest.approx(30.0)


def test_one_that_stands_while_the_other_flies_past_is_no_approach():
    later = out_and_back("d2", "o2", start_s=400.0)
    assert evaluate_day(day(out_and_back(), later)).minimum_separation is None


def test_an_order_that_is_flown_again_after_it_was_delivered_is_found():
    again = out_and_back("d2", "o1", start_s=400.0, east_m=30.0)
    assert evaluate_day(day(out_and_back(), again)).duplicate_orders == ["o1"]


def test_an_order_that_is_flown_again_after_it_was_not_delivered_is_none():
    first = out_and_back(released_s=None, released_ned_m=None, release_height_m=None)
    verdict = evaluate_day(day(first, out_and_back(start_s=400.0)))
    assert [f.outcome for f in verdict.flights] == ["ABRT", "SUC"]
    assert verdict.duplicate_orders == []


def test_an_order_that_drone_and_truck_both_brought_is_found():
    assert evaluate_day(
        day(out_and_back(), handovers=[Handover("o1", 900.0)])
    ).duplicate_orders == ["o1"]


def test_a_truck_that_leaves_a_promised_stop_is_found_and_the_vehicle_is_not_home():
    world = day(out_and_back(), parked_intervals=[ParkedInterval("s1", (0.0, 0.0), 0.0, 150.0)])
    verdict = evaluate_day(world)
    (words,) = verdict.broken_promises
    assert "left s1 at 150 s, 80 s before it was down" in words
    assert verdict.lost_flights == ["d1 with o1"]


def test_a_truck_that_leaves_after_another_home_was_read_back_breaks_nothing():
    stands = [
        ParkedInterval("s1", (0.0, 0.0), 0.0, 150.0),
        ParkedInterval("s2", (0.0, 500.0), 200.0, math.inf),
    ]
    homes = [HomeReport(0.0, "d1", "s1"), HomeReport(149.0, "d1", "s2")]
    flown = out_and_back()
    down = flown.ned_m + np.where(flown.t_s > 200.0, 500.0, 0.0)[:, None] * [0.0, 1.0, 0.0]
    flight = track(flown.t_s, down, flown.airborne)
    world = day(flight, parked_intervals=stands, home_reports=homes)
    verdict = evaluate_day(replace(world, pads=[*PADS, Pad("s2", "d1", (0.0, 500.0))]))
    assert verdict.broken_promises == []
    assert verdict.flights[0].stop == "s2"


def test_one_that_lands_where_no_pad_of_its_own_is_is_lost():
    verdict = evaluate_day(day(out_and_back("d2", "o1")))
    assert verdict.lost_flights == ["d2 with o1"]
    assert evaluate_day(day(out_and_back("d2", "o1"), rally=[(5.0, 5.0)])).lost_flights == []


NOWHERE = {"pads": []}
LOST = ["d1 with o1"]
LANDED_S = out_and_back().t_s[650]  # after 10 s on the ground and 120 s in the air, at 5 Hz


@pytest.mark.parametrize(
    ("changes", "world", "outcome", "lost"),
    [
        ({"margin_wh": -0.1}, {}, "DEL", LOST),
        ({"crashed": True}, {}, "DEL", LOST),
        ({"airborne": np.ones(700)}, {}, "DEL", LOST),
        ({"released_ned_m": (580.0, 0.0, -7.0)}, {}, "ABRT", []),
        ({"release_height_m": 25.0}, {}, "ABRT", []),
        ({"pilot_landings_s": [LANDED_S]}, NOWHERE, "TAKEN", []),
        ({"pilot_landings_s": [LANDED_S], "crashed": True}, {}, "DEL", LOST),
        ({"override_time_s": 150.0}, NOWHERE, "DEL", LOST),  # landed by a failsafe
        ({"pilot_landings_s": [50.0]}, NOWHERE, "DEL", LOST),  # an earlier landing
    ],
)
def test_a_flight_with_one_change_has_another_outcome(changes, world, outcome, lost):
    verdict = evaluate_day(day(out_and_back(**changes), **world))
    (flight,) = verdict.flights
    assert (flight.outcome, verdict.lost_flights) == (outcome, lost)
    assert flight.home == (outcome == "ABRT")
    assert verdict.delivered == ({} if outcome == "ABRT" else {"o1": "d1"})
