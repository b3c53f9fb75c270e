"""Restore of a copy: all drones are held, since the copy's state may be outdated."""

from ground_station.adapters.store import audit_steps, hold_steps
from ground_station.adapters.store.database import Database, StoreError, store_schema_version
from ground_station.adapters.store.upgrade import upgrade_schema
from ground_station.core.schema.holds import ALL_DRONES


def contains_store(url: str) -> bool:
    """Return whether this database contains a store, of any schema."""
    try:
        database = Database(url, create=False, any_schema=True)
    except StoreError:
        return False
    try:
        with database.read() as db:
            return store_schema_version(db) is not None
    finally:
        database.close()


def upgrade_and_hold_restored_store(url: str, now_us: int, backup_source: str, by: str) -> None:
    """Hold every drone and record the restore in the audit, after the copy's last row.

    A copy of an older schema is upgraded first.
    """
    database = Database(url, create=False, any_schema=True)
    try:
        upgrade_schema(database, now_us, by)
        with database.write() as db:
            hold_steps.insert_hold(db, now_us, ALL_DRONES, f"restored from {backup_source}", by)
            audit_steps.add_entry(
                db, now_us, by, "restore", database.shown_url, f"from {backup_source}"
            )
    finally:
        database.close()
