"""A database by its URL, SQLite (WAL) or PostgreSQL: transactions, and errors in words."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
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
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.store import audit_steps, tables
from ground_station.adapters.store.outage import Outage

BUSY_MS = 10_000
"""How long a desk waits for another desk's transaction; they take milliseconds."""

SOON_MS = 1_000
"""And how long where somebody waits for more than the store: a recall that is under way."""

CONNECT_S = 2
"""Time-out of a connection to PostgreSQL; the least that its library takes for more than none."""

UNHEARD = {"tcp_user_timeout": BUSY_MS, "keepalives_idle": 5, "keepalives_interval": 2}
"""libpq: a server that has gone without a word is away after `BUSY_MS`, not after two hours."""

SCHEMA_LOCK = 0x4C454557
"""PostgreSQL's advisory lock: desks that start together create the tables once."""


class StoreError(LeewayError):
    """The store could not do it; nothing was written."""


class StoreAway(StoreError):
    """It cannot be used now, and may be back by itself: no mistake in the settings."""


class Database:
    """Transactions on the store's tables."""

    def __init__(
        self,
        url: str,
        *,
        durable: bool = True,
        create: bool = True,
        busy_ms: int = BUSY_MS,
        outage: Outage | None = None,
        any_schema: bool = False,
    ) -> None:
        """`url`: sqlite:///FILE or postgresql://USER@HOST/NAME. Raises StoreError.

        Without `durable`, SQLite does not wait for the disk: faster, but a power cut may lose what
        was acknowledged. Without `create`, a store that is not there is an error, and stays so.
        `busy_ms`: how long it waits for another desk's transaction. With `outage`, a store that is
        away is an error at once, until it is time to try it again. `any_schema`: to upgrade it.
        """
        self.shown, self.outage = url, None
        self.write_took_s: float | None = None
        try:
            self._engine = _engine(url, "FULL" if durable else "OFF", busy_ms)
            self._unsettled = _engine(url, "NORMAL" if durable else "OFF", busy_ms)
            self.shown = sa.make_url(url).render_as_string(hide_password=True)
        except (ArgumentError, NoSuchModuleError) as error:
            raise StoreError(
                f"store {url!r}: expected sqlite:///FILE or postgresql://... ({error})"
            ) from error
        try:
            self._open(create, any_schema)
        except StoreError:
            self.close()
            raise
        self.outage = outage

    def _open(self, create: bool, any_schema: bool) -> None:
        path = sqlite_file(self._engine.url)
        if create:
            self._create()
        elif path is not None and not path.exists():
            check_schema(None, self.shown)
        if not any_schema:
            with self.read() as db:
                check_schema(schema_of(db), self.shown)

    def _create(self) -> None:
        """Make file and tables where there is no store."""
        _make_file(self._engine.url, self.shown)
        with self.write() as db:
            if self._engine.dialect.name == "postgresql":
                db.execute(sa.select(sa.func.pg_advisory_xact_lock(SCHEMA_LOCK)))
            if schema_of(db) is None:
                _make_tables(db)

    def close(self) -> None:
        """Give the connections back."""
        self._engine.dispose()
        self._unsettled.dispose()

    @contextmanager
    def write(self, *, settle: bool = True) -> Iterator[sa.Connection]:
        """A transaction: on the disk when it ends well, undone otherwise.

        Without `settle` it survives this process, but perhaps not a power cut: for what the fleet
        would send again. `write_took_s` tells how long the newest took.
        """
        began_s = monotonic_s()
        engine = self._engine if settle else self._unsettled
        with self._translated("written"), engine.begin() as db:
            if not settle and engine.dialect.name == "postgresql":
                db.exec_driver_sql("SET LOCAL synchronous_commit TO off")
            audit_steps.begin(db)
            yield db
            audit_steps.write(db)
        self.write_took_s = monotonic_s() - began_s

    def try_again(self) -> None:
        """Where a write has failed, write a row as it is. Raises StoreError if it fails again."""
        if self.outage is None or not self.outage.in_writing:
            return
        here = tables.about.c.name == "schema"
        with self.write() as db:
            db.execute(sa.update(tables.about).where(here).values(value=tables.about.c.value))

    @contextmanager
    def read(self) -> Iterator[sa.Connection]:
        """A consistent read; in SQLite it waits for nobody."""
        with self._translated("read"), self._engine.connect() as db:
            yield db.execution_options(reading=True)

    @contextmanager
    def _translated(self, what: str) -> Iterator[None]:
        outage, writing = self.outage, what == "written"
        if outage is not None and outage.is_waiting:
            raise StoreError(outage.why or "")
        try:
            yield
        except IntegrityError:
            raise
        except DBAPIError as error:
            why = f"store {self.shown}: nothing {what}: {' '.join(str(error.orig).split())}"
            if outage is not None:
                outage.failed(why, writing=writing)
            raise (StoreAway if _is_away(error) else StoreError)(why) from error
        if outage is not None:
            outage.ended(writing=writing)


