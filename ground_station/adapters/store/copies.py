"""Copies of a store while desks use it: SQLite's backup API, or pg_dump and pg_restore."""

import contextlib
import os
import shutil
import sqlite3
import subprocess
from pathlib import Path

import sqlalchemy as sa

from ground_station.adapters.store.database import StoreError, sqlite_file_path

PASSWORD_VARIABLE = "PGPASSWORD"
"""Environment variable of pg_dump and pg_restore; unlike argv, only their own user can read it."""


def back_up_store(store_url: str, backup_file: Path) -> None:
    """Copy a store into a new file with mode 0600. Raises StoreError; then no file remains."""
    part = backup_file.with_name(backup_file.name + ".part")
    if backup_file.exists():
        raise StoreError(f"{backup_file}: exists already, expected a new file")
    try:
        os.close(os.open(part, os.O_CREAT | os.O_TRUNC | os.O_WRONLY, 0o600))
        url = sa.make_url(store_url)
        path = sqlite_file_path(url)
        if path is None:
            _run_postgres_program(url, "pg_dump", "--format=custom", f"--file={part}")
        else:
            _copy_sqlite_database(path, part)
        part.rename(backup_file)
    except OSError as error:
        raise StoreError(f"{backup_file}: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)


def restore(store_url: str, backup_file: Path) -> None:
    """Replace the content of a store with a copy, in one transaction. Raises StoreError."""
    parsed = sa.make_url(store_url)
    path = sqlite_file_path(parsed)
    if not backup_file.is_file():
        raise StoreError(f"{backup_file}: no such file")
    if path is None:
        whole = ("--clean", "--if-exists", "--no-owner", "--single-transaction")
        _run_postgres_program(parsed, "pg_restore", *whole, "--exit-on-error", str(backup_file))
        return
    try:
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
    except OSError as error:
        raise StoreError(f"{path}: {error.strerror}") from error
    _copy_sqlite_database(backup_file, path)


def _copy_sqlite_database(source_file: Path, target_file: Path) -> None:
    """Copy consistently by pages, including the WAL; it does not wait for desks to end."""
    try:
        with (
            contextlib.closing(
                sqlite3.connect(f"{source_file.absolute().as_uri()}?mode=ro", uri=True)
            ) as source_db,
            contextlib.closing(sqlite3.connect(target_file)) as target_db,
        ):
            wrong = [row[0] for row in source_db.execute("PRAGMA integrity_check(1)")]
            if wrong != ["ok"]:
                raise StoreError(f"{source_file}: {wrong[0]}")
            source_db.backup(target_db)
    except sqlite3.Error as error:
        raise StoreError(f"{source_file} to {target_file}: {error}") from error


def _run_postgres_program(url: sa.URL, program: str, *arguments: str) -> None:
    """Run a PostgreSQL program on this database; the password is not in its arguments."""
    found = shutil.which(program)
    if found is None:
        raise StoreError(f"{program}: not found; it comes with PostgreSQL's client")
    bare = url.set(drivername="postgresql", password=None)
    environment = dict(os.environ)
    if url.password is not None:
        environment[PASSWORD_VARIABLE] = str(url.password)
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
