"""Orders, assignments, commands and events of the day, in SQLite (WAL) or PostgreSQL.

Each method is one transaction: when it returns, all of it is on the disk, or nothing. Commands are
stored before they are sent (outbox pattern). A desk that is killed between the two sends the same
command again, and the vehicle carries it out once.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import msgspec
import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from companion.fleet.messages import (
    Assign,
    CommandAction,
    CommandStatus,
    EventKind,
    FleetEvent,
    Launch,
    Result,
)
from ground_station.adapters.store import about_steps as about
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import day_steps
from ground_station.adapters.store import hold_steps as holds
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.orders.order_changes import changed_order_ids
from ground_station.adapters.store.restored import apply_outcome
from ground_station.adapters.store.shift import days
from ground_station.core.schema.holds import Hold
from ground_station.core.schema.orders import (
    IN_FORCE,
    AssignmentRow,
    AssignmentState,
    CommandRow,
    Order,
    OrderRow,
    OrderState,
)

DRIVER_EVENTS = (EventKind.DRONE_ON_PAD, EventKind.RECOVERED, EventKind.TASK_FAILED)
_IN_FORCE = [state.value for state in IN_FORCE]
_ASSIGNMENTS = sa.select(t.assignments).order_by(t.assignments.c.n)  # built once: used often
_ASSIGNMENTS_IN_FORCE = _ASSIGNMENTS.where(t.assignments.c.state.in_(_IN_FORCE))
_OUTBOX = sa.select(t.commands).where(t.commands.c.answer.is_(None), t.commands.c.held.is_(False))


@lru_cache(maxsize=20_000)
def _decode_order(content: str) -> Order:
    """Cached by content: a desk reads all open orders repeatedly."""
    return msgspec.json.decode(content, type=Order)


@dataclass(frozen=True, slots=True)
class IntakeResult:
    """Result of adding orders. `conflicts`: known ids with other content. `kept`: those of `known`
    that a person has changed since. `earlier`: of an earlier day, closed.
    """

    added: tuple[str, ...]
    known: tuple[str, ...]
    conflicts: tuple[str, ...]
    kept: tuple[str, ...] = ()
    earlier: tuple[str, ...] = ()


class Store:
    """Store of one desk. `epoch_us` stamps rows for people; no decision depends on it."""

    def __init__(self, database: Database, epoch_us: Callable[[], int]) -> None:
        self._database = database
        self._epoch_us = epoch_us

    @property
    def database(self) -> Database:
        """The underlying database."""
        return self._database

    def epoch(self) -> str:
        """Return the epoch in force: another one after a restore."""
        with self._database.read() as db:
            return about.store_epoch(db)

    def close(self) -> None:
        """Close the connections."""
        self._database.close()

    # --- orders --------------------------------------------------------------------------------

    def add_orders_unless_conflict(self, orders: list[Order], by: str = "desk") -> IntakeResult:
        """Add all orders or, if an id is known with other content, none. An order that a person has
        changed since keeps the change.
        """
        try:
            return self._add_orders_in_transaction(orders, by)
        except IntegrityError:  # another desk added one of them: now it is known
            return self._add_orders_in_transaction(orders, by)

    def _add_orders_in_transaction(self, orders: list[Order], by: str) -> IntakeResult:
        with self._database.write() as db:
            found = db.execute(
                sa.select(t.orders.c.id, t.orders.c.content).where(
                    t.orders.c.id.in_([order.id for order in orders])
                )
            )
            existing = {row.id: row.content for row in found}
            changed = changed_order_ids(db) if existing else set[str]()
            earlier = days.of_earlier_days(db, list(existing))
            new_orders: dict[str, str] = {}
            known: list[str] = []
            kept: list[str] = []
            conflicts: list[str] = []
            for order in orders:
                content = msgspec.json.encode(order).decode()
                before = existing.get(order.id, new_orders.get(order.id))
                if before is None:
                    new_orders[order.id] = content
                elif _decode_order(before) == order:  # with defaults, or without
                    known.append(order.id)
                elif order.id in changed:
                    kept.append(order.id)
                    known.append(order.id)
                else:
                    conflicts.append(order.id)
            if new_orders and not conflicts and not earlier:
                db.execute(
                    sa.insert(t.orders),
                    [
                        {
                            "id": id_,
                            "content": content,
                            "state": OrderState.OPEN.value,
                            "attempts": 0,
                            "why": "",
                            "taken_us": self._epoch_us(),
                        }
                        for id_, content in new_orders.items()
                    ],
                )
                days.insert_orders_of_current_day(db, list(new_orders))
                first, more = next(iter(new_orders)), len(new_orders) - 1
                subject = f"{first} and {more} more" if more else first
                audit.add_entry(db, self._epoch_us(), by, "take_orders", subject, "taken")
        added = () if conflicts or earlier else tuple(new_orders)
        return IntakeResult(
            added, tuple(known), tuple(conflicts), tuple(kept), tuple(sorted(earlier))
        )

    def orders(self, *states: OrderState) -> list[OrderRow]:
        """Return the day's orders, or those in these states, in order of arrival. Of a past day,
        those that were carried over are open.
        """
        day = self._database.day
        query = sa.select(t.orders).where(days.is_order_of(day)).order_by(t.orders.c.n)
        if states:
            query = query.where(t.orders.c.state.in_([state.value for state in states]))
        if day is None:
            return self._read_orders(query)
        with self._database.read() as db:
            carried = days.carried_over_from(db, day)
        return [
            replace(row, state=OrderState.OPEN, reason="carried over")
            if row.order.id in carried
            else row
            for row in self._read_orders(query)
        ]

    def orders_by_id(self, ids: Collection[str]) -> list[OrderRow]:
        """Return the orders of these ids, in order of arrival, without reading all others."""
        query = sa.select(t.orders).where(t.orders.c.id.in_(ids)).order_by(t.orders.c.n)
        return self._read_orders(query)

    def _read_orders(self, query: "sa.Select[Any]") -> list[OrderRow]:
        with self._database.read() as db:
            found = db.execute(query).all()
        return [
            OrderRow(_decode_order(row.content), OrderState(row.state), row.attempts, row.why)
            for row in found
        ]

    def holds_in_force(self) -> list[Hold]:
        """Return the holds in force, oldest first; none for a past day."""
        if self._database.day is not None:
            return []
        with self._database.read() as db:
            return holds.read_holds_in_force(db)

    # --- assignments and the outbox ------------------------------------------------------------

    def assign_order(
        self,
        order_id: str,
        vehicle: str,
        flight: dict[str, Any],
        obstacles: Any,
        by: str,
        layer: int | None = None,
    ) -> str | None:
        """Assign an open order to a free vehicle and put the command into the outbox.

        Returns the assignment's id; None if the order is not open, the vehicle or its layer is not
        free, or the vehicle is held.
        """
        try:
            with self._database.write() as db:
                rows.lock_dispatch_decisions(db)
                if holds.hold_on(db, vehicle) is not None:
                    return None
                id_ = rows.assign_order(db, order_id)
                if id_ is None:
                    return None
                rows.insert_assignment(db, self._epoch_us(), id_, order_id, vehicle, layer)
                action = Assign(assignment=id_, order=order_id, flight=flight, obstacles=obstacles)
                rows.enqueue_command(
                    db, self._epoch_us(), f"{id_}:assign", vehicle, id_, action, by
                )
        except IntegrityError:  # the vehicle, or its layer, has another assignment in force
            return None
        return id_

    def record_launch_confirmation(self, order_id: str, by: str) -> str | None:
        """Record an operator's confirmation of one launch; returns the assignment's id.

        None if the mission is not on a drone, its launch is in progress, or the drone is held.
        """
        with self._database.write() as db:
            rows.lock_dispatch_decisions(db)
            aboard = sa.select(t.assignments.c.id).where(
                t.assignments.c.order_id == order_id,
                t.assignments.c.state == AssignmentState.UPLOADED.value,
            )
            row = rows.lock_assignment_if_in_states(
                db, db.execute(aboard).scalar() or "", (AssignmentState.UPLOADED,)
            )
            if (
                row is None
                or rows.has_unanswered_command(db, row.id)
                or holds.hold_on(db, row.vehicle)
            ):
                return None
            rows.set_launch_confirmation(db, row.id, by)
            audit.add_entry(
                db, self._epoch_us(), by, "confirm", f"{row.vehicle}: {row.id}", "confirmed"
            )
        return row.id

    def launch(
        self,
        assignment: str,
        by: str,
        *,
        newest_known_launch: int | None = None,
        requires_confirmation: bool = False,
    ) -> bool:
        """Authorise the launch of an uploaded assignment; False if it is not uploaded, was
        authorised before, or its vehicle is held.

        `newest_known_launch`: also False if a launch newer than this number exists, since its gap
        is not over. `requires_confirmation`: also False without an operator confirmation, which
        this launch uses up.
        """
        with self._database.write() as db:
            rows.lock_dispatch_decisions(db)
            row = rows.lock_assignment_if_in_states(db, assignment, (AssignmentState.UPLOADED,))
            if row is None or rows.has_unanswered_command(db, assignment):
                return False
            if holds.hold_on(db, row.vehicle) is not None:
                return False
            if newest_known_launch is not None and rows.newest_launch(db) != newest_known_launch:
                return False
            if requires_confirmation and row.confirmed_by is None:
                return False
            rows.set_launch_confirmation(db, assignment, None)
            number = rows.count_commands_with_id_prefix(db, f"{assignment}:launch") + 1
            action = Launch(assignment=assignment)
            rows.enqueue_command(
                db,
                self._epoch_us(),
                f"{assignment}:launch{number}",
                row.vehicle,
                assignment,
                action,
                by,
            )
        return True

    def record_unanswered_launch_as_executed(self, assignment: str, instance_id: str) -> bool:
        """Record as carried out a launch that a hold kept from being resent: its vehicle is
        airborne. False if there is no such launch.
        """
        with self._database.write() as db:
            rows.lock_dispatch_decisions(db)
            row = rows.lock_assignment_if_in_states(db, assignment, (AssignmentState.UPLOADED,))
            launch = None if row is None else rows.newest_unanswered_launch(db, assignment)
            if row is None or launch is None:
                return False
            if launch.response is None and holds.hold_on(db, row.vehicle) is None:
                return False  # it is sent again, and answered
            rows.record_and_apply_executed_launch(db, self._epoch_us(), launch, instance_id)
            audit.add_entry(
                db, self._epoch_us(), row.vehicle, "answer", launch.id, "done: seen in flight"
            )
        return True

    def revert_launch_to_uploaded(self, assignment: str, reason: str) -> bool:
        """Record that a launch did not happen (the companion restarted before take-off)."""
        with self._database.write() as db:
            row = rows.lock_assignment_if_in_states(db, assignment, (AssignmentState.IN_FLIGHT,))
            if row is None:
                return False
            rows.set_assignment_state(db, assignment, AssignmentState.UPLOADED, reason)
        return True

    def withdraw_assignment(self, assignment: str, by: str) -> bool:
        """Withdraw an assignment before its launch; False if it is too late."""
        states = (AssignmentState.ORDERED, AssignmentState.UPLOADED)
        with self._database.write() as db:
            row = rows.lock_assignment_if_in_states(db, assignment, states)
            if row is None:
                return False
            reason = "withdrawn by the desk"
            day_steps.withdraw_before_launch(db, self._epoch_us(), row, by, reason)
        return True

    def enqueue_command(
        self, command_id: str, vehicle: str, action: CommandAction, by: str
    ) -> bool:
        """Put a command with a random id into the outbox; False if this id exists already."""
        try:
            with self._database.write() as db:
                rows.enqueue_command(
                    db, self._epoch_us(), command_id, vehicle, None, action, by, is_random_id=True
                )
        except IntegrityError:
            return False
        return True

    def outbox(self) -> list[CommandRow]:
        """Return the commands to send: not withheld, without a final response; oldest first."""
        return self._read_commands(_OUTBOX)

    def commands(self) -> list[CommandRow]:
        """Return the day's commands, oldest first."""
        made = days.during(t.commands.c.made_us, self._database.day)
        return self._read_commands(sa.select(t.commands).where(made))

    def cancel_command(self, command_id: str, reason: str) -> bool:
        """Remove a command from the outbox; False if it has a response, or is a sent launch."""
        unanswered = t.commands.c.answer.is_(None), t.commands.c.sent.is_(False)
        with self._database.write() as db:
            done = db.execute(
                sa.update(t.commands)
                .where(t.commands.c.id == command_id, *unanswered)
                .values(answer=CommandStatus.REFUSED.value, reason=reason)
            )
            if done.rowcount == 1:
                audit.add_entry(db, self._epoch_us(), "desk", "give_up", command_id, reason)
        return done.rowcount == 1

    def commands_of_assignment(self, assignment: str) -> list[CommandRow]:
        """Return an assignment's commands, oldest first."""
        return self._read_commands(
            sa.select(t.commands).where(t.commands.c.assignment == assignment)
        )

    def _read_commands(self, query: "sa.Select[Any]") -> list[CommandRow]:
        with self._database.read() as db:
            found = db.execute(query.order_by(t.commands.c.n)).all()
        return [rows.command_from_database_row(row) for row in found]

    def record_send_attempt(self, command_id: str, reason: str) -> None:
        """Record that a command was sent without a final response; it stays in the outbox."""
        with self._database.write(durable=False) as db:
            db.execute(
                sa.update(t.commands).where(t.commands.c.id == command_id).values(reason=reason)
            )

    def record_and_apply_response(
        self, command_id: str, response: CommandStatus, reason: str, instance_id: str
    ) -> bool:
        """Record one final response; False if there was one before."""
        result = Result(
            id=command_id, vehicle="", instance_id=instance_id, status=response, reason=reason
        )
        return bool(self.record_and_apply_responses([result]))

    def record_and_apply_responses(self, results: list[Result]) -> set[str]:
        """Record and apply final responses; returns the ids of commands that had none before.

        A response also counts for a sent launch that was voided afterwards. Not durable at once:
        after a power cut the command is sent again, with the same response.
        """
        with self._database.write(durable=False) as db:
            return {result.id for result in results if self._record_and_apply_response(db, result)}

    def assignments(self, *, in_force: bool = False) -> list[AssignmentRow]:
        """Return the day's assignments, oldest first; with `in_force` those that are not over."""
        if in_force:
            return self._read_assignments(_ASSIGNMENTS_IN_FORCE)
        made = days.during(t.assignments.c.made_us, self._database.day)
        return self._read_assignments(_ASSIGNMENTS.where(made))

    def _read_assignments(self, query: "sa.Select[Any]") -> list[AssignmentRow]:
        with self._database.read() as db:
            return [rows.assignment_from_database_row(row) for row in db.execute(query)]

    # --- events --------------------------------------------------------------------------------

    def record_event_batches(
        self, batches: list[tuple[list[FleetEvent], bool]]
    ) -> list[FleetEvent]:
        """Record and apply batches (events, is_full_replay) in one transaction, each event once;
        returns the new ones. A flood of events waits for the disk only once.

        `is_full_replay`: they are all events that the member still keeps after
        `last_gapless_event_number`, so no available event is missing before the last.
        """
        try:
            return self._record_event_batches_in_transaction(batches)
        except IntegrityError:  # another desk recorded them: now they are known
            return self._record_event_batches_in_transaction(batches)

    def _record_event_batches_in_transaction(
        self, batches: list[tuple[list[FleetEvent], bool]]
    ) -> list[FleetEvent]:
        new: list[FleetEvent] = []
        with self._database.write() as db:
            for events, replayed in batches:
                new += [event for event in events if self._record_and_apply_new_event(db, event)]
                for event in events:
                    self._update_last_gapless_event_number(db, event, replayed)
        return new

    def last_gapless_event_number(self, vehicle: str, log_id: str) -> int:
        """Return the last event number before which no available event is missing; 0: none."""
        with self._database.read() as db:
            return self._read_last_gapless_event_number(db, vehicle, log_id) or 0

    def events(self, kind: EventKind | None = None) -> list[FleetEvent]:
        """Return the day's events, in the order in which they were received."""
        received = days.during(t.events.c.heard_us, self._database.day)
        query = sa.select(t.events.c.content).where(received).order_by(t.events.c.n)
        if kind is not None:
            query = query.where(t.events.c.kind == kind.value)
        with self._database.read() as db:
            found = db.execute(query).scalars().all()
        return [msgspec.json.decode(row, type=FleetEvent) for row in found]

    # --- inside a transaction ------------------------------------------------------------------

    def _record_and_apply_response(self, db: sa.Connection, result: Result) -> bool:
        here = t.commands.c.id == result.id
        row = db.execute(sa.select(t.commands).where(here)).one_or_none()
        done = db.execute(
            sa.update(t.commands)
            .where(here, rows.pending_response_condition())
            .values(
                answer=result.status.value,
                reason=result.reason,
                life=result.instance_id,
                answered_us=self._epoch_us(),
            )
        )
        if row is None or done.rowcount != 1:
            return False
        command, response = rows.command_from_database_row(row), result.status
        rows.apply_response_to_assignment(db, self._epoch_us(), command, response, result.reason)
        result_text = f"{response.value}: {result.reason}" if result.reason else response.value
        audit.add_entry(db, self._epoch_us(), command.vehicle, "answer", result.id, result_text)
        return True

    def _record_and_apply_new_event(self, db: sa.Connection, event: FleetEvent) -> bool:
        existing = db.execute(
            sa.select(sa.func.count()).where(
                t.events.c.vehicle == event.vehicle,
                t.events.c.log == event.log,
                t.events.c.seq == event.seq,
            )
        ).scalar_one()
        if existing:
            return False
        db.execute(
            sa.insert(t.events).values(
                vehicle=event.vehicle,
                log=event.log,
                seq=event.seq,
                kind=event.kind.value,
                assignment=event.assignment,
                content=msgspec.json.encode(event).decode(),
                heard_us=self._epoch_us(),
            )
        )
        if event.kind is EventKind.OUTCOME and event.assignment and event.outcome:
            apply_outcome(db, self._epoch_us(), event)
        if event.kind in DRIVER_EVENTS and event.assignment:
            day_steps.apply_driver_event(db, self._epoch_us(), event)
        return True

    def _update_last_gapless_event_number(
        self, db: sa.Connection, event: FleetEvent, is_full_replay: bool
    ) -> None:
        here = (t.logs.c.vehicle == event.vehicle, t.logs.c.log == event.log)
        seen_to = self._read_last_gapless_event_number(db, event.vehicle, event.log)
        if seen_to is None:
            values = {"vehicle": event.vehicle, "log": event.log, "seen_to": 0}
            db.execute(sa.insert(t.logs).values(values))
        if event.seq == (seen_to or 0) + 1 or (is_full_replay and event.seq > (seen_to or 0)):
            db.execute(sa.update(t.logs).where(*here).values(seen_to=event.seq))

    def _read_last_gapless_event_number(
        self, db: sa.Connection, vehicle: str, log_id: str
    ) -> int | None:
        query = sa.select(t.logs.c.seen_to).where(
            t.logs.c.vehicle == vehicle, t.logs.c.log == log_id
        )
        return db.execute(query.with_for_update()).scalar_one_or_none()
