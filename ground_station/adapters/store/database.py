"""A database by its URL, SQLite (WAL) or PostgreSQL: transactions, and errors in words."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError, NoSuchModuleError

from companion.core.base.errors import LeewayError
from ground_station.adapters.store import tables

BUSY_MS = 10_000
"""How long a desk waits for another desk's transaction; they take milliseconds."""

SCHEMA_LOCK = 0x4C454557
"""PostgreSQL's advisory lock: desks that start together create the tables once."""


class StoreError(LeewayError):
    """The store could not do it; nothing was written."""


class Database:
    """Transactions on the store's tables, which are created where they are missing."""

    def __init__(self, url: str, *, durable: bool = True) -> None:
        """`url`: sqlite:///FILE or postgresql://USER@HOST/NAME. Raises StoreError.

        Without `durable`, SQLite does not wait for the disk: faster, but a power cut may lose what
        was acknowledged.
        """
        self.shown = url
        try:
            self._engine = _engine(url, "FULL" if durable else "OFF")
            self._unsettled = _engine(url, "NORMAL" if durable else "OFF")
            self.shown = self._engine.url.render_as_string(hide_password=True)
        except (ArgumentError, NoSuchModuleError) as error:
            raise StoreError(
                f"store {url!r}: expected sqlite:///FILE or postgresql://... ({error})"
            ) from error
        with self.write() as db:
            if self._engine.dialect.name == "postgresql":
                db.execute(sa.select(sa.func.pg_advisory_xact_lock(SCHEMA_LOCK)))
            tables.metadata.create_all(db)
            self._check_schema(db)

    def close(self) -> None:
        """Give the connections back."""
        self._engine.dispose()
        self._unsettled.dispose()

    @contextmanager
    def write(self, *, settle: bool = True) -> Iterator[sa.Connection]:
        """A transaction: on the disk when it ends well, undone otherwise.

        Without `settle` it survives this process, but perhaps not a power cut: for what the fleet
        would send again.
        """
        engine = self._engine if settle else self._unsettled
        with self._translated("written"), engine.begin() as db:
            if not settle and engine.dialect.name == "postgresql":
                db.exec_driver_sql("SET LOCAL synchronous_commit TO off")
            yield db

    @contextmanager
    def read(self) -> Iterator[sa.Connection]:
        """A consistent read; in SQLite it waits for nobody."""
        with self._translated("read"), self._engine.connect() as db:
            yield db.execution_options(reading=True)

    @contextmanager
    def _translated(self, what: str) -> Iterator[None]:
        try:
            yield
        except IntegrityError:
            raise
        except DBAPIError as error:
            words = " ".join(str(error.orig).split())
            raise StoreError(f"store {self.shown}: nothing {what}: {words}") from error

    def _check_schema(self, db: sa.Connection) -> None:
        about = tables.about
        found = db.execute(
            sa.select(about.c.value).where(about.c.name == "schema")
        ).scalar_one_or_none()
        if found is None:
            db.execute(sa.insert(about).values(name="schema", value=str(tables.SCHEMA)))
        elif found != str(tables.SCHEMA):
            raise StoreError(f"store {self.shown}: schema {found}, expected {tables.SCHEMA}")


def _engine(url: str, synchronous: str) -> sa.Engine:
    parsed = sa.make_url(url)
    if parsed.drivername in ("postgresql", "postgres"):
        parsed = parsed.set(drivername="postgresql+psycopg")
    kind = parsed.drivername.partition("+")[0]
    if kind not in ("sqlite", "postgresql"):
        raise ArgumentError(f"unknown kind {kind}")
    engine = sa.create_engine(parsed, pool_pre_ping=kind == "postgresql")
    if kind == "sqlite":
        event.listen(engine, "connect", partial(_prepare_sqlite, synchronous))
        event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(synchronous: str, raw: Any, record: Any) -> None:
    raw.isolation_level = None  # `_begin_sqlite` begins transactions
    cursor = raw.cursor()
    for pragma in (
        f"busy_timeout = {BUSY_MS}",
        "journal_mode = WAL",
        f"synchronous = {synchronous}",  # FULL: an acknowledged order survives a power cut
        "foreign_keys = ON",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(db: sa.Connection) -> None:
    """A writer takes the lock at once, so no transaction fails half way."""
    reading = db.get_execution_options().get("reading", False)
    db.exec_driver_sql("BEGIN" if reading else "BEGIN IMMEDIATE")
