"""Packs: which one a drone has, by the statement of a person, and what it has flown."""

from collections.abc import Callable

import sqlalchemy as sa

from companion.core.base.errors import LeewayError
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.shift.days import during
from ground_station.core.schema.holds import raise_if_invalid_pack_name

MIN_CHARGE_S = 1800.0
"""[est] A pack that was flown and removed less than this ago cannot be charged."""


def pack_by_vehicle(database: Database) -> dict[str, str]:
    """Return the fitted packs."""
    with database.read() as db:
        found = db.execute(sa.select(t.packs).where(t.packs.c.removed_us.is_(None)))
        return {row.vehicle: row.pack for row in found}


def fit_pack(
    database: Database, epoch_us: Callable[[], int], vehicle: str, pack: str, by: str
) -> list[str]:
    """Record that a person has fitted a pack; returns warnings. Raises LeewayError if it is in
    another drone, or its name is not valid.
    """
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        return record_fitted_pack(db, epoch_us(), vehicle, pack, by)


def record_fitted_pack(
    db: sa.Connection,
    now_us: int,
    vehicle: str,
    pack: str,
    by: str,
    *,
    takes_from_other: bool = False,
) -> list[str]:
    """Record a fitted pack, as `fit_pack`. `takes_from_other`: it is not in another drone any more,
    since the driver has it in the hand.
    """
    raise_if_invalid_pack_name(pack)
    before = t.packs.c.pack == pack
    last = db.execute(sa.select(t.packs).where(before).order_by(t.packs.c.n.desc())).first()
    if last is not None and last.removed_us is None:
        if last.vehicle == vehicle:
            return []
        if not takes_from_other:
            text = f"pack {pack}: in {last.vehicle}, expected another one"
            raise LeewayError(f"{text}, or first the pack that {last.vehicle} has now")
    removed = (before | (t.packs.c.vehicle == vehicle)) & t.packs.c.removed_us.is_(None)
    db.execute(sa.update(t.packs).where(removed).values(removed_us=now_us))
    values = {"pack": pack, "vehicle": vehicle, "fitted_us": now_us, "fitted_by": by}
    db.execute(sa.insert(t.packs).values(values))
    warnings = [] if last is None else _not_charged_warnings(db, now_us, last)
    audit.add_entry(db, now_us, by, "pack", vehicle, "; ".join([f"{pack} fitted", *warnings]))
    return warnings


def _not_charged_warnings(db: sa.Connection, now_us: int, last: sa.Row) -> list[str]:
    age_s = (now_us - (last.removed_us or now_us)) / 1e6
    here = t.flights.c.pack == last.pack, t.flights.c.ended_us >= last.fitted_us
    used = sa.select(sa.func.count(), sa.func.sum(t.flights.c.used_wh)).where(*here)
    count, used_wh = db.execute(used).one()
    if not count or age_s > MIN_CHARGE_S:
        return []
    text = f"{last.pack} was in {last.vehicle} until {age_s / 60:.0f} min ago and has flown {count}"
    return [f"{text} times ({used_wh:.0f} Wh) since: is it charged?"]


def record_flight_energy(database: Database, now_us: int, assignment: str, used_wh: float) -> None:
    """Record the energy of a flight that is over, once, for its pack."""
    with database.write(durable=False) as db:
        vehicle = sa.select(t.assignments.c.vehicle).where(t.assignments.c.id == assignment)
        flown_by = db.execute(vehicle).scalar()
        known = sa.select(t.flights).where(t.flights.c.assignment == assignment)
        if flown_by is None or db.execute(known).first() is not None:
            return
        fitted = t.packs.c.removed_us.is_(None) & (t.packs.c.vehicle == flown_by)
        pack = db.execute(sa.select(t.packs.c.pack).where(fitted)).scalar()
        values = {"assignment": assignment, "pack": pack, "used_wh": used_wh, "ended_us": now_us}
        db.execute(sa.insert(t.flights).values(values))
        here = t.sorties.c.assignment == assignment
        db.execute(sa.update(t.sorties).where(here).values(used_wh=used_wh))


def energy_by_pack(database: Database) -> dict[str, tuple[int, float]]:
    """Return the day's flights and their energy (Wh) by pack; `not stated`: without one."""
    flights = t.flights.c
    query = sa.select(flights.pack, sa.func.count(), sa.func.sum(flights.used_wh))
    query = query.where(during(flights.ended_us, database.day))
    with database.read() as db:
        found = db.execute(query.group_by(flights.pack)).all()
    return {pack or "not stated": (count, used_wh) for pack, count, used_wh in found}
