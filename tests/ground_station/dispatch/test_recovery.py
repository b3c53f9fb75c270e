"""Location of a drone that has reported its landing: `DispatchRules` on hand-made days."""

from dataclasses import replace

import msgspec
import pytest

from companion.core.base.location import Location
from ground_station.core.dispatch.day_snapshot import DaySnapshot, DroneStatus, TruckStatus
from ground_station.core.dispatch.dispatch_actions import (
    CancelHomeChange,
    ConfirmHomeChange,
    DeclareOffSite,
    DispatchAction,
    RecoverDrone,
)
from ground_station.core.dispatch.dispatch_rules import DispatchParams, DispatchRules
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.orders import AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow
from tests.ground_station.hand_made_day import TWO_STOPS, flight, place_at

LANDED = flight("d1", "depot", 60.0, 60.0)
PAD, NEXT = LANDED.pads["depot"], place_at(300.0)
FAR_LAT_DEG = PAD.lat_deg + 0.01
"""1.1 km away."""


def actions(
    lat_deg: float,
    *,
    assignment: str | None,
    present: bool = True,
    asked: str | None = None,
    lon_deg: float | None = None,
    landed: SortieRow = LANDED,
    truck_at: str = "depot",
    next_pad: Location = NEXT,
) -> list[DispatchAction]:
    """Return the actions after d1 reported its outcome and was last located there."""
    row = replace(
        landed,
        assignment=replace(landed.assignment, state=AssignmentState.DELIVERED),
        requested_stop=asked,
    )
    row = replace(row, pads=row.pads | {"stop-1": next_pad})
    seen = DroneStatus(
        "d1",
        present=present,
        assignment=assignment,
        lat_deg=lat_deg,
        lon_deg=PAD.lon_deg if lon_deg is None else lon_deg,
    )
    plan = DayPlan(
        format="day-plan/1", day="by hand", policy="by hand", seed=0, trials=0,
        makespan_s=540.0, stops=TWO_STOPS, sorties=[row.sortie],
    )  # fmt: skip
    day = DaySnapshot(
        now_s=270.0, start_us=0, plan=plan, truck=TruckStatus(True, False, truck_at),
        drones={"d1": seen}, open_orders=frozenset(), sorties=(row,), truck_assignments=(),
    )  # fmt: skip
    rules = DispatchRules(
        DispatchParams(), lambda sortie, others: None, lambda sortie, charge: True
    )
    return rules.due_actions(day)


def test_who_is_down_at_a_stop_is_taken_in_and_who_is_down_elsewhere_is_to_be_fetched():
    assert actions(PAD.lat_deg, assignment=None) == [RecoverDrone(LANDED.id, PAD)]
    assert actions(FAR_LAT_DEG, assignment=None)[0] == DeclareOffSite(LANDED.id)


@pytest.mark.parametrize("metres_apart", [0.0, 8.0])
@pytest.mark.parametrize("truck_at", ["depot", "stop-1"])
def test_of_two_stops_with_pads_at_one_place_it_is_down_where_the_truck_stands(
    truck_at, metres_apart
):
    """The day ends at its start position. A GNSS position cannot distinguish the two stops: the
    truck must not wait at the second for a drone that is at the first.
    """
    landed = flight("d1", "stop-1", 60.0, 60.0)
    other = msgspec.structs.replace(PAD, lat_deg=PAD.lat_deg + metres_apart / 111_195.0)
    due = actions(PAD.lat_deg, assignment=None, landed=landed, truck_at=truck_at, next_pad=other)
    assert RecoverDrone(landed.id, other if truck_at == "stop-1" else PAD) in due


@pytest.mark.parametrize("lat_deg", [PAD.lat_deg, FAR_LAT_DEG])
def test_a_state_of_before_the_landing_is_no_place_to_judge_by(lat_deg):
    """The outcome was received but the next state was lost: the truck waits for the following
    state. The last airborne position is not the landing position.
    """
    due = actions(lat_deg, assignment=LANDED.id)
    assert due == []  # the truck does not drive either


def test_who_is_not_heard_any_more_is_looked_for_where_it_was_promised():
    assert actions(FAR_LAT_DEG, assignment=LANDED.id, present=False) == [
        RecoverDrone(LANDED.id, PAD)
    ]


def test_where_a_flight_ended_tells_whether_it_had_taken_the_home_that_it_was_asked_for():
    """It is at the requested stop, at its former home, or not received."""
    at_asked = actions(NEXT.lat_deg, lon_deg=NEXT.lon_deg, assignment=None, asked="stop-1")
    assert at_asked == [ConfirmHomeChange(LANDED.id, "stop-1")]
    at_home = actions(PAD.lat_deg, assignment=None, asked="stop-1")
    assert at_home == [CancelHomeChange(LANDED.id, "stop-1")]
    unheard = actions(FAR_LAT_DEG, assignment=LANDED.id, present=False, asked="stop-1")
    assert unheard == [CancelHomeChange(LANDED.id, "stop-1")]
