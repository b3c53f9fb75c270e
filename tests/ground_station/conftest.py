"""A PostgreSQL server of our own for the tests of the store, where one is installed."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.adapters.postgres_server import PostgresPrograms, PostgresServer
from sim_bridge.adapters.postgres_server import postgres_server as run_server


@pytest.fixture(scope="session")
def own_server() -> Iterator[PostgresServer]:
    """A temporary cluster on loopback."""
    try:
        PostgresPrograms.find()
    except LeewayError as error:
        pytest.skip(f"the store was not tested on PostgreSQL: {error}")
    with run_server() as server:
        yield server


@pytest.fixture(scope="session")
def postgres_server(own_server: PostgresServer) -> str:
    """Its address without the database's name."""
    return own_server.url


@pytest.fixture(scope="session")
def _databases() -> list[str]:
    return []


@pytest.fixture(params=["sqlite", "postgresql"])
def store_url(request: pytest.FixtureRequest, tmp_path: Path, _databases: list[str]) -> str:
    """An empty database of either kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/desk.db"
    _databases.append(f"desk{len(_databases)}")
    return request.getfixturevalue("own_server").create_database(_databases[-1])
