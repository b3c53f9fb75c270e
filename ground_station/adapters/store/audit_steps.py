"""Audit entries: collected inside a transaction, then chained and written as its last step.

The last step, because it locks the newest row (PostgreSQL): no transaction waits for another
transaction's rows while it holds that lock.
"""

from dataclasses import fields
from typing import Any

import msgspec
import sqlalchemy as sa

from ground_station.adapters.login import account_at_host
from ground_station.adapters.store import tables as t
from ground_station.core.people.audit_chain import (
    AuditEntry,
    AuditHead,
    AuditRow,
    build_chained_rows,
)

HEAD_KEY = "audit_head"
_PENDING_KEY = "audit"

MAX_TEXT_LENGTH = 500
"""Maximum length of a stored result text, equal to that of a message text."""


def start_pending_audit_entries(db: sa.Connection) -> None:
    """Start with no audit entries in this transaction."""
    db.info[_PENDING_KEY] = []


def add_entry(
    db: sa.Connection, at_us: int, actor: str, action: str, subject: str, result: str
) -> None:
    """Add an audit entry; it is written when the transaction commits."""
    entry = AuditEntry(
        at_us, actor, account_at_host(), action, subject[:MAX_TEXT_LENGTH], result[:MAX_TEXT_LENGTH]
    )
    db.info[_PENDING_KEY].append(entry)


def write_pending_audit_entries(db: sa.Connection) -> None:
    """Append the collected entries; the desks of one store append one after the other."""
    pending: list[AuditEntry] = db.info.pop(_PENDING_KEY, [])
    if not pending:
        return
    rows = list(build_chained_rows(read_audit_head(db, lock_until_commit=True), pending))
    db.execute(sa.insert(t.audit), [_audit_column_values(row) for row in rows])
    newest = msgspec.json.encode(AuditHead(rows[-1].n, rows[-1].digest)).decode()
    db.execute(sa.update(t.about).where(t.about.c.name == HEAD_KEY).values(value=newest))


def read_audit_head(db: sa.Connection, *, lock_until_commit: bool = False) -> AuditHead:
    """Return the newest row's head; `lock_until_commit`: no other desk appends until then."""
    query = sa.select(t.about.c.value).where(t.about.c.name == HEAD_KEY)
    kept = db.execute(query.with_for_update() if lock_until_commit else query).scalar_one()
    return msgspec.json.decode(kept, type=AuditHead)


def empty_head_json() -> str:
    """Return the encoded head of an audit without rows."""
    return msgspec.json.encode(AuditHead()).decode()


def read_audit_rows(db: sa.Connection) -> list[AuditRow]:
    """Return the whole audit, oldest first."""
    return [_audit_row(found) for found in db.execute(sa.select(t.audit).order_by(t.audit.c.n))]


def _audit_column_values(row: AuditRow) -> dict[str, Any]:
    table = msgspec.to_builtins(row)
    return table.pop("entry") | table


def _audit_row(database_row: Any) -> AuditRow:
    entry = AuditEntry(*(getattr(database_row, field.name) for field in fields(AuditEntry)))
    return AuditRow(database_row.n, entry, database_row.before, database_row.digest)
