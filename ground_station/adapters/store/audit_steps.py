"""Entries of the audit: noted inside a transaction, chained and written as its last step.

As the last step, because the newest row is locked for it (PostgreSQL): no transaction waits for
another one's rows while it holds that lock.
"""

from typing import Any

import msgspec
import sqlalchemy as sa

from ground_station.adapters.login import login
from ground_station.adapters.store import tables as t
from ground_station.core.people.audit_chain import AuditEntry, AuditHead, AuditRow, following

HEAD = "audit_head"
_NOTED = "audit"

WORDS = 500
"""Longest answer that is kept, as long as words of a message."""


def begin(db: sa.Connection) -> None:
    """Nothing is noted yet in this transaction."""
    db.info[_NOTED] = []


def note(db: sa.Connection, at_us: int, who: str, deed: str, subject: str, answer: str) -> None:
    """Note an entry; it is written when the transaction ends well, with all that it did."""
    entry = AuditEntry(at_us, who, login(), deed, subject[:WORDS], answer[:WORDS])
    db.info[_NOTED].append(entry)


def write(db: sa.Connection) -> None:
    """Append what was noted; the desks of a store append one after the other."""
    noted: list[AuditEntry] = db.info.pop(_NOTED, [])
    if not noted:
        return
    rows = list(following(head(db, lock=True), noted))
    db.execute(sa.insert(t.audit), [_values(row) for row in rows])
    newest = msgspec.json.encode(AuditHead(rows[-1].n, rows[-1].digest)).decode()
    db.execute(sa.update(t.about).where(t.about.c.name == HEAD).values(value=newest))


def head(db: sa.Connection, *, lock: bool = False) -> AuditHead:
    """The newest row; `lock`: nobody else appends until this transaction ends."""
    query = sa.select(t.about.c.value).where(t.about.c.name == HEAD)
    kept = db.execute(query.with_for_update() if lock else query).scalar_one()
    return msgspec.json.decode(kept, type=AuditHead)


def first_head() -> str:
    """The head of an audit without rows, as it is kept."""
    return msgspec.json.encode(AuditHead()).decode()


def rows(db: sa.Connection) -> list[AuditRow]:
    """The whole audit, oldest first."""
    return [_row(found) for found in db.execute(sa.select(t.audit).order_by(t.audit.c.n))]


def _values(row: AuditRow) -> dict[str, Any]:
    table = msgspec.to_builtins(row)
    return table.pop("entry") | table


def _row(found: Any) -> AuditRow:
    entry = AuditEntry(found.at_us, found.who, found.login, found.deed, found.subject, found.answer)
    return AuditRow(found.n, entry, found.before, found.digest)
