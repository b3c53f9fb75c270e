"""Copies of a store, while desks work on it: SQLite's backup API, or pg_dump and pg_restore."""

import contextlib
import os
import shutil
import sqlite3
import subprocess
from pathlib import Path

import sqlalchemy as sa

from ground_station.adapters.store.database import StoreError, sqlite_file

PASSWORD = "PGPASSWORD"
"""pg_dump's and pg_restore's: in their environment only their own user reads it, unlike in argv."""


def backup(url: str, target: Path) -> None:
    """Copy a store into a new file, for its owner only. Raises StoreError; then there is none."""
    part = target.with_name(target.name + ".part")
    if target.exists():
        raise StoreError(f"{target}: is there already")
    try:
        os.close(os.open(part, os.O_CREAT | os.O_TRUNC | os.O_WRONLY, 0o600))
        _copy_out(sa.make_url(url), part)
        part.rename(target)
    except OSError as error:
        raise StoreError(f"{target}: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)


def _copy_out(url: sa.URL, target: Path) -> None:
    path = sqlite_file(url)
    if path is None:
        _run(url, "pg_dump", "--format=custom", f"--file={target}")
    else:
        _copy_sqlite(path, target)


def restore(url: str, source: Path) -> None:
    """Put a copy in the place of what a store holds, at once or not at all. Raises StoreError."""
    parsed = sa.make_url(url)
    path = sqlite_file(parsed)
    if not source.is_file():
        raise StoreError(f"{source}: no such file")
    if path is None:
        whole = ("--clean", "--if-exists", "--no-owner", "--single-transaction")
        _run(parsed, "pg_restore", *whole, "--exit-on-error", str(source))
        return
    try:
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
    except OSError as error:
        raise StoreError(f"{path}: {error.strerror}") from error
    _copy_sqlite(source, path)


def _copy_sqlite(source: Path, target: Path) -> None:
    """A consistent copy with what is only in the WAL, by pages; it waits for no desk to end."""
    try:
        with (
            contextlib.closing(
                sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True)
            ) as ours,
            contextlib.closing(sqlite3.connect(target)) as theirs,
        ):
            wrong = [row[0] for row in ours.execute("PRAGMA integrity_check(1)")]
            if wrong != ["ok"]:
                raise StoreError(f"{source}: {wrong[0]}")
            ours.backup(theirs)
    except sqlite3.Error as error:
        raise StoreError(f"{source} to {target}: {error}") from error


def _run(url: sa.URL, program: str, *arguments: str) -> None:
    """Run a program of PostgreSQL's on this database; the password is not in its arguments."""
    found = shutil.which(program)
    if found is None:
        raise StoreError(f"{program}: not found; it comes with PostgreSQL's client")
    bare = url.set(drivername="postgresql", password=None)
    environment = dict(os.environ)
    if url.password is not None:
        environment[PASSWORD] = str(url.password)
    address = f"--dbname={bare.render_as_string(hide_password=False)}"
    done = subprocess.run(
        [found, "--no-password", address, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise StoreError(f"{program}: {' '.join(done.stderr.split())}")
