"""A day's store becomes unreachable, as a remote one may, and loses no data."""

import contextlib

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.database import StoreError
from sim_bridge.adapters.postgres_server import PostgresExecutables, running_postgres_server
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.desk import DeskDatabase
from sim_bridge.app.day.store_host import PostgresHost, SqliteHost, StoreHost
from tests.ground_station.store.test_order_store import an_order


def goes_away_and_comes_back(host: StoreHost, *, is_readable: bool) -> None:
    with contextlib.closing(
        DeskDatabase.open(host.url, DayClock(), lock_timeout_ms=host.lock_timeout_ms)
    ) as books:
        books.store.add_orders_unless_conflict([an_order("o1")])
        host.start_outage_and_describe()
        with pytest.raises(StoreError):
            books.store.add_orders_unless_conflict([an_order("o2")])
        if is_readable:
            assert list(books.read_final_record(frozenset(), []).orders) == ["o1"]
        else:
            with pytest.raises(StoreError):
                books.store.orders()
        host.end_outage()
        host.end_outage()
        books.store.add_orders_unless_conflict([an_order("o3")])
        assert set(books.read_final_record(frozenset(), []).orders) == {"o1", "o3"}


def test_a_locked_file_is_read_and_not_written_until_it_is_unlocked(tmp_path):
    goes_away_and_comes_back(SqliteHost(tmp_path), is_readable=True)


@pytest.mark.sample
def test_a_killed_server_is_neither_read_nor_written_until_it_is_started_again():
    try:
        PostgresExecutables.find()
    except LeewayError as error:
        pytest.skip(str(error))
    with running_postgres_server() as server:
        host = PostgresHost(server, server.create_database("day"))
        goes_away_and_comes_back(host, is_readable=False)
