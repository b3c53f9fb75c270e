"""Orders, assignments, commands and events of the day, in SQLite (WAL) or PostgreSQL.

Each method is one transaction: when it returns, it has happened as a whole and is on the disk, or
not at all. Commands are stored before they are sent (an outbox). A desk that is killed between the
two sends the same command again, and the vehicle carries it out once.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgspec
import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from companion.fleet.messages import (
    Answered,
    Assign,
    Deed,
    EventKind,
    FleetEvent,
    Launch,
    Result,
    Withdraw,
)
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import hold_steps as holds
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
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

DRIVER = (EventKind.PLACED, EventKind.RECOVERED, EventKind.CANNOT)
_IN_FORCE = [state.value for state in IN_FORCE]
_ASSIGNMENTS = sa.select(t.assignments).order_by(t.assignments.c.n)  # built once: used often
_ASSIGNMENTS_IN_FORCE = _ASSIGNMENTS.where(t.assignments.c.state.in_(_IN_FORCE))
_LAUNCHED = _ASSIGNMENTS_IN_FORCE.where(
    sa.or_(
        t.assignments.c.state == AssignmentState.FLYING.value,
        t.assignments.c.id.in_(
            sa.select(t.commands.c.assignment).where(
                t.commands.c.id.contains(":launch"), t.commands.c.answer.is_(None)
            )
        ),
    )
)
_OUTBOX = (
    sa.select(t.commands)
    .where(t.commands.c.answer.is_(None), t.commands.c.held.is_(False))
    .order_by(t.commands.c.n)
)


@lru_cache(maxsize=20_000)
def _decoded(content: str) -> Order:
    """An order's content never changes, and a desk reads all that are open again and again."""
    return msgspec.json.decode(content, type=Order)


@dataclass(frozen=True, slots=True)
class IntakeResult:
    """What became of orders that were handed in. `conflicts`: a known id with other content."""

    added: tuple[str, ...]
    known: tuple[str, ...]
    conflicts: tuple[str, ...]


