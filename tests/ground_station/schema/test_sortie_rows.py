"""What binds a truck to a stop (safety rule 3): the promise, and drones that still stand there."""

from dataclasses import replace

from companion.core.base.place import Place
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.orders import AssignmentRow, AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow

PAD = Place(lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0)


def row(state: AssignmentState, **more) -> SortieRow:
    flown = PlannedSortie(
        order="H-1", vehicle="d1", launch="stop-1", home="stop-2", launch_s=60.0, land_s=200.0,
        outbound_height_m=40.0, return_height_m=40.0, energy_wh=20.0, sure_wh=30.0, usable_wh=80.0,
    )  # fmt: skip
    assignment = AssignmentRow("H-1.1", "H-1", "d1", state, delivered=False, why="")
    pads = {"stop-1": PAD, "stop-2": PAD}
    return SortieRow(
        row=assignment, sortie=flown, pads=pads, promised="stop-2", placed=True, **more
    )


def test_safety_rule_3_the_promised_stop_binds_until_the_drone_is_aboard():
    flying = row(AssignmentState.FLYING, launched_us=1)
    landed = row(AssignmentState.DELIVERED, launched_us=1, landed_us=2)
    assert flying.binds("stop-2")
    assert landed.binds("stop-2")
    assert replace(landed, recovered=True).binds("stop-2") is None
    assert replace(flying, asked="stop-3").binds("stop-3")


def test_a_drone_that_landed_before_the_truck_came_does_not_keep_it_from_coming():
    """It stands at the promised stop: bound to where it was launched, the truck never came."""
    landed = row(AssignmentState.DELIVERED, launched_us=1, landed_us=2)
    assert landed.binds("stop-1") is None


def test_a_drone_that_still_stands_where_it_was_put_out_binds_the_truck_there():
    assert row(AssignmentState.ABOARD).binds("stop-1")
    assert row(AssignmentState.ABOARD, launching=True).binds("stop-1")
    assert row(AssignmentState.WITHDRAWN).binds("stop-1")  # never flew, is not taken aboard yet
    back = row(AssignmentState.WITHDRAWN, launched_us=1, recovering=True)
    assert back.binds("stop-1")  # it came down where it was launched: the driver was told
