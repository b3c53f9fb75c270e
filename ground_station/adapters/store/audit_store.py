"""The audit of one store, to be read and verified."""

from ground_station.adapters.store import audit_steps as steps
from ground_station.adapters.store.database import Database
from ground_station.core.people.audit_chain import AuditHead, AuditRow


def read_audit(database: Database) -> tuple[list[AuditRow], AuditHead]:
    """Every row, oldest first, and which was written last."""
    with database.read() as db:
        return steps.rows(db), steps.head(db)
