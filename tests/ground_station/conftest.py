"""Stores: an SQLite file, and a PostgreSQL server of the test run if PostgreSQL is installed."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.store import database
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from sim_bridge.adapters.postgres_server import PostgresExecutables, PostgresServer
from sim_bridge.adapters.postgres_server import running_postgres_server as run_server


@pytest.fixture
def new_epochs() -> None:
    """Draw an epoch for each new store."""


@pytest.fixture(autouse=True)
def ids_without_epoch(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """New stores are as an earlier version created them: `o1.1` is the first flight of `o1`."""
    if "new_epochs" not in request.fixturenames:
        monkeypatch.setattr(database, "_begin_epoch_if_missing", lambda *_: None)


@pytest.fixture(scope="session")
def own_server() -> Iterator[PostgresServer]:
    """A temporary database cluster on loopback."""
    try:
        PostgresExecutables.find()
    except LeewayError as error:
        pytest.skip(f"the store was not tested on PostgreSQL: {error}")
    with run_server() as server:
        yield server


@pytest.fixture(scope="session")
def postgres_server(own_server: PostgresServer) -> str:
    """Server URL without a database name."""
    return own_server.url


@pytest.fixture(scope="session")
def _databases() -> list[str]:
    return []


@pytest.fixture(params=["sqlite", "postgresql"])
def store_url(request: pytest.FixtureRequest, tmp_path: Path, _databases: list[str]) -> str:
    """URL of an empty database, SQLite or PostgreSQL."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/desk.db"
    _databases.append(f"desk{len(_databases)}")
    return request.getfixturevalue("own_server").create_database(_databases[-1])


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    """An empty SQLite store whose rows have timestamps 1, 2, 3 ..."""
    made = Store(Database(f"sqlite:///{tmp_path}/desk.db"), itertools.count(1).__next__)
    yield made
    made.close()
