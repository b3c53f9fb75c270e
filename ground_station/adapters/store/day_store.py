"""Persistent state of a day with a truck: active plan, promised stops, truck commands, visits.

Each method is one transaction, as in `order_store`. The transaction that orders the truck to drive
also checks that the truck may leave its stop.
"""

from collections.abc import Callable
from typing import Any

import msgspec
import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from companion.core.base.location import Location
from companion.fleet.messages import (
    Assign,
    CommandAction,
    CommandStatus,
    Drive,
    MoveHome,
    PutOut,
    Recover,
    Serve,
    Withdraw,
)
from ground_station.adapters.store import day_steps as steps
from ground_station.adapters.store import hold_steps as holds
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.shift import days
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.orders import AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow, StopTimes


class DayStore:
    """Store of one desk for a day with a truck."""

    def __init__(self, database: Database, epoch_us: Callable[[], int]) -> None:
        self._database = database
        self._epoch_us = epoch_us

    # --- the plan ------------------------------------------------------------------------------

    def active_plan(self) -> DayPlan | None:
        """Return the active plan: the plan of the highest revision."""
        plans, here = days.plans_of(self._database.day)
        query = sa.select(plans.c.content).where(here).order_by(plans.c.revision.desc()).limit(1)
        with self._database.read() as db:
            found = db.execute(query).scalar_one_or_none()
        return None if found is None else msgspec.json.decode(found, type=DayPlan)

    def active_plan_stored_at_us(self) -> int:
        """Return when the active plan was stored; 0 without a plan."""
        with self._database.read() as db:
            return db.execute(sa.select(sa.func.max(t.plans.c.made_us))).scalar() or 0

    def plans_with_reasons(self) -> list[tuple[DayPlan, str]]:
        """Return all plans of the day, each with its reason."""
        plans, here = days.plans_of(self._database.day)
        query = sa.select(plans.c.content, plans.c.why).where(here).order_by(plans.c.revision)
        with self._database.read() as db:
            found = db.execute(query).all()
        return [(msgspec.json.decode(row.content, type=DayPlan), row.why) for row in found]

    def try_store_active_plan(
        self, plan: DayPlan, reason: str, measured_wind: Forecast | None = None
    ) -> bool:
        """Make a plan the active one. False if this revision exists already, or if another desk has
        promised a stop in the meantime that this plan does not contain.
        """
        try:
            with self._database.write() as db:
                rows.lock_dispatch_decisions(db)
                if not steps.ordered_and_promised_landing_stops(db) <= {
                    stop.id for stop in plan.stops
                }:
                    return False
                db.execute(
                    sa.insert(t.plans).values(
                        revision=plan.revision,
                        content=msgspec.json.encode(plan).decode(),
                        why=reason,
                        wind=None
                        if measured_wind is None
                        else msgspec.json.encode(measured_wind).decode(),
                        made_us=self._epoch_us(),
                    )
                )
        except IntegrityError:
            return False
        return True

    def measured_wind_of_last_plan(self) -> Forecast | None:
        """Return the measured wind of the last plan; None if it used the day's forecast."""
        query = sa.select(t.plans.c.wind).where(t.plans.c.wind.is_not(None))
        with self._database.read() as db:
            found = db.execute(query.order_by(t.plans.c.revision.desc()).limit(1)).scalar()
        return None if found is None else msgspec.json.decode(found, type=Forecast)

    def day_start_us(self) -> int | None:
        """Return the start of the day, by the desk's clock."""
        return self._database.about_value(days.day_start_key(self._database.day), int)

    def start_day_once(self) -> int:
        """Start the day unless it has started; returns the start time."""
        try:
            with self._database.write() as db:
                db.execute(
                    sa.insert(t.about).values(name=days.DAY_START_KEY, value=str(self._epoch_us()))
                )
        except IntegrityError:
            pass
        start_us = self.day_start_us()
        assert start_us is not None
        return start_us

    def newest_time_stamp_us(self) -> int | None:
        """Return the newest time stamp of the day, which the day's time must not precede."""
        stamps = (
            t.visits.c.arrived_us, t.visits.c.left_us, t.sorties.c.launched_us,
            t.sorties.c.landed_us, t.plans.c.made_us, t.days.c.began_us,
        )  # fmt: skip
        with self._database.read() as db:
            found = [db.execute(sa.select(sa.func.max(stamp))).scalar() for stamp in stamps]
        return max((stamp for stamp in found if stamp is not None), default=None)

    # --- flights -------------------------------------------------------------------------------

    def assign(
        self,
        sortie: PlannedSortie,
        pads: dict[str, Location],
        flight_table_for_assignment: Callable[[str], dict[str, Any]],
        obstacles: Any,
        by: str,
    ) -> str | None:
        """Promise a sortie its landing stop, order the driver to put its drone out, and withhold
        its mission until that is done.

        `flight_table_for_assignment(assignment)` builds the `flight/1` table. None if the order is
        not open, the drone is not free or is held, or the truck is not at the launch stop.
        """
        try:
            with self._database.write() as db:
                rows.lock_dispatch_decisions(db)
                last = steps.last_ordered_truck_stop(db)
                if last is not None and last != sortie.launch:
                    return None
                if holds.hold_on(db, sortie.vehicle) is not None:
                    return None
                id_ = rows.assign_order(db, sortie.order)
                if id_ is None:
                    return None
                unconfirmed_mission = steps.mission_with_unconfirmed_withdrawal(db, sortie.vehicle)
                rows.insert_assignment(db, self._epoch_us(), id_, sortie.order, sortie.vehicle)
                self._insert_sortie(db, id_, sortie, pads)
                self._enqueue_put_out_and_withheld_mission(
                    db, id_, sortie, pads, flight_table_for_assignment(id_), obstacles, by
                )
                if unconfirmed_mission is not None:
                    action = Withdraw(assignment=unconfirmed_mission)
                    self._enqueue_command(db, f"{id_}:forget", sortie.vehicle, id_, action, by)
        except IntegrityError:  # the drone has another assignment in force
            return None
        return id_

    def _insert_sortie(
        self,
        db: sa.Connection,
        assignment_id: str,
        sortie: PlannedSortie,
        pads: dict[str, Location],
    ) -> None:
        db.execute(
            sa.insert(t.sorties).values(
                assignment=assignment_id,
                content=msgspec.json.encode(sortie).decode(),
                pads=msgspec.json.encode(pads).decode(),
                promised=sortie.home,
            )
        )

    def _enqueue_put_out_and_withheld_mission(
        self,
        db: sa.Connection,
        assignment_id: str,
        sortie: PlannedSortie,
        pads: dict[str, Location],
        flight: dict[str, Any],
        obstacles: Any,
        by: str,
    ) -> None:
        pad = pads[sortie.launch]
        out = PutOut(
            assignment=assignment_id,
            order=sortie.order,
            vehicle=sortie.vehicle,
            lat_deg=pad.lat_deg or 0.0,
            lon_deg=pad.lon_deg or 0.0,
        )
        self._enqueue_command(db, f"{assignment_id}:put_out", TRUCK, assignment_id, out, by)
        action = Assign(
            assignment=assignment_id, order=sortie.order, flight=flight, obstacles=obstacles
        )
        self._enqueue_command(
            db, f"{assignment_id}:assign", sortie.vehicle, assignment_id, action, by, withheld=True
        )

    def release_mission(self, assignment: str) -> bool:
        """Send the mission: the drone is on its pad. False if it was sent before or is void."""
        with self._database.write() as db:
            done = db.execute(
                sa.update(t.commands)
                .where(
                    t.commands.c.id == f"{assignment}:assign",
                    t.commands.c.held.is_(True),
                    t.commands.c.answer.is_(None),
                )
                .values(held=False)
            )
        return done.rowcount == 1

    def withdraw(self, assignment: str, by: str, reason: str) -> bool:
        """Withdraw a sortie before its launch; False if it is too late."""
        states = (AssignmentState.ORDERED, AssignmentState.UPLOADED)
        with self._database.write() as db:
            row = rows.lock_assignment_if_in_states(db, assignment, states)
            if row is None or steps.is_launch_unanswered(db, assignment):
                return False
            steps.withdraw_before_launch(db, self._epoch_us(), row, by, reason)
        return True

    def order_recovery(self, assignment: str, landing_pad: Location, by: str) -> bool:
        """Order the driver to load a drone; False if that was ordered before."""
        with self._database.write() as db:
            row = db.execute(
                sa.select(t.assignments.c.vehicle).where(t.assignments.c.id == assignment)
            ).one()
            action = Recover(
                assignment=assignment,
                vehicle=row.vehicle,
                parcel=steps.order_with_unlocated_parcel(db, assignment),
                lat_deg=landing_pad.lat_deg or 0.0,
                lon_deg=landing_pad.lon_deg or 0.0,
            )
            if rows.count_commands_with_id_prefix(db, f"{assignment}:recover"):
                return False
            self._enqueue_command(db, f"{assignment}:recover", TRUCK, None, action, by)
        return True

    def request_home(self, assignment: str, stop: str, by: str) -> bool:
        """Request that a flight land at another stop; both stops bind the truck until the flight
        has responded.
        """
        here = t.sorties.c.assignment == assignment
        with self._database.write() as db:
            rows.lock_dispatch_decisions(db)
            row = rows.lock_assignment_if_in_states(db, assignment, (AssignmentState.IN_FLIGHT,))
            sortie = db.execute(sa.select(t.sorties).where(here).with_for_update()).one_or_none()
            last = steps.last_ordered_truck_stop(db)
            if row is None or sortie is None or sortie.asked or (last and last != stop):
                return False
            number = rows.count_commands_with_id_prefix(db, f"{assignment}:home") + 1
            action = MoveHome(assignment=assignment, home=stop)
            self._enqueue_command(
                db, f"{assignment}:home{number}", row.vehicle, assignment, action, by
            )
            db.execute(sa.update(t.sorties).where(here).values(asked=stop))
        return True

    def confirm_home(self, assignment: str, stop: str) -> bool:
        """Record that the flight has confirmed its new landing stop: the old promise is void."""
        with self._database.write() as db:
            done = db.execute(
                sa.update(t.sorties)
                .where(t.sorties.c.assignment == assignment, t.sorties.c.asked == stop)
                .values(promised=stop, asked=None)
            )
        return done.rowcount == 1

    def cancel_home_request(self, assignment: str, stop: str) -> bool:
        """Cancel a requested landing stop: the flight has ended elsewhere."""
        here = (t.sorties.c.assignment == assignment, t.sorties.c.asked == stop)
        with self._database.write() as db:
            done = db.execute(sa.update(t.sorties).where(*here).values(asked=None))
        return done.rowcount == 1

    def update_sortie_columns(self, assignment: str, **column_values: bool) -> None:
        """Update a sortie. `away`: the truck does not wait for it."""
        with self._database.write() as db:
            here = t.sorties.c.assignment == assignment
            db.execute(sa.update(t.sorties).where(here).values(**column_values))

    def mark_sortie_lapsed_and_void_commands(self, assignment: str) -> None:
        """Mark a sortie as lapsed: the truck does not wait for it, and its unanswered commands are
        void. It is not launched from a stop that the truck has left.
        """
        void = {"answer": CommandStatus.REFUSED.value, "reason": "overdue"}
        unanswered = t.commands.c.assignment == assignment, t.commands.c.answer.is_(None)
        with self._database.write() as db:
            here = t.sorties.c.assignment == assignment
            db.execute(sa.update(t.sorties).where(here).values(lapsed=True))
            db.execute(sa.update(t.commands).where(*unanswered).values(**void))

    def sorties(self) -> list[SortieRow]:
        """Return the day's sorties from the truck, in the order of their assignment."""
        of_day = days.during(t.assignments.c.made_us, self._database.day)
        columns = [t.commands.c[one] for one in ("answer", "life", "answered_us", "sent")]
        drive_commands = sa.select(t.commands.c.id, *columns).where(
            sa.or_(*(t.commands.c.id.like(f"%:{word}") for word in ("launch%", "home%", "recover")))
        )
        with self._database.read() as db:
            found = db.execute(steps.SORTIES.where(of_day)).all()
            responses = db.execute(drive_commands).all()
        return [steps.sortie_from_database_row(row, responses) for row in found]

    # --- the truck -----------------------------------------------------------------------------

    def order_delivery(self, order_id: str, by: str) -> str | None:
        """Order the driver to deliver an open order; None if it is not open."""
        with self._database.write() as db:
            id_ = None if holds.hold_after_restore(db) else rows.assign_order(db, order_id)
            if id_ is None:
                return None
            rows.insert_assignment(db, self._epoch_us(), id_, order_id, TRUCK)
            action = Serve(assignment=id_, order=order_id)
            self._enqueue_command(db, f"{id_}:serve", TRUCK, id_, action, by)
        return id_

    def order_drive(self, current_stop: str, next_stop: PlannedStop, by: str) -> bool:
        """Order the truck from `current_stop` to its next stop.

        False if a sortie or delivery binds it to `current_stop`, or it has an earlier drive order.
        """
        with self._database.write() as db:
            rows.lock_dispatch_decisions(db)
            last = (steps.read_drive_commands_not_refused(db) or [None])[-1]
            if last is not None and (last[1] is None or last[0].stop != current_stop):
                return False
            if holds.hold_after_restore(db):
                return False
            if any(
                row.binding_reason(current_stop) for row in steps.read_sorties_without_responses(db)
            ) or steps.has_truck_delivery_in_force(db):
                return False
            action = Drive(
                stop=next_stop.id,
                lat_deg=next_stop.location.lat_deg or 0.0,
                lon_deg=next_stop.location.lon_deg or 0.0,
            )
            number = rows.count_commands_with_id_prefix(db, "drive-") + 1
            self._enqueue_command(db, f"drive-{number}", TRUCK, None, action, by)
        return True

    def last_ordered_truck_stop(self) -> str | None:
        """Return the stop that the truck was last ordered to, None before the first order."""
        with self._database.read() as db:
            return steps.last_ordered_truck_stop(db)

    def record_truck_stop(self, stop: str | None) -> None:
        """Record that the truck is at this stop and has left all others; None: it drives."""
        with self._database.write() as db:
            visits = t.visits
            existing = db.execute(sa.select(visits).where(visits.c.stop == stop)).one_or_none()
            if stop is not None and existing is None:
                db.execute(sa.insert(visits).values(stop=stop, arrived_us=self._epoch_us()))
            others = (visits.c.left_us.is_(None), visits.c.stop != (stop or ""))
            db.execute(sa.update(visits).where(*others).values(left_us=self._epoch_us()))

    def truck_stop_visits(self) -> list[StopTimes]:
        """Return the truck's visits to stops, in order."""
        visits, here = days.visits_of(self._database.day)
        with self._database.read() as db:
            found = db.execute(sa.select(visits).where(here).order_by(visits.c.arrived_us)).all()
        return [StopTimes(row.stop, row.arrived_us, row.left_us) for row in found]

    # --- inside a transaction ------------------------------------------------------------------

    def _enqueue_command(
        self,
        db: sa.Connection,
        command_id: str,
        vehicle: str,
        assignment: str | None,
        action: CommandAction,
        by: str,
        *,
        withheld: bool = False,
    ) -> None:
        rows.enqueue_command(
            db, self._epoch_us(), command_id, vehicle, assignment, action, by, withheld=withheld
        )
