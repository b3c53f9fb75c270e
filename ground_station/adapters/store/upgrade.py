"""Upgrade of a store to the current schema, in one transaction."""

from pathlib import Path

import sqlalchemy as sa
from alembic import command
from alembic.config import Config

from ground_station.adapters.store import audit_steps, tables
from ground_station.adapters.store.database import Database, StoreError, store_schema_version

MIGRATIONS = Path(__file__).with_name("migrations")
OLDEST_SCHEMA = 2


def upgrade_schema(database: Database, now_us: int, by: str) -> tuple[int, int]:
    """Return the schema before and after. `database` was opened with `any_schema`.

    Only `about` states the schema of a store: Alembic's own table exists during its run only.
    """
    with database.write() as db:
        found = store_schema_version(db)
        if found is None or not OLDEST_SCHEMA <= found <= tables.SCHEMA:
            expected = f"expected {OLDEST_SCHEMA} to {tables.SCHEMA}"
            raise StoreError(f"store {database.shown_url}: schema {found}, {expected}")
        if found < tables.SCHEMA:
            _migrate_to_current_schema(db, found)
            result = f"schema {found} to {tables.SCHEMA}"
            audit_steps.add_entry(db, now_us, by, "upgrade", database.shown_url, result)
    return found, tables.SCHEMA


def _migrate_to_current_schema(db: sa.Connection, current_schema: int) -> None:
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.attributes["connection"] = db
    command.stamp(config, str(current_schema))
    command.upgrade(config, str(tables.SCHEMA))
    db.exec_driver_sql("DROP TABLE alembic_version")
    schema = tables.about.c.name == "schema"
    db.execute(sa.update(tables.about).where(schema).values(value=str(tables.SCHEMA)))
