"""Steps of the transactions of a day with a truck; each gets the transaction that it is part of."""

from typing import Any

import msgspec
import sqlalchemy as sa

from companion.core.base.place import Place
from companion.fleet.messages import Answered, Deed, Drive
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.sortie_rows import SortieRow


def drives(db: sa.Connection) -> list[tuple[Drive, Answered | None]]:
    """The truck's drive commands that it has not refused, oldest first."""
    query = sa.select(t.commands.c.deed, t.commands.c.answer).where(t.commands.c.id.like("drive-%"))
    found: list[tuple[Drive, Answered | None]] = []
    for row in db.execute(query.order_by(t.commands.c.n)):
        deed = msgspec.json.decode(row.deed, type=Deed)
        answer = None if row.answer is None else Answered(row.answer)
        if isinstance(deed, Drive) and answer is not Answered.REFUSED:
            found.append((deed, answer))
    return found


def last_drive(db: sa.Connection) -> str | None:
    """The stop that the truck was last told to drive to."""
    told = drives(db)
    return told[-1][0].stop if told else None


def bound(db: sa.Connection) -> list[SortieRow]:
    """All sorties, for what binds the truck."""
    query = sa.select(t.assignments, t.sorties).join(
        t.sorties, t.sorties.c.assignment == t.assignments.c.id
    )
    return [sortie_row(row, ()) for row in db.execute(query)]


def promised_stops(db: sa.Connection) -> set[str]:
    """Where the truck was last told to drive to, and where drones that are out may land."""
    out = [row for row in bound(db) if not (row.aboard or row.gone)]
    stops = {stop for row in out for stop in (row.promised, row.asked)}
    return {stop for stop in (*stops, last_drive(db)) if stop is not None}


def serving(db: sa.Connection) -> bool:
    """Whether the driver is bringing an order."""
    query = sa.select(sa.func.count()).where(
        t.assignments.c.vehicle == TRUCK,
        t.assignments.c.state.in_([state.value for state in rows.IN_FORCE]),
    )
    return db.execute(query).scalar_one() > 0


def launching(db: sa.Connection, assignment: str) -> bool:
    """Whether a launch of it waits for its answer."""
    waiting = sa.select(sa.func.count()).where(
        t.commands.c.id.startswith(f"{assignment}:launch", autoescape=True),
        t.commands.c.answer.is_(None),
    )
    return db.execute(waiting).scalar_one() > 0


def may_still_hold(db: sa.Connection, vehicle: str) -> str | None:
    """The mission that a drone was switched off with, before it answered that it is withdrawn."""
    newest = (
        sa.select(t.assignments.c.id)
        .where(t.assignments.c.vehicle == vehicle)
        .order_by(t.assignments.c.n.desc())
        .limit(1)
    )
    id_ = db.execute(newest).scalar_one_or_none()
    if id_ is None:
        return None
    withdrawal = t.commands.c.id == f"{id_}:withdraw"
    unanswered = sa.select(t.commands.c.n).where(withdrawal, t.commands.c.life.is_(None))
    return None if db.execute(unanswered).one_or_none() is None else id_


def held(db: sa.Connection, assignment: str) -> bool:
    """Whether its mission is still held back."""
    query = sa.select(t.commands.c.held).where(t.commands.c.id == f"{assignment}:assign")
    return bool(db.execute(query).scalar_one_or_none())


def sortie_row(row: Any, answers: Any) -> SortieRow:
    """A row as the core's type, with the answers to its commands."""
    mine = [a for a in answers if a.id.startswith(f"{row.id}:launch")]
    homes = [a for a in answers if a.id.startswith(f"{row.id}:home")]
    refusals = [a.answered_us for a in homes if a.answer == Answered.REFUSED.value]
    return SortieRow(
        row=rows.assignment_row(row),
        sortie=msgspec.json.decode(row.content, type=PlannedSortie),
        pads=msgspec.json.decode(row.pads, type=dict[str, Place]),
        promised=row.promised,
        asked=row.asked,
        placed=row.placed,
        recovered=row.recovered,
        away=row.away,
        lapsed=row.lapsed,
        launched_us=row.launched_us,
        landed_us=row.landed_us,
        used_wh=row.used_wh,
        launching=any(a.answer is None for a in mine),
        refused=sum(a.answer == Answered.REFUSED.value and a.life is not None for a in mine),
        recovering=any(a.id == f"{row.id}:recover" for a in answers),
        home_refused_us=max((us for us in refusals if us is not None), default=None),
    )
