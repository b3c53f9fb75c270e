"""The audit of one store, for reading and verification."""

from ground_station.adapters.store import audit_steps as steps
from ground_station.adapters.store.database import Database
from ground_station.core.people.audit_chain import AuditHead, AuditRow


def read_audit_rows_and_head(database: Database) -> tuple[list[AuditRow], AuditHead]:
    """Return every row, oldest first, and the head of the last row."""
    with database.read() as db:
        return steps.read_audit_rows(db), steps.read_audit_head(db)
