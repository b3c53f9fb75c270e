"""The judge of a simulated day finds what is put into a made-up day: its canaries, and quiet days.

Expected numbers are the geometry of the days below, worked by hand.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_bridge.app.day.judge import DayFacts, HandedOver, Pad, Stand, Told, VehicleTrack, judge_day

PAD = (0.0, 0.0)
CUSTOMER = (600.0, 0.0, -2.0)
PADS = [Pad("s1", name, (0.0, 30.0 * k)) for k, name in enumerate(("d1", "d2"))]


def out_and_back(
    vehicle: str = "d1",
    order: str = "o1",
    *,
    start_s: float = 100.0,
    height_m: float = 40.0,
    east_m: float = 0.0,
    backwards: bool = False,
) -> VehicleTrack:
    """60 s up at 10 m/s north to 600 m and 60 s back, parcel let go half way; samples at 5 Hz."""
    t_s = start_s + np.arange(0.0, 140.0, 0.2)
    since = t_s - start_s - 10.0
    north = 10.0 * np.clip(np.minimum(since, 120.0 - since), 0.0, None)
    if backwards:
        north = 600.0 - north
    flying = (since > 0.0) & (since < 120.0)
    ned = np.column_stack([north, np.full_like(t_s, east_m), np.where(flying, -height_m, 0.0)])
    return VehicleTrack(
        vehicle=vehicle,
        autopilot="px4",
        order=order,
        pad_ne_m=PAD,
        t_s=t_s,
        ned_m=ned,
        airborne=flying.astype(float),
        energy_used_wh=20.0,
        margin_wh=10.0,
        released_s=start_s + 70.0,
        released_ned_m=(600.0, 0.0, -7.0),
        release_height_m=5.0,
    )


def day(*tracks: VehicleTrack, **changes) -> DayFacts:
    world = DayFacts(
        customers={"o1": CUSTOMER, "o2": (600.0, 30.0, 0.0)},
        drop_height_m=6.0,
        tracks=list(tracks),
        stands=[Stand("s1", (0.0, 0.0), 0.0, math.inf)],
        pads=PADS,
        homes=[Told(0.0, "d1", "s1")],
        served=[],
    )
    return replace(world, **changes)


def test_a_flight_out_and_back_is_home_and_its_order_delivered_once():
    verdict = judge_day(day(out_and_back()))
    (flight,) = verdict.flights
    assert (flight.outcome, flight.stop) == ("SUC", "s1")
    assert flight.launch_s == pytest.approx(110.2)
    assert flight.land_s == pytest.approx(229.8)
    assert verdict.delivered == {"o1": "d1"}
    assert (verdict.lost, verdict.twice, verdict.broken) == ([], [], [])
    assert verdict.nearest is None


def test_two_on_a_collision_course_are_found_between_their_samples():
    """Head on along one line at 10 m/s each: they meet where both are at 300 m, 2 m apart in
    height; at 5 Hz the nearest samples are up to 4 m apart."""
    one = out_and_back()
    other = out_and_back("d2", "o2", height_m=42.0, backwards=True)
    other = replace(other, t_s=other.t_s + 0.07)
    near = judge_day(day(one, other)).nearest
    assert near is not None
    assert near.distance_m == pytest.approx(2.0, abs=0.05)
    assert near.horizontal_m == pytest.approx(0.0, abs=0.05)
    assert near.vertical_m == pytest.approx(2.0)
    assert near.vehicles == ("d1", "d2")


def test_side_by_side_they_are_as_far_apart_as_their_pads():
    verdict = judge_day(day(out_and_back(), out_and_back("d2", "o2", east_m=30.0)))
    assert verdict.nearest is not None
    assert verdict.nearest.distance_m == pytest.approx(30.0)
    assert verdict.nearest_horizontal_m == pytest.approx(30.0)


def test_one_that_stands_while_the_other_flies_past_is_no_approach():
    later = out_and_back("d2", "o2", start_s=400.0)
    assert judge_day(day(out_and_back(), later)).nearest is None


def test_an_order_that_is_flown_again_after_it_was_delivered_is_found():
    again = out_and_back("d2", "o1", start_s=400.0)
    again = replace(again, ned_m=again.ned_m + np.array([0.0, 30.0, 0.0]))
    assert judge_day(day(out_and_back(), again)).twice == ["o1"]


def test_an_order_that_is_flown_again_after_it_was_not_delivered_is_none():
    first = replace(out_and_back(), released_s=None, released_ned_m=None, release_height_m=None)
    verdict = judge_day(day(first, out_and_back(start_s=400.0)))
    assert [f.outcome for f in verdict.flights] == ["ABRT", "SUC"]
    assert verdict.twice == []


def test_an_order_that_drone_and_truck_both_brought_is_found():
    assert judge_day(day(out_and_back(), served=[HandedOver("o1", 900.0)])).twice == ["o1"]


def test_a_truck_that_leaves_a_promised_stop_is_found_and_the_vehicle_is_not_home():
    world = day(out_and_back(), stands=[Stand("s1", (0.0, 0.0), 0.0, 150.0)])
    verdict = judge_day(world)
    (words,) = verdict.broken
    assert "left s1 at 150 s, 80 s before it was down" in words
    assert verdict.lost == ["d1 with o1"]


def test_a_truck_that_leaves_after_another_home_was_read_back_breaks_nothing():
    stands = [Stand("s1", (0.0, 0.0), 0.0, 150.0), Stand("s2", (0.0, 500.0), 200.0, math.inf)]
    homes = [Told(0.0, "d1", "s1"), Told(149.0, "d1", "s2")]
    flight = out_and_back()
    down = flight.ned_m + np.where(flight.t_s > 200.0, 500.0, 0.0)[:, None] * [0.0, 1.0, 0.0]
    world = day(replace(flight, ned_m=down), stands=stands, homes=homes)
    verdict = judge_day(replace(world, pads=[*PADS, Pad("s2", "d1", (0.0, 500.0))]))
    assert verdict.broken == []
    assert verdict.flights[0].stop == "s2"


def test_one_that_lands_where_no_pad_of_its_own_is_is_lost():
    verdict = judge_day(day(replace(out_and_back("d2", "o1"))))
    assert verdict.lost == ["d2 with o1"]
    assert judge_day(day(out_and_back("d2", "o1"), rally=[(5.0, 5.0)])).lost == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"margin_wh": -0.1},
        {"crashed": True},
        {"airborne": np.ones(700)},
    ],
)
def test_below_the_reserve_crashed_or_still_in_the_air_is_not_home(wrong):
    verdict = judge_day(day(replace(out_and_back(), **wrong)))
    assert [f.outcome for f in verdict.flights] == ["DEL"]


@pytest.mark.parametrize(
    "wrong", [{"released_ned_m": (580.0, 0.0, -7.0)}, {"release_height_m": 25.0}]
)
def test_a_parcel_let_go_elsewhere_or_from_high_up_is_not_delivered(wrong):
    verdict = judge_day(day(replace(out_and_back(), **wrong)))
    assert verdict.delivered == {}
    assert verdict.flights[0].outcome == "ABRT"


def test_a_vehicle_that_a_person_brought_down_elsewhere_is_accounted_for():
    track = replace(out_and_back(), taken_s=150.0)
    verdict = judge_day(day(track, pads=[]))
    assert verdict.lost == []
    assert verdict.flights[0].outcome == "TAKEN"
    assert not verdict.flights[0].home


def test_a_vehicle_that_crashed_after_a_person_took_over_is_lost():
    track = replace(out_and_back(), taken_s=150.0, crashed=True)
    verdict = judge_day(day(track))
    assert verdict.lost == ["d1 with o1"]
    assert verdict.flights[0].outcome == "DEL"


def test_a_take_over_on_the_ground_excuses_no_later_flight():
    track = replace(out_and_back(), taken_s=50.0)
    assert judge_day(day(track, pads=[])).lost == ["d1 with o1"]