def _is_away(error: DBAPIError) -> bool:
    """Whether time may mend it: a lock, a full disk, a server that is not there or just starts.

    libpq has no code for a connection that failed. A server that refuses one says FATAL; only where
    it starts, stops or recovers does it go on with its system's state.
    """
    words = str(error.orig)
    if not isinstance(error, OperationalError):
        return False
    if isinstance(error.orig, sqlite3.Error):
        return "locked" in words or "full" in words
    return "FATAL" not in words or "the database system is" in words


def schema_of(db: sa.Connection) -> int | None:
    """The schema of a store; None: there is no store in this database."""
    if not sa.inspect(db).has_table(tables.about.name):
        return None
    query = sa.select(tables.about.c.value).where(tables.about.c.name == "schema")
    found = db.execute(query).scalar_one_or_none()
    return None if found is None else int(found)


def check_schema(found: int | None, shown: str) -> None:
    """Raise StoreError, with what to do, where a desk of today cannot work on this schema."""
    if found is None:
        raise StoreError(f"store {shown}: there is none; `ground-station order import` makes one")
    if found == tables.SCHEMA:
        return
    remedy = "a newer ground-station made it"
    if found < tables.SCHEMA:
        remedy = "`ground-station store upgrade` brings it there"
    raise StoreError(f"store {shown}: schema {found}, expected {tables.SCHEMA}: {remedy}")


def _make_tables(db: sa.Connection) -> None:
    tables.metadata.create_all(db)
    facts = {"schema": str(tables.SCHEMA), audit_steps.HEAD: audit_steps.first_head()}
    rows = [{"name": name, "value": value} for name, value in facts.items()]
    db.execute(sa.insert(tables.about), rows)


def sqlite_file(url: sa.URL) -> Path | None:
    """The file of an SQLite store; None: PostgreSQL."""
    if url.get_backend_name() != "sqlite":
        return None
    name = url.database or ""
    return Path(unquote(name.removeprefix("file:")) if name.startswith("file:") else name)


def _make_file(url: sa.URL, shown: str) -> None:
    """Make SQLite's file, for its owner only: it holds where people live."""
    path = sqlite_file(url)
    if path is None:
        return
    try:
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
    except OSError as error:
        raise StoreError(f"store {shown}: unable to open: {error.strerror}") from error


def _engine(url: str, synchronous: str, busy_ms: int) -> sa.Engine:
    parsed = sa.make_url(url)
    if parsed.drivername in ("postgresql", "postgres"):
        parsed = parsed.set(drivername="postgresql+psycopg")
    kind = parsed.drivername.partition("+")[0]
    if kind not in ("sqlite", "postgresql") or not parsed.database:
        raise ArgumentError(f"unknown kind {kind}, or no name")
    if kind == "sqlite":  # SQLite would create a file that is not there
        file = "file:" + quote(parsed.database)
        parsed = parsed.set(database=file, query={"mode": "rw", "uri": "true"})
    if kind == "postgresql":
        told = {"connect_timeout": CONNECT_S, "options": f"-c lock_timeout={busy_ms}"}
        return sa.create_engine(parsed, pool_pre_ping=True, connect_args=told | UNHEARD)
    engine = sa.create_engine(parsed)
    event.listen(engine, "connect", partial(_prepare_sqlite, synchronous, busy_ms))
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(synchronous: str, busy_ms: int, raw: Any, record: Any) -> None:
    raw.isolation_level = None  # `_begin_sqlite` begins transactions
    cursor = raw.cursor()
    for pragma in (
        f"busy_timeout = {busy_ms}",
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
