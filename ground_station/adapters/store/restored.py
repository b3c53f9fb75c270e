"""What is done around a copy that is put back: nothing is launched by what an old copy says."""

from ground_station.adapters.store import audit_steps, hold_steps
from ground_station.adapters.store.database import Database, StoreError, schema_of
from ground_station.adapters.store.upgrade import upgrade
from ground_station.core.schema.holds import ALL


def holds_a_store(url: str) -> bool:
    """Whether there is a store in this database, of whichever schema."""
    try:
        database = Database(url, create=False, any_schema=True)
    except StoreError:
        return False
    try:
        with database.read() as db:
            return schema_of(db) is not None
    finally:
        database.close()


def after_restore(url: str, now_us: int, source: str, by: str) -> None:
    """Hold every drone, and say so in the audit, which goes on behind the copy's last row.

    A copy of an older schema is brought to today's first.
    """
    database = Database(url, create=False, any_schema=True)
    try:
        upgrade(database, now_us, by)
        with database.write() as db:
            hold_steps.set_hold(db, now_us, ALL, f"restored from {source}", by)
            audit_steps.note(db, now_us, by, "restore", database.shown, f"from {source}")
    finally:
        database.close()
