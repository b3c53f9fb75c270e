"""Access to SQLite (WAL) or PostgreSQL by URL: transactions, and translated errors."""

import os
import secrets
import sqlite3
import string
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote, unquote

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.exc import (
    ArgumentError,
    DBAPIError,
    IntegrityError,
    NoSuchModuleError,
    OperationalError,
)

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import local_date
from ground_station.adapters.store import about_steps, audit_steps, tables
from ground_station.adapters.store.outage import Outage
from ground_station.core.schema.orders import EPOCH_CHARS, ROOT_CHARS

Value = TypeVar("Value")

LOCK_TIMEOUT_MS = 10_000
"""Time-out for another desk's transaction; transactions take milliseconds."""

URGENT_LOCK_TIMEOUT_MS = 1_000
"""The same time-out for an urgent caller: a recall in progress."""

CONNECT_TIMEOUT_S = 2
"""Time-out of a connection to PostgreSQL; the shortest that libpq supports."""

SERVER_TIMEOUTS = {
    "tcp_user_timeout": LOCK_TIMEOUT_MS,
    "keepalives_idle": 5,
    "keepalives_interval": 2,
}
"""libpq: an unresponsive server counts as lost after `LOCK_TIMEOUT_MS`, not after two hours."""

EPOCH_ALPHABET = string.ascii_lowercase + string.digits
SCHEMA_LOCK = 0x4C454557
"""PostgreSQL advisory lock: desks that start together create the tables once."""


class StoreError(LeewayError):
    """The store operation failed; nothing was written."""


class StoreUnreachable(StoreError):
    """The store is unreachable now and may recover without a change of settings."""


