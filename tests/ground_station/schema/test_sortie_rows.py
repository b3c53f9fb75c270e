"""Conditions that bind a truck to a stop (safety rule 3): promises and drones still there."""

from dataclasses import replace

from companion.core.base.location import Location
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.orders import AssignmentRow, AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow

PAD = Location(lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0)


def row(state: AssignmentState, **more) -> SortieRow:
    flown = PlannedSortie(
        order="H-1", vehicle="d1", launch="stop-1", home="stop-2", launch_s=60.0, land_s=200.0,
        outbound_height_m=40.0, return_height_m=40.0, energy_wh=20.0, required_wh=30.0,
        usable_wh=80.0,
    )  # fmt: skip
    assignment = AssignmentRow("H-1.1", "H-1", "d1", state, delivered=False, reason="")
    pads = {"stop-1": PAD, "stop-2": PAD}
    return SortieRow(
        assignment=assignment,
        sortie=flown,
        pads=pads,
        promised_stop="stop-2",
        put_on_pad=True,
        **more,
    )


def test_safety_rule_3_the_promised_stop_binds_until_the_drone_is_aboard():
    flying = row(AssignmentState.IN_FLIGHT, launched_us=1)
    landed = row(AssignmentState.DELIVERED, launched_us=1, landed_us=2)
    assert flying.binding_reason("stop-2")
    assert landed.binding_reason("stop-2")
    assert replace(landed, recovered=True).binding_reason("stop-2") is None
    assert replace(flying, requested_stop="stop-3").binding_reason("stop-3")


def test_a_drone_that_landed_before_the_truck_came_does_not_keep_it_from_coming():
    """The drone waits at the promised stop: the launch stop must not keep the truck from coming."""
    landed = row(AssignmentState.DELIVERED, launched_us=1, landed_us=2)
    assert landed.binding_reason("stop-1") is None


def test_a_drone_that_still_stands_where_it_was_put_out_binds_the_truck_there():
    assert row(AssignmentState.UPLOADED).binding_reason("stop-1")
    assert row(AssignmentState.UPLOADED, launch_pending=True).binding_reason("stop-1")
    assert row(AssignmentState.WITHDRAWN).binding_reason("stop-1")  # never flew, not recovered yet
    back = row(AssignmentState.WITHDRAWN, launched_us=1, recovery_ordered=True)
    assert back.binding_reason(
        "stop-1"
    )  # it landed where it was launched: the driver has the request


def test_only_the_actual_cause_of_an_unavailable_drone_is_named():
    off_site = row(AssignmentState.WITHDRAWN, is_off_site=True)
    lost, late = row(AssignmentState.LOST), row(AssignmentState.IN_FLIGHT, is_overdue=True)
    rows = (off_site, replace(off_site, put_on_pad=False), lost, late)
    causes = ["off site", "not put out by the driver", "lost", "overdue"]
    assert [one.unavailability_reason for one in rows] == causes
