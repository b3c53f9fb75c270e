"""Bring a store of an older schema to today's, whole or not at all."""

from pathlib import Path

import sqlalchemy as sa
from alembic import command
from alembic.config import Config

from ground_station.adapters.store import audit_steps, tables
from ground_station.adapters.store.database import Database, StoreError, schema_of

MIGRATIONS = Path(__file__).with_name("migrations")
OLDEST = 2


def upgrade(database: Database, now_us: int, by: str) -> tuple[int, int]:
    """Schema before and now. `database` was opened without a look at its schema.

    `about` alone says which schema a store has: Alembic's own table is there for its run only.
    """
    with database.write() as db:
        found = schema_of(db)
        if found is None or not OLDEST <= found <= tables.SCHEMA:
            expected = f"expected {OLDEST} to {tables.SCHEMA}"
            raise StoreError(f"store {database.shown}: schema {found}, {expected}")
        if found < tables.SCHEMA:
            _migrate(db, found)
            answer = f"schema {found} to {tables.SCHEMA}"
            audit_steps.note(db, now_us, by, "upgrade", database.shown, answer)
    return found, tables.SCHEMA


def _migrate(db: sa.Connection, found: int) -> None:
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.attributes["connection"] = db
    command.stamp(config, str(found))
    command.upgrade(config, str(tables.SCHEMA))
    db.exec_driver_sql("DROP TABLE alembic_version")
    schema = tables.about.c.name == "schema"
    db.execute(sa.update(tables.about).where(schema).values(value=str(tables.SCHEMA)))
