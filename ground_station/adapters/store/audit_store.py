"""The audit of one store, for reading and verification."""

import sqlalchemy as sa

from ground_station.adapters.store import audit_steps as steps
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.shift.days import during
from ground_station.core.people.audit_chain import AuditHead, AuditRow


def rows_of_day(database: Database, rows: list[AuditRow]) -> list[AuditRow]:
    """Return the rows of the database's past day, or of the current one."""
    with database.read() as db:
        ids = set(db.execute(sa.select(t.audit.c.n).where(during(t.audit.c.at_us, database.day))))
    return [row for row in rows if (row.n,) in ids]


def read_audit_rows_and_head(database: Database) -> tuple[list[AuditRow], AuditHead]:
    """Return every row, oldest first, and the head of the last row."""
    with database.read() as db:
        return steps.read_audit_rows(db), steps.read_audit_head(db)
