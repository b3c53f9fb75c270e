"""What binds a day with a truck: the active plan, promises, the truck's orders, its visits.

Each method is one transaction, as in `order_store`. Whether the truck may leave a stop is checked
in the same transaction that orders it to drive.
"""

from collections.abc import Callable
from typing import Any

import msgspec
import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from companion.core.base.place import Place
from companion.fleet.messages import (
    Answered,
    Assign,
    Deed,
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
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.orders import AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow, Visit

BEGAN = "day_began_us"


class DayStore:
    """The store of one desk for a day with a truck."""

    def __init__(self, database: Database, epoch_us: Callable[[], int]) -> None:
        self._database = database
        self._now = epoch_us

    # --- the plan ------------------------------------------------------------------------------

    def plan(self) -> DayPlan | None:
        """The active plan: that of the highest revision."""
        query = sa.select(t.plans.c.content).order_by(t.plans.c.revision.desc()).limit(1)
        with self._database.read() as db:
            found = db.execute(query).scalar_one_or_none()
        return None if found is None else msgspec.json.decode(found, type=DayPlan)

    def plan_made_us(self) -> int:
        """When the active plan was taken; 0: there is none."""
        with self._database.read() as db:
            return db.execute(sa.select(sa.func.max(t.plans.c.made_us))).scalar() or 0

    def plans(self) -> list[tuple[DayPlan, str]]:
        """All plans of the day, and why each was made."""
        query = sa.select(t.plans.c.content, t.plans.c.why).order_by(t.plans.c.revision)
        with self._database.read() as db:
            found = db.execute(query).all()
        return [(msgspec.json.decode(row.content, type=DayPlan), row.why) for row in found]

    def take_plan(self, plan: DayPlan, why: str, wind: Forecast | None = None) -> bool:
        """Make a plan the active one; False where there is one of this revision, or where another
        desk has promised a stop meanwhile that this plan does not have.
        """
        try:
            with self._database.write() as db:
                rows.lock(db)
                if not steps.promised_stops(db) <= {stop.id for stop in plan.stops}:
                    return False
                db.execute(
                    sa.insert(t.plans).values(
                        revision=plan.revision,
                        content=msgspec.json.encode(plan).decode(),
                        why=why,
                        wind=None if wind is None else msgspec.json.encode(wind).decode(),
                        made_us=self._now(),
                    )
                )
        except IntegrityError:
            return False
        return True

    def wind(self) -> Forecast | None:
        """The measured wind of the last plan; None: that was made with the day's forecast."""
        query = sa.select(t.plans.c.wind).where(t.plans.c.wind.is_not(None))
        with self._database.read() as db:
            found = db.execute(query.order_by(t.plans.c.revision.desc()).limit(1)).scalar()
        return None if found is None else msgspec.json.decode(found, type=Forecast)

    def began_us(self) -> int | None:
        """When the day began, by the desk's clock."""
        query = sa.select(t.about.c.value).where(t.about.c.name == BEGAN)
        with self._database.read() as db:
            found = db.execute(query).scalar_one_or_none()
        return None if found is None else int(found)

    def begin(self) -> int:
        """Begin the day, where it has not; returns when it began."""
        try:
            with self._database.write() as db:
                db.execute(sa.insert(t.about).values(name=BEGAN, value=str(self._now())))
        except IntegrityError:
            pass
        began = self.began_us()
        assert began is not None
        return began

    def newest_us(self) -> int | None:
        """The newest time stamp of the day; the day's time must not go back behind it."""
        stamps = (
            t.visits.c.arrived_us, t.visits.c.left_us, t.sorties.c.launched_us,
            t.sorties.c.landed_us, t.plans.c.made_us,
        )  # fmt: skip
        with self._database.read() as db:
            found = [db.execute(sa.select(sa.func.max(stamp))).scalar() for stamp in stamps]
        return max((stamp for stamp in found if stamp is not None), default=None)

    # --- flights -------------------------------------------------------------------------------

    def assign(
        self,
        sortie: PlannedSortie,
        pads: dict[str, Place],
        flight_of: Callable[[str], dict[str, Any]],
        obstacles: Any,
        by: str,
    ) -> str | None:
        """Promise a sortie its home, have its drone put out, and hold back its mission until
        that is done.

        `flight_of(assignment)` makes the `flight/1` table. None: the order is not open, the
        drone not free or held, or the truck not at the launch stop.
        """
        try:
            with self._database.write() as db:
                rows.lock(db)
                last = steps.last_drive(db)
                if last is not None and last != sortie.launch:
                    return None
                if holds.hold_of(db, sortie.vehicle) is not None:
                    return None
                id_ = rows.order_taken(db, sortie.order)
                if id_ is None:
                    return None
                holds_still = steps.may_still_hold(db, sortie.vehicle)
                rows.make_assignment(db, self._now(), id_, sortie.order, sortie.vehicle)
                self._note_sortie(db, id_, sortie, pads)
                self._put_sortie_out(db, id_, sortie, pads, flight_of(id_), obstacles, by)
                if holds_still is not None:
                    deed = Withdraw(assignment=holds_still)
                    self._put_out(db, f"{id_}:forget", sortie.vehicle, id_, deed, by)
        except IntegrityError:  # the drone has another assignment in force
            return None
        return id_

    def _note_sortie(
        self, db: sa.Connection, id_: str, sortie: PlannedSortie, pads: dict[str, Place]
    ) -> None:
        db.execute(
            sa.insert(t.sorties).values(
                assignment=id_,
                content=msgspec.json.encode(sortie).decode(),
                pads=msgspec.json.encode(pads).decode(),
                promised=sortie.home,
            )
        )

    def _put_sortie_out(
        self,
        db: sa.Connection,
        id_: str,
        sortie: PlannedSortie,
        pads: dict[str, Place],
        flight: dict[str, Any],
        obstacles: Any,
        by: str,
    ) -> None:
        pad = pads[sortie.launch]
        out = PutOut(
            assignment=id_,
            order=sortie.order,
            vehicle=sortie.vehicle,
            lat_deg=pad.lat_deg or 0.0,
            lon_deg=pad.lon_deg or 0.0,
        )
        self._put_out(db, f"{id_}:put_out", TRUCK, id_, out, by)
        deed = Assign(assignment=id_, order=sortie.order, flight=flight, obstacles=obstacles)
        self._put_out(db, f"{id_}:assign", sortie.vehicle, id_, deed, by, held=True)

    def release(self, assignment: str) -> bool:
        """The drone is on its pad: send the mission. False where it was sent, or is void."""
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

    def withdraw(self, assignment: str, by: str, why: str) -> bool:
        """Withdraw a sortie before its launch; False where it is too late."""
        states = (AssignmentState.ORDERED, AssignmentState.ABOARD)
        with self._database.write() as db:
            row = rows.in_state(db, assignment, states)
            if row is None or steps.launching(db, assignment):
                return False
            if steps.held(db, assignment):  # its companion knows nothing of it
                state = AssignmentState.WITHDRAWN
                rows.end_assignment(db, self._now(), row, state, False, why)
            else:
                rows.set_state(db, assignment, AssignmentState.WITHDRAWING, why)
                deed = Withdraw(assignment=assignment)
                self._put_out(db, f"{assignment}:withdraw", row.vehicle, assignment, deed, by)
            self._put_out(
                db, f"{assignment}:unput", TRUCK, None, Withdraw(assignment=assignment), by
            )
        return True

    def recover(self, assignment: str, pad: Place, by: str) -> bool:
        """Have the driver take a drone aboard; False where that was ordered before."""
        with self._database.write() as db:
            row = db.execute(
                sa.select(t.assignments.c.vehicle).where(t.assignments.c.id == assignment)
            ).one()
            deed = Recover(
                assignment=assignment,
                vehicle=row.vehicle,
                parcel=rows.parcel_missed(db, assignment),
                lat_deg=pad.lat_deg or 0.0,
                lon_deg=pad.lon_deg or 0.0,
            )
            there = sa.select(t.commands.c.n).where(t.commands.c.id == f"{assignment}:recover")
            if db.execute(there).one_or_none() is not None:
                return False
            self._put_out(db, f"{assignment}:recover", TRUCK, None, deed, by)
        return True

    def ask_home(self, assignment: str, stop: str, by: str) -> bool:
        """Ask a flight to land at another stop; both bind the truck until the flight has
        answered.
        """
        here = t.sorties.c.assignment == assignment
        with self._database.write() as db:
            rows.lock(db)
            row = rows.in_state(db, assignment, (AssignmentState.FLYING,))
            sortie = db.execute(sa.select(t.sorties).where(here).with_for_update()).one_or_none()
            last = steps.last_drive(db)
            if row is None or sortie is None or sortie.asked or (last and last != stop):
                return False
            number = rows.count_commands(db, f"{assignment}:home") + 1
            deed = MoveHome(assignment=assignment, home=stop)
            self._put_out(db, f"{assignment}:home{number}", row.vehicle, assignment, deed, by)
            db.execute(sa.update(t.sorties).where(here).values(asked=stop))
        return True

    def home_is(self, assignment: str, stop: str) -> bool:
        """The flight has confirmed its new home: the old promise is void."""
        with self._database.write() as db:
            done = db.execute(
                sa.update(t.sorties)
                .where(t.sorties.c.assignment == assignment, t.sorties.c.asked == stop)
                .values(promised=stop, asked=None)
            )
        return done.rowcount == 1

    def forget_home(self, assignment: str, stop: str) -> bool:
        """The flight is over elsewhere: that it was asked to end there binds nobody any more."""
        here = (t.sorties.c.assignment == assignment, t.sorties.c.asked == stop)
        with self._database.write() as db:
            done = db.execute(sa.update(t.sorties).where(*here).values(asked=None))
        return done.rowcount == 1

    def note(self, assignment: str, **facts: bool | float) -> None:
        """`away`: nothing waits for it any more. `used_wh`: energy that it used."""
        with self._database.write() as db:
            here = t.sorties.c.assignment == assignment
            db.execute(sa.update(t.sorties).where(here).values(**facts))

    def overdue(self, assignment: str) -> None:
        """Nothing waits for it any more, and what was ordered and not answered is void: it is not
        launched from where the truck has left.
        """
        void = {"answer": Answered.REFUSED.value, "reason": "overdue"}
        unanswered = t.commands.c.assignment == assignment, t.commands.c.answer.is_(None)
        with self._database.write() as db:
            here = t.sorties.c.assignment == assignment
            db.execute(sa.update(t.sorties).where(here).values(lapsed=True))
            db.execute(sa.update(t.commands).where(*unanswered).values(**void))

    def sorties(self) -> list[SortieRow]:
        """All sorties from the truck, in the order of their assignment."""
        query = (
            sa.select(t.assignments, t.sorties)
            .join(t.sorties, t.sorties.c.assignment == t.assignments.c.id)
            .order_by(t.assignments.c.n)
        )
        columns = (t.commands.c.answer, t.commands.c.life, t.commands.c.answered_us)
        told = sa.select(t.commands.c.id, *columns).where(
            sa.or_(*(t.commands.c.id.like(f"%:{word}") for word in ("launch%", "home%", "recover")))
        )
        with self._database.read() as db:
            found = db.execute(query).all()
            answers = db.execute(told).all()
        return [steps.sortie_row(row, answers) for row in found]

    # --- the truck -----------------------------------------------------------------------------

    def serve(self, order_id: str, by: str) -> str | None:
        """Have the driver bring an open order; None where it is not open."""
        with self._database.write() as db:
            id_ = rows.order_taken(db, order_id)
            if id_ is None:
                return None
            rows.make_assignment(db, self._now(), id_, order_id, TRUCK)
            deed = Serve(assignment=id_, order=order_id)
            self._put_out(db, f"{id_}:serve", TRUCK, id_, deed, by)
        return id_

    def drive(self, here: str, stop: PlannedStop, by: str) -> bool:
        """Order the truck from `here` to its next stop.

        False where something binds it to `here`, or it was ordered to drive before.
        """
        with self._database.write() as db:
            rows.lock(db)
            told = steps.drives(db)
            if told and (told[-1][1] is None or told[-1][0].stop != here):
                return False
            if any(row.binds(here) for row in steps.bound(db)) or steps.serving(db):
                return False
            deed = Drive(
                stop=stop.id,
                lat_deg=stop.place.lat_deg or 0.0,
                lon_deg=stop.place.lon_deg or 0.0,
            )
            number = rows.count_commands(db, "drive-") + 1
            self._put_out(db, f"drive-{number}", TRUCK, None, deed, by)
        return True

    def told(self) -> str | None:
        """The stop that the truck was last told to drive to; None: it never was."""
        with self._database.read() as db:
            return steps.last_drive(db)

    def truck_is(self, stop: str | None) -> None:
        """The truck stands at this stop, and has left all others; None: it drives."""
        with self._database.write() as db:
            visits = t.visits
            there = db.execute(sa.select(visits).where(visits.c.stop == stop)).one_or_none()
            if stop is not None and there is None:
                db.execute(sa.insert(visits).values(stop=stop, arrived_us=self._now()))
            others = (visits.c.left_us.is_(None), visits.c.stop != (stop or ""))
            db.execute(sa.update(visits).where(*others).values(left_us=self._now()))

    def visits(self) -> list[Visit]:
        """The truck's visits to stops, in order."""
        with self._database.read() as db:
            found = db.execute(sa.select(t.visits).order_by(t.visits.c.arrived_us)).all()
        return [Visit(row.stop, row.arrived_us, row.left_us) for row in found]

    # --- inside a transaction ------------------------------------------------------------------

    def _put_out(
        self,
        db: sa.Connection,
        id_: str,
        vehicle: str,
        assignment: str | None,
        deed: Deed,
        by: str,
        *,
        held: bool = False,
    ) -> None:
        rows.put_out(db, self._now(), id_, vehicle, assignment, deed, by, held=held)
