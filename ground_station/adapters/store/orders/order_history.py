"""History of an order, and the proof of its delivery, from the store's rows."""

from collections.abc import Iterator

import msgspec
import sqlalchemy as sa

from companion.core.mission.event_text import DELIVERED, DecisionEvent
from companion.fleet.messages import EventKind, FleetEvent
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.orders.order_changes import CHANGE, PROOF
from ground_station.adapters.store.shift import days
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.order_states import ParcelOutcome
from ground_station.core.schema.orders import AssignmentState, DeliveryProof, HistoryEntry

_SETTLED_AS_DELIVERED = f"{ParcelOutcome.DELIVERED.value},"
_ORDER_ACTIONS = ("order", "settle", CHANGE, PROOF)


def read_order_history(database: Database, order_id: str) -> list[HistoryEntry]:
    """Return what happened to an order, oldest first; empty: not known."""
    with database.read() as db:
        here = sa.select(t.orders.c.taken_us).where(t.orders.c.id == order_id)
        added_us = db.execute(here).scalar_one_or_none()
        if added_us is None:
            return []
        found = [HistoryEntry(added_us, "", "received"), *_assignment_entries(db, order_id)]
        query = sa.select(t.audit).where(
            t.audit.c.subject == order_id, t.audit.c.deed.in_(_ORDER_ACTIONS)
        )
        for row in db.execute(query.order_by(t.audit.c.n)):
            action = "" if row.deed in ("order", "settle") else f"{row.deed}: "
            found.append(HistoryEntry(row.at_us, row.who, f"{action}{row.answer}"))
    for proof in delivery_proofs(database, order_id).values():
        if proof.vehicle:
            found.append(
                HistoryEntry(proof.at_us, proof.vehicle, f"parcel released: {proof.evidence}")
            )
    return sorted(found, key=lambda entry: entry.at_us)


def attempts_by_order(database: Database) -> dict[str, int]:
    """Return the number of attempts to deliver each order; one that was withdrawn is none."""
    ends = (AssignmentState.DELIVERED, AssignmentState.RETURNED, AssignmentState.LOST)
    order = t.assignments.c.order_id
    query = sa.select(order, sa.func.count()).group_by(order)
    query = query.where(t.assignments.c.state.in_([state.value for state in ends]))
    if database.day is not None:
        query = query.where(t.assignments.c.made_us < days.end_us_of(database.day))
    with database.read() as db:
        return {row[0]: row[1] for row in db.execute(query)}


def _assignment_entries(db: sa.Connection, order_id: str) -> Iterator[HistoryEntry]:
    query = sa.select(t.assignments).where(t.assignments.c.order_id == order_id)
    for row in db.execute(query.order_by(t.assignments.c.n)):
        yield HistoryEntry(row.made_us, "", f"assigned to {row.vehicle}")
        if row.ended_us is not None:
            state = "ended" if row.state == AssignmentState.DELIVERED.value else row.state
            yield HistoryEntry(row.ended_us, row.vehicle, f"{state}: {row.why}".rstrip(": "))


def delivery_proofs(database: Database, order_id: str | None = None) -> dict[str, DeliveryProof]:
    """Return the proof of each delivered order, or of one: the release as its drone confirmed it,
    else the driver's or a person's report.
    """
    kind, content = t.events.c.kind, t.events.c.content
    released = content.like(f'%"text":"{DELIVERED}: %')
    reported = content.like('%"delivered":true%')
    query = (
        sa.select(t.assignments.c.order_id, content)
        .join(t.assignments, t.assignments.c.id == t.events.c.assignment)
        .where(
            t.events.c.vehicle.in_([t.assignments.c.vehicle, TRUCK]),
            sa.or_(
                (kind == EventKind.DECISION.value) & released,
                kind.in_([EventKind.OUTCOME.value, EventKind.RECOVERED.value]) & reported,
            ),
        )
        .order_by(t.events.c.n)
    )
    answers = sa.select(t.audit).where(t.audit.c.deed.in_(["settle", PROOF]))
    if order_id is not None:
        query = query.where(t.assignments.c.order_id == order_id)
        answers = answers.where(t.audit.c.subject == order_id)
    found: dict[str, DeliveryProof] = {}
    with database.read() as db:
        for row in db.execute(query):
            event = msgspec.json.decode(row.content, type=FleetEvent)
            if event.kind is EventKind.DECISION or row.order_id not in found:
                found[row.order_id] = _proof_of_event(event)
        for row in db.execute(answers.order_by(t.audit.c.n)):
            before = found.get(row.subject)
            if row.deed == PROOF and before is not None:
                found[row.subject] = msgspec.structs.replace(before, photo=row.answer)
            elif row.answer.startswith(_SETTLED_AS_DELIVERED) and before is None:
                found[row.subject] = DeliveryProof(at_us=row.at_us, evidence=row.answer)
    return found


def _proof_of_event(event: FleetEvent) -> DeliveryProof:
    if event.kind is not EventKind.DECISION:
        evidence = event.text or "reported as delivered"
        return DeliveryProof(at_us=event.epoch_us, vehicle=event.vehicle, evidence=evidence)
    decision = DecisionEvent.parse(event.text)
    at = decision.release_position
    return DeliveryProof(
        at_us=event.epoch_us,
        vehicle=event.vehicle,
        evidence=decision.release_evidence,
        lat_deg=None if at is None else at[0],
        lon_deg=None if at is None else at[1],
    )


def record_photo(database: Database, now_us: int, order_id: str, photo: str, by: str) -> None:
    """Record the path and digest of a photo that shows the delivery."""
    with database.write() as db:
        audit.add_entry(db, now_us, by, PROOF, order_id, photo)