class Store:
    """The store of one desk. `epoch_us` stamps rows for people; nothing is decided by it."""

    def __init__(self, database: Database, epoch_us: Callable[[], int]) -> None:
        self._database = database
        self._now = epoch_us

    @property
    def database(self) -> Database:
        """The database."""
        return self._database

    def close(self) -> None:
        """Close the connections."""
        self._database.close()

    # --- orders --------------------------------------------------------------------------------

    def add_orders(self, orders: list[Order], by: str = "desk") -> IntakeResult:
        """Take all orders or, where an id comes with other content, none."""
        try:
            return self._add_orders(orders, by)
        except IntegrityError:  # another desk took one of them just now: now it is known
            return self._add_orders(orders, by)

    def _add_orders(self, orders: list[Order], by: str) -> IntakeResult:
        with self._database.write() as db:
            found = db.execute(
                sa.select(t.orders.c.id, t.orders.c.content).where(
                    t.orders.c.id.in_([order.id for order in orders])
                )
            )
            there = {row.id: row.content for row in found}
            fresh: dict[str, str] = {}
            known: list[str] = []
            conflicts: list[str] = []
            for order in orders:
                content = msgspec.json.encode(order).decode()
                before = there.get(order.id, fresh.get(order.id))
                if before is None:
                    fresh[order.id] = content
                elif before == content:
                    known.append(order.id)
                else:
                    conflicts.append(order.id)
            if fresh and not conflicts:
                db.execute(
                    sa.insert(t.orders),
                    [
                        {
                            "id": id_,
                            "content": content,
                            "state": OrderState.OPEN.value,
                            "attempts": 0,
                            "why": "",
                            "taken_us": self._now(),
                        }
                        for id_, content in fresh.items()
                    ],
                )
                first, more = next(iter(fresh)), len(fresh) - 1
                subject = f"{first} and {more} more" if more else first
                audit.note(db, self._now(), by, "take_orders", subject, "taken")
        added = () if conflicts else tuple(fresh)
        return IntakeResult(added, tuple(known), tuple(conflicts))

    def orders(self, *states: OrderState) -> list[OrderRow]:
        """All orders, or those in these states, in the order they came."""
        query = sa.select(t.orders).order_by(t.orders.c.n)
        if states:
            query = query.where(t.orders.c.state.in_([state.value for state in states]))
        return self._orders(query)

    def orders_named(self, ids: Collection[str]) -> list[OrderRow]:
        """The orders of these ids, in the order they came; a day may have thousands of others."""
        query = sa.select(t.orders).where(t.orders.c.id.in_(ids)).order_by(t.orders.c.n)
        return self._orders(query)

    def _orders(self, query: "sa.Select[Any]") -> list[OrderRow]:
        with self._database.read() as db:
            found = db.execute(query).all()
        return [
            OrderRow(_decoded(row.content), OrderState(row.state), row.attempts, row.why)
            for row in found
        ]

    def move_order(
        self, order_id: str, before: tuple[OrderState, ...], after: OrderState, by: str
    ) -> bool:
        """A person's change (cancel, reopen); False where the order is in none of these states."""
        with self._database.write() as db:
            done = db.execute(
                sa.update(t.orders)
                .where(
                    t.orders.c.id == order_id,
                    t.orders.c.state.in_([state.value for state in before]),
                )
                .values(state=after.value, why=f"by {by}", attempts=0)
            )
            if done.rowcount == 1:
                audit.note(db, self._now(), by, "order", order_id, after.value)
        return done.rowcount == 1

    def holds(self) -> list[Hold]:
        """The holds in force, oldest first."""
        with self._database.read() as db:
            return holds.in_force(db)

    # --- assignments and the outbox ------------------------------------------------------------

    def assign(
        self,
        order_id: str,
        vehicle: str,
        flight: dict[str, Any],
        obstacles: Any,
        by: str,
        layer: int | None = None,
    ) -> str | None:
        """Assign an open order to a free vehicle and put the command into the outbox.

        Returns the assignment's id; None where the order is not open, the vehicle or its layer
        not free, or the vehicle held.
        """
        try:
            with self._database.write() as db:
                rows.lock(db)
                if holds.hold_of(db, vehicle) is not None:
                    return None
                id_ = rows.order_taken(db, order_id)
                if id_ is None:
                    return None
                rows.make_assignment(db, self._now(), id_, order_id, vehicle, layer)
                deed = Assign(assignment=id_, order=order_id, flight=flight, obstacles=obstacles)
                rows.put_out(db, self._now(), f"{id_}:assign", vehicle, id_, deed, by)
        except IntegrityError:  # the vehicle, or its layer, has another assignment in force
            return None
        return id_

    def confirm_launch(self, order_id: str, by: str) -> str | None:
        """A person lets an order's drone be launched, once; the assignment's id.

        None: it is not aboard a drone, its launch is under way, or the drone is held.
        """
        with self._database.write() as db:
            rows.lock(db)
            aboard = sa.select(t.assignments.c.id).where(
                t.assignments.c.order_id == order_id,
                t.assignments.c.state == AssignmentState.ABOARD.value,
            )
            row = rows.in_state(db, db.execute(aboard).scalar() or "", (AssignmentState.ABOARD,))
            if row is None or rows.unanswered(db, row.id) or holds.hold_of(db, row.vehicle):
                return None
            rows.confirm(db, row.id, by)
            audit.note(db, self._now(), by, "confirm", f"{row.vehicle}: {row.id}", "confirmed")
        return row.id

    def newest_launch(self) -> int:
        """The number of the newest launch, of whichever desk; 0: there was none."""
        with self._database.read() as db:
            return rows.newest_launch(db)

    def launch(
        self, assignment: str, by: str, *, after: int | None = None, confirmed: bool = False
    ) -> bool:
        """Authorise the launch of an assignment that is aboard; False where it is not, was asked
        before, or its vehicle is held.

        `after`: nor where there is a newer launch than this one, since its gap is not over.
        `confirmed`: nor without a person's word, which this launch uses up.
        """
        with self._database.write() as db:
            rows.lock(db)
            row = rows.in_state(db, assignment, (AssignmentState.ABOARD,))
            if row is None or rows.unanswered(db, assignment):
                return False
            if holds.hold_of(db, row.vehicle) is not None:
                return False
            if after is not None and rows.newest_launch(db) != after:
                return False
            if confirmed and row.confirmed_by is None:
                return False
            rows.confirm(db, assignment, None)
            number = rows.count_commands(db, f"{assignment}:launch") + 1
            deed = Launch(assignment=assignment)
            rows.put_out(
                db, self._now(), f"{assignment}:launch{number}", row.vehicle, assignment, deed, by
            )
        return True

    def refused_launches(self, assignment: str) -> int:
        """How many launches of an assignment its vehicle has refused."""
        refused = sa.select(sa.func.count()).where(
            t.commands.c.id.startswith(f"{assignment}:launch", autoescape=True),
            t.commands.c.answer == Answered.REFUSED.value,
            t.commands.c.life.is_not(None),  # a launch that a hold has stopped was no refusal
        )
        with self._database.read() as db:
            return db.execute(refused).scalar_one()

    def may_send_launch(self, command: CommandRow) -> bool:
        """Whether a launch may leave the desk now, decided under the lock that holds take.

        Once it has left it may be carried out, so a hold that comes later does not make it void.
        """
        with self._database.write() as db:
            rows.lock(db)
            here = t.commands.c.id == command.id
            answer = db.execute(sa.select(t.commands.c.answer).where(here)).scalar_one_or_none()
            if answer is not None or holds.hold_of(db, command.vehicle) is not None:
                return False
            db.execute(sa.update(t.commands).where(here).values(sent=True))
        return True

    def seen_flying(self, assignment: str, life: str) -> bool:
        """Its vehicle flies, and a launch that a hold kept from being sent again is not answered:
        it was carried out. False where there is none.
        """
        with self._database.write() as db:
            rows.lock(db)
            row = rows.in_state(db, assignment, (AssignmentState.ABOARD,))
            launch = None if row is None else rows.launch_on_its_way(db, assignment)
            if row is None or launch is None:
                return False
            if launch.answer is None and holds.hold_of(db, row.vehicle) is None:
                return False  # it is sent again, and answered
            rows.carried_out(db, self._now(), launch, life)
            audit.note(db, self._now(), row.vehicle, "answer", launch.id, "done: seen in flight")
        return True

    def not_flying(self, assignment: str, why: str) -> bool:
        """The launch did not happen (the companion restarted before take-off): aboard again."""
        with self._database.write() as db:
            row = rows.in_state(db, assignment, (AssignmentState.FLYING,))
            if row is None:
                return False
            rows.set_state(db, assignment, AssignmentState.ABOARD, why)
        return True

    def withdraw(self, assignment: str, by: str) -> bool:
        """Withdraw an assignment before its launch; False where it is too late."""
        states = (AssignmentState.ORDERED, AssignmentState.ABOARD)
        with self._database.write() as db:
            row = rows.in_state(db, assignment, states)
            if row is None:
                return False
            rows.set_state(db, assignment, AssignmentState.WITHDRAWING, "withdrawn by the desk")
            deed = Withdraw(assignment=assignment)
            rows.put_out(
                db, self._now(), f"{assignment}:withdraw", row.vehicle, assignment, deed, by
            )
        return True

    def command(self, id_: str, vehicle: str, deed: Deed, by: str) -> bool:
        """Put any other command into the outbox; False where this id is there already."""
        try:
            with self._database.write() as db:
                rows.put_out(db, self._now(), id_, vehicle, None, deed, by)
        except IntegrityError:
            return False
        return True

    def outbox(self) -> list[CommandRow]:
        """Commands to be sent: not held back, without a final answer; oldest first."""
        with self._database.read() as db:
            found = db.execute(_OUTBOX).all()
        return [rows.command_row(row) for row in found]

    def commands(self) -> list[CommandRow]:
        """All commands, oldest first."""
        with self._database.read() as db:
            found = db.execute(sa.select(t.commands).order_by(t.commands.c.n)).all()
        return [rows.command_row(row) for row in found]

    def give_up(self, command_id: str, reason: str) -> bool:
        """Take a command out of the outbox; False where it has been answered."""
        with self._database.write() as db:
            done = db.execute(
                sa.update(t.commands)
                .where(t.commands.c.id == command_id, t.commands.c.answer.is_(None))
                .values(answer=Answered.REFUSED.value, reason=reason)
            )
            if done.rowcount == 1:
                audit.note(db, self._now(), "desk", "give_up", command_id, reason)
        return done.rowcount == 1

    def answers(self, command_ids: list[str]) -> dict[str, Answered | None]:
        """The final answers of these commands; None while there is none."""
        query = sa.select(t.commands.c.id, t.commands.c.answer)
        with self._database.read() as db:
            found = db.execute(query.where(t.commands.c.id.in_(command_ids))).all()
        return {row.id: None if row.answer is None else Answered(row.answer) for row in found}

    def commands_of(self, assignment: str) -> list[CommandRow]:
        """An assignment's commands, oldest first."""
        query = sa.select(t.commands).where(t.commands.c.assignment == assignment)
        with self._database.read() as db:
            found = db.execute(query.order_by(t.commands.c.n)).all()
        return [rows.command_row(row) for row in found]

    def tried(self, command_id: str, reason: str) -> None:
        """A command was sent without a final answer; it stays in the outbox."""
        with self._database.write(settle=False) as db:
            db.execute(
                sa.update(t.commands).where(t.commands.c.id == command_id).values(reason=reason)
            )

    def answered(self, command_id: str, answer: Answered, reason: str, life: str) -> bool:
        """Note one final answer; False where it was answered before."""
        result = Result(id=command_id, vehicle="", life=life, answer=answer, reason=reason)
        return bool(self.take_answers([result]))

    def take_answers(self, results: list[Result]) -> set[str]:
        """Note final answers and what follows from them; the ids of commands that had none before.

        A launch that left the desk and was then made void there is answered by its vehicle still.
        It does not wait for the disk: after a power cut the command is sent again, and answered
        the same.
        """
        with self._database.write(settle=False) as db:
            return {result.id for result in results if self._take_answer(db, result)}

    def assignments(self, *, in_force: bool = False) -> list[AssignmentRow]:
        """All assignments, oldest first; with `in_force` only those that are not over."""
        query = _ASSIGNMENTS_IN_FORCE if in_force else _ASSIGNMENTS
        with self._database.read() as db:
            found = db.execute(query).all()
        return [rows.assignment_row(row) for row in found]

    def launched(self) -> list[AssignmentRow]:
        """Return the assignments that fly, or whose launch is ordered and not answered."""
        with self._database.read() as db:
            found = db.execute(_LAUNCHED).all()
        return [rows.assignment_row(row) for row in found]

    # --- events --------------------------------------------------------------------------------

    def take_events(self, events: list[FleetEvent], *, replayed: bool = False) -> list[FleetEvent]:
        """Note events and what follows from them, each once; returns those that are new.

        `replayed`: they are all that the member still has after `seen_to`, so none that can
        still be had is missing before the last.
        """
        return self.take_event_batches([(events, replayed)])

    def take_event_batches(self, batches: list[tuple[list[FleetEvent], bool]]) -> list[FleetEvent]:
        """The same for all that one turn has brought, (events, replayed) each, in one
        transaction: who floods the desk with events costs one wait for the disk, as all do.
        """
        try:
            return self._take_all(batches)
        except IntegrityError:  # another desk took them just now: now they are known
            return self._take_all(batches)

    def _take_all(self, batches: list[tuple[list[FleetEvent], bool]]) -> list[FleetEvent]:
        new: list[FleetEvent] = []
        with self._database.write() as db:
            for events, replayed in batches:
                new += [event for event in events if self._take(db, event)]
                for event in events:
                    self._see(db, event, replayed)
        return new

    def seen_to(self, vehicle: str, log: str) -> int:
        """The event of this log up to which none is missing that can be had; 0: none."""
        with self._database.read() as db:
            return self._seen_to(db, vehicle, log) or 0

    def events(self, kind: EventKind | None = None) -> list[FleetEvent]:
        """All events, in the order in which they were received."""
        query = sa.select(t.events.c.content).order_by(t.events.c.n)
        if kind is not None:
            query = query.where(t.events.c.kind == kind.value)
        with self._database.read() as db:
            found = db.execute(query).scalars().all()
        return [msgspec.json.decode(row, type=FleetEvent) for row in found]

    # --- inside a transaction ------------------------------------------------------------------

    def _take_answer(self, db: sa.Connection, result: Result) -> bool:
        here = t.commands.c.id == result.id
        row = db.execute(sa.select(t.commands).where(here)).one_or_none()
        done = db.execute(
            sa.update(t.commands)
            .where(here, rows.awaits_its_vehicle())
            .values(
                answer=result.answer.value,
                reason=result.reason,
                life=result.life,
                answered_us=self._now(),
            )
        )
        if row is None or done.rowcount != 1:
            return False
        command, answer = rows.command_row(row), result.answer
        rows.follow(db, self._now(), command, answer, result.reason)
        said = f"{answer.value}: {result.reason}" if result.reason else answer.value
        audit.note(db, self._now(), command.vehicle, "answer", result.id, said)
        return True

    def _take(self, db: sa.Connection, event: FleetEvent) -> bool:
        there = db.execute(
            sa.select(sa.func.count()).where(
                t.events.c.vehicle == event.vehicle,
                t.events.c.log == event.log,
                t.events.c.seq == event.seq,
            )
        ).scalar_one()
        if there:
            return False
        db.execute(
            sa.insert(t.events).values(
                vehicle=event.vehicle,
                log=event.log,
                seq=event.seq,
                kind=event.kind.value,
                assignment=event.assignment,
                content=msgspec.json.encode(event).decode(),
                heard_us=self._now(),
            )
        )
        if event.kind is EventKind.OUTCOME and event.assignment and event.outcome:
            rows.conclude(db, self._now(), event)
        if event.kind in DRIVER and event.assignment:
            rows.driver_said(db, self._now(), event)
        return True

    def _see(self, db: sa.Connection, event: FleetEvent, replayed: bool) -> None:
        here = (t.logs.c.vehicle == event.vehicle, t.logs.c.log == event.log)
        seen_to = self._seen_to(db, event.vehicle, event.log)
        if seen_to is None:
            values = {"vehicle": event.vehicle, "log": event.log, "seen_to": 0}
            db.execute(sa.insert(t.logs).values(values))
        if event.seq == (seen_to or 0) + 1 or (replayed and event.seq > (seen_to or 0)):
            db.execute(sa.update(t.logs).where(*here).values(seen_to=event.seq))

    def _seen_to(self, db: sa.Connection, vehicle: str, log: str) -> int | None:
        query = sa.select(t.logs.c.seen_to).where(t.logs.c.vehicle == vehicle, t.logs.c.log == log)
        return db.execute(query.with_for_update()).scalar_one_or_none()