class Database:
    """Transactions on the store's tables."""

    def __init__(
        self,
        url: str,
        *,
        durable: bool = True,
        create: bool = True,
        lock_timeout_ms: int = LOCK_TIMEOUT_MS,
        outage: Outage | None = None,
        any_schema: bool = False,
        first_epoch: str = "",
    ) -> None:
        """`url`: sqlite:///FILE or postgresql://USER@HOST/NAME. Raises StoreError.

        Without `durable`, SQLite does not wait for the disk: faster, but a power cut may lose
        acknowledged data. Without `create`, a missing store is an error and is not created.
        `lock_timeout_ms`: time-out for another desk's transaction. With `outage`, an unreachable
        store is an error at once, until its next retry. `any_schema`: accept any schema, for an
        upgrade. `first_epoch`: epoch of a new store; empty: drawn.
        """
        self.shown_url, self.outage = url, None
        self.day: str | None = None  # a past day, to read; None: the current one
        try:
            self._engine = _create_engine(url, "FULL" if durable else "OFF", lock_timeout_ms)
            self._relaxed_engine = _create_engine(
                url, "NORMAL" if durable else "OFF", lock_timeout_ms
            )
            self.shown_url = sa.make_url(url).render_as_string(hide_password=True)
        except (ArgumentError, NoSuchModuleError) as error:
            raise StoreError(
                f"store {url!r}: expected sqlite:///FILE or postgresql://... ({error})"
            ) from error
        try:
            self._create_if_missing_and_check_schema(create, any_schema, first_epoch)
        except StoreError:
            self.close()
            raise
        self.outage = outage

    def _create_if_missing_and_check_schema(
        self, create_if_missing: bool, any_schema: bool, first_epoch: str
    ) -> None:
        path = sqlite_file_path(self._engine.url)
        if create_if_missing:
            self._create_store_if_missing(first_epoch)
        elif path is not None and not path.exists():
            require_current_schema(None, self.shown_url)
        if not any_schema:
            with self.read() as db:
                require_current_schema(store_schema_version(db), self.shown_url)

    def _create_store_if_missing(self, first_epoch: str) -> None:
        """Create file and tables if there is no store."""
        _create_sqlite_file(self._engine.url, self.shown_url)
        with self.write() as db:
            if self._engine.dialect.name == "postgresql":
                db.execute(sa.select(sa.func.pg_advisory_xact_lock(SCHEMA_LOCK)))
            if store_schema_version(db) is None:
                _create_tables(db)
            _begin_epoch_if_missing(db, first_epoch)

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()
        self._relaxed_engine.dispose()

    @contextmanager
    def write(self, *, durable: bool = True) -> Iterator[sa.Connection]:
        """Open a transaction: durable when it commits, rolled back on an exception.

        Without `durable` it survives a crash of this process, but possibly not a power cut: for
        data that the fleet would send again.
        """
        engine = self._engine if durable else self._relaxed_engine
        with self._translate_and_record_errors("written"), engine.begin() as db:
            if not durable and engine.dialect.name == "postgresql":
                db.exec_driver_sql("SET LOCAL synchronous_commit TO off")
            audit_steps.start_pending_audit_entries(db)
            yield db
            audit_steps.write_pending_audit_entries(db)

    def probe_write_after_failure(self) -> None:
        """After a failed write, rewrite one row unchanged. Raises StoreError if this fails too."""
        if self.outage is None or not self.outage.is_write_failure:
            return
        here = tables.about.c.name == "schema"
        with self.write() as db:
            db.execute(sa.update(tables.about).where(here).values(value=tables.about.c.value))

    @contextmanager
    def read(self) -> Iterator[sa.Connection]:
        """Open a consistent read; in SQLite it waits for no writer."""
        with self._translate_and_record_errors("read"), self._engine.connect() as db:
            yield db.execution_options(reading=True)

    def about_value(self, name: str, value_type: type[Value]) -> Value | None:
        """Return a value of the table `about`; None: it is not stored."""
        with self.read() as db:
            return about_steps.about_value(db, name, value_type)

    def replace_about_value(self, name: str, value: Any) -> None:
        """Store a value in the table `about`."""
        schema_row = sa.select(tables.about).where(tables.about.c.name == "schema")
        with self.write() as db:
            db.execute(schema_row.with_for_update())  # several desks may start at once
            about_steps.replace_about_value(db, name, value)

    @contextmanager
    def _translate_and_record_errors(self, operation_participle: str) -> Iterator[None]:
        outage, is_write = self.outage, operation_participle == "written"
        if outage is not None and outage.is_before_next_retry:
            raise StoreError(outage.reason or "")
        try:
            yield
        except IntegrityError:
            raise
        except DBAPIError as error:
            message = (
                f"store {self.shown_url}: nothing {operation_participle}:"
                f" {' '.join(str(error.orig).split())}"
            )
            if outage is not None:
                outage.record_failure_and_schedule_retry(message, is_write=is_write)
            raise (StoreUnreachable if _is_store_temporarily_unreachable(error) else StoreError)(
                message
            ) from error
        if outage is not None:
            outage.record_success_and_end_outage(is_write=is_write)


def _is_store_temporarily_unreachable(error: DBAPIError) -> bool:
    """Return whether the error may resolve itself: a lock, a full disk, a server down or starting.

    libpq has no code for a failed connection. A server that refuses one reports FATAL; only a
    server that starts, stops or recovers continues with the state of the database system.
    """
    words = str(error.orig)
    if not isinstance(error, OperationalError):
        return False
    if isinstance(error.orig, sqlite3.Error):
        return "locked" in words or "full" in words
    return "FATAL" not in words or "the database system is" in words


def store_schema_version(db: sa.Connection) -> int | None:
    """Return the schema of a store, None if this database contains no store."""
    if not sa.inspect(db).has_table(tables.about.name):
        return None
    query = sa.select(tables.about.c.value).where(tables.about.c.name == "schema")
    found = db.execute(query).scalar_one_or_none()
    return None if found is None else int(found)


def require_current_schema(schema_version: int | None, shown_store_url: str) -> None:
    """Raise StoreError, with the remedy, if this version cannot use this schema."""
    if schema_version is None:
        raise StoreError(
            f"store {shown_store_url}: no store there; `ground-station order import` creates one"
        )
    if schema_version == tables.SCHEMA:
        return
    remedy = "created by a newer ground-station"
    if schema_version < tables.SCHEMA:
        remedy = "run `ground-station store upgrade`"
    raise StoreError(
        f"store {shown_store_url}: schema {schema_version}, expected {tables.SCHEMA}: {remedy}"
    )


