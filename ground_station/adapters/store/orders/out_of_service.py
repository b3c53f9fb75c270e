"""A drone that a person takes out of service, with its order on the ground, and its spare."""

from collections.abc import Callable

import sqlalchemy as sa

from companion.core.base.errors import LeewayError
from companion.fleet.messages import Withdraw
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import day_steps
from ground_station.adapters.store import hold_steps as holds
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.about_steps import about_value, replace_about_value
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.hold_store import void_unsent_launches_and_list_sent
from ground_station.adapters.store.orders.order_changes import lock_order
from ground_station.adapters.store.shift.days import SPARES_KEY
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.holds import OUT_OF_SERVICE, raise_if_invalid_vehicle_name
from ground_station.core.schema.order_changes import OrderStage
from ground_station.core.schema.orders import AssignmentRow, AssignmentState


def take_out_of_service(
    database: Database,
    epoch_us: Callable[[], int],
    vehicle: str,
    reason: str,
    by: str,
    spare: str | None = None,
) -> list[str]:
    """Hold a drone and withdraw its order on the ground; returns what was done, as text.

    The caller's person states that it does not fly: at a depot its order is open at once, also if
    its companion is off. Raises LeewayError for an invalid name.
    """
    for name in (vehicle, spare):
        if name is not None:
            raise_if_invalid_vehicle_name(name)
    if vehicle == TRUCK:
        raise LeewayError("out of service: expected a drone, not the truck")
    if spare == vehicle:
        raise LeewayError(f"spare {spare}: expected another drone than {vehicle}")
    now_us = epoch_us()
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        text = f"{OUT_OF_SERVICE}{reason}" + (f"; {spare} is in its place" if spare else "")
        holds.insert_hold(db, now_us, vehicle, text, by)
        audit.add_entry(db, now_us, by, "hold", vehicle, text)
        void_unsent_launches_and_list_sent(db, vehicle)
        done = [f"{vehicle} is {text}"]
        row = _assignment_of_vehicle(db, vehicle)
        if row is not None:
            done.append(_withdraw(db, now_us, row, by, reason))
        if spare is not None:
            spares = about_value(db, SPARES_KEY, dict[str, str]) or {}
            spares[spare] = spares.get(vehicle, vehicle)
            replace_about_value(db, SPARES_KEY, spares)
            audit.add_entry(db, now_us, by, "spare", spare, f"in place of {vehicle}: {reason}")
            done.append(f"{spare} gets orders when it is on standby at the depot or on the truck")
    return done


def _assignment_of_vehicle(db: sa.Connection, vehicle: str) -> AssignmentRow | None:
    states = [state.value for state in rows.IN_FORCE]
    here = t.assignments.c.vehicle == vehicle, t.assignments.c.state.in_(states)
    found = db.execute(sa.select(t.assignments).where(*here)).one_or_none()
    return None if found is None else rows.assignment_from_database_row(found)


def _withdraw(db: sa.Connection, now_us: int, row: AssignmentRow, by: str, reason: str) -> str:
    *_, stage = lock_order(db, row.order_id)
    if stage is OrderStage.IN_AIR:
        return f"{row.order_id} is in the air, or its launch was sent: recall {row.vehicle}"
    text = f"{row.vehicle} out of service: {reason}"
    is_on_truck = sa.select(t.sorties.c.assignment).where(t.sorties.c.assignment == row.id)
    if db.execute(is_on_truck).first() is not None:  # the driver has it, and reports it as loaded
        if stage is OrderStage.ON_GROUND:
            day_steps.withdraw_before_launch(db, now_us, row, by, text)
        return f"{row.order_id} is withdrawn and planned again"
    rows.end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, text)
    action = Withdraw(assignment=row.id)  # for its companion, if it is on
    rows.enqueue_command(db, now_us, f"{row.id}:settled", row.vehicle, None, action, by)
    return f"{row.order_id} is withdrawn and goes to another drone"
