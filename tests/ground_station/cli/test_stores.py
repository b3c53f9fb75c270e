"""Location of the store: never created by a reader, never with a password readable by others."""

import contextlib
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.store_file import read_private_store_url
from ground_station.adapters.store.database import Database, StoreError, StoreUnreachable
from ground_station.adapters.store.order_store import Store
from ground_station.app.cli.main import app
from ground_station.app.options.desk_options import open_store_when_reachable
from sim_bridge.adapters.postgres_server import PostgresServer

CODE = "from ground_station.app.cli.main import main; main()"


@pytest.mark.parametrize(
    "command",
    [
        ["report"],
        ["watch", "--fleet", "harbour", "--seconds", "1"],
        ["map", "--fleet", "harbour", "--port", "0"],
        ["order", "list"],
        ["audit"],
        ["hold", "d1", "--reason", "x"],
        ["release", "d1"],
        ["store", "check"],
        ["order", "cancel", "H-1", "--reason", "x"],
        ["order", "show", "H-1"],
    ],
    ids=" ".join,
)
def test_a_store_that_is_not_there_is_said_and_not_made(command: list[str], tmp_path: Path):
    done = CliRunner().invoke(app, [*command, "--store", f"sqlite:///{tmp_path}/mistyped.db"])
    assert isinstance(done.exception, LeewayError)
    assert "no store there" in str(done.exception)
    assert list(tmp_path.iterdir()) == []


def test_an_empty_database_is_no_store_either(store_url: str, tmp_path: Path):
    if store_url.startswith("sqlite"):
        (tmp_path / "desk.db").touch()
    done = CliRunner().invoke(app, ["report", "--store", store_url])
    assert "no store there" in str(done.exception)


def test_a_store_is_its_owners_only(tmp_path: Path):
    Database(f"sqlite:///{tmp_path}/d.db").close()
    assert (tmp_path / "d.db").stat().st_mode & 0o777 == 0o600


@pytest.mark.sample
def test_a_password_on_the_command_line_is_refused_with_what_to_do(tmp_path: Path):
    url = "postgresql://desk:secret@db/day"
    done = subprocess.run(
        [sys.executable, "-c", CODE, "report", "--store", url],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "~/.pgpass" in done.stderr
    assert "--store-file" in done.stderr
    assert "secret" not in done.stderr


def test_a_store_file_is_read_where_only_its_owner_can_read_it(tmp_path: Path):
    Database(f"sqlite:///{tmp_path}/d.db").close()
    file = tmp_path / "store.url"
    file.write_text(f"sqlite:///{tmp_path}/d.db\n")
    file.chmod(0o640)
    with pytest.raises(LeewayError, match="mode 0640, expected 0600: chmod 600"):
        read_private_store_url(file)
    file.chmod(0o600)
    done = CliRunner().invoke(app, ["order", "list", "--store-file", str(file)])
    assert (done.exit_code, done.output.splitlines()[-1]) == (0, "no orders")


@pytest.mark.parametrize("text", ["", "one two", "sqlite:///a.db\nsqlite:///b.db"])
def test_a_store_file_holds_one_url(text: str, tmp_path: Path):
    file = tmp_path / "store.url"
    file.write_text(text)
    file.chmod(0o600)
    with pytest.raises(LeewayError, match="expected one URL"):
        read_private_store_url(file)


@pytest.mark.sample
def test_a_desk_that_starts_while_its_postgresql_is_down_waits_for_it(own_server: PostgresServer):
    """Its service treats exit code 2 as a settings error and does not restart it."""
    url = own_server.create_database("late")
    said: list[str] = []
    waits: list[float] = []

    def wait(wait_s: float) -> None:
        waits.append(wait_s)
        if len(waits) == 3:
            own_server.start_and_wait_until_ready()

    own_server.kill()
    opened = open_store_when_reachable(lambda: Store(Database(url), lambda: 1), said.append, wait)
    assert opened.orders() == []
    opened.close()
    assert waits == [1.0, 2.0, 4.0]
    assert len(said) == 1
    assert "store unreachable: waiting" in said[0]


def test_a_desk_that_starts_while_another_has_its_file_locked_waits_for_it(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    Database(url).close()
    with contextlib.closing(sqlite3.connect(tmp_path / "d.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        attempt = lambda: Store(Database(url, lock_timeout_ms=1), lambda: 1)  # noqa: E731
        opened = open_store_when_reachable(
            attempt, lambda words: None, lambda s: other.execute("ROLLBACK")
        )
        opened.close()


def test_a_database_that_is_not_there_or_no_database_is_a_mistake_and_is_not_waited_for(
    own_server: PostgresServer, tmp_path: Path
):
    (tmp_path / "text.db").write_text("not a database, but long enough to be read as one" * 9)
    for url in (f"{own_server.url}/nobody", f"sqlite:///{tmp_path}/text.db"):
        with pytest.raises(StoreError) as caught:
            Database(url)
        assert not isinstance(caught.value, StoreUnreachable)