def _begin_epoch_if_missing(db: sa.Connection, first_epoch: str) -> None:
    """Begin an epoch: the store is new, or of a version without them."""
    if about_steps.about_value(db, tables.EPOCHS_KEY, list[str]) is None:
        about_steps.replace_about_value(db, tables.EPOCHS_KEY, [first_epoch or draw_epoch([])])


def draw_epoch(earlier: list[str]) -> str:
    """Return an epoch of the same store that differs from the earlier ones."""
    while True:
        drawn = "".join(secrets.choice(EPOCH_ALPHABET) for _ in range(EPOCH_CHARS))
        epoch = earlier[-1][:ROOT_CHARS] + drawn[ROOT_CHARS:] if earlier else drawn
        if epoch not in earlier:
            return epoch


def _create_tables(db: sa.Connection) -> None:
    tables.metadata.create_all(db)
    about_values = {
        "schema": str(tables.SCHEMA),
        audit_steps.HEAD_KEY: audit_steps.empty_head_json(),
    }
    rows = [{"name": name, "value": value} for name, value in about_values.items()]
    db.execute(sa.insert(tables.about), rows)
    db.execute(sa.insert(tables.days).values(day=local_date().isoformat(), began_us=0))


def sqlite_file_path(url: sa.URL) -> Path | None:
    """Return the file of an SQLite store, None for PostgreSQL."""
    if url.get_backend_name() != "sqlite":
        return None
    name = url.database or ""
    return Path(unquote(name.removeprefix("file:")) if name.startswith("file:") else name)


def _create_sqlite_file(url: sa.URL, shown_store_url: str) -> None:
    """Create SQLite's file with mode 0600: it contains customer addresses."""
    path = sqlite_file_path(url)
    if path is None:
        return
    try:
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
    except OSError as error:
        raise StoreError(f"store {shown_store_url}: unable to open: {error.strerror}") from error


def _create_engine(url: str, sqlite_synchronous: str, lock_timeout_ms: int) -> sa.Engine:
    parsed = sa.make_url(url)
    if parsed.drivername in ("postgresql", "postgres"):
        parsed = parsed.set(drivername="postgresql+psycopg")
    kind = parsed.drivername.partition("+")[0]
    if kind not in ("sqlite", "postgresql") or not parsed.database:
        raise ArgumentError(f"unknown kind {kind}, or no name")
    if "memory" in parsed.query.values() or ":memory:" in parsed.database:
        raise ArgumentError("a store in memory is lost when the command ends")
    if kind == "sqlite":  # SQLite would create a missing file
        file = "file:" + quote(parsed.database)
        parsed = parsed.set(database=file, query={"mode": "rw", "uri": "true"})
    if kind == "postgresql":
        connect_options = {
            "connect_timeout": CONNECT_TIMEOUT_S,
            "options": f"-c lock_timeout={lock_timeout_ms}",
        }
        return sa.create_engine(
            parsed, pool_pre_ping=True, connect_args=connect_options | SERVER_TIMEOUTS
        )
    engine = sa.create_engine(parsed)
    event.listen(
        engine,
        "connect",
        partial(_configure_sqlite_connection, sqlite_synchronous, lock_timeout_ms),
    )
    event.listen(engine, "begin", _begin_sqlite_transaction)
    return engine


def _configure_sqlite_connection(
    synchronous: str, lock_timeout_ms: int, raw: Any, record: Any
) -> None:
    raw.isolation_level = None  # `_begin_sqlite_transaction` begins transactions
    cursor = raw.cursor()
    for pragma in (
        f"busy_timeout = {lock_timeout_ms}",
        "journal_mode = WAL",
        f"synchronous = {synchronous}",  # FULL: an acknowledged order survives a power cut
        "foreign_keys = ON",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite_transaction(db: sa.Connection) -> None:
    """Begin a transaction; a writer locks at once, so no transaction fails half way."""
    reading = db.get_execution_options().get("reading", False)
    db.exec_driver_sql("BEGIN" if reading else "BEGIN IMMEDIATE")
