"""A store of an older schema is upgraded: same tables as a new one, no data lost."""

import shutil
import sqlite3
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from typer.testing import CliRunner

from ground_station.adapters.store import audit_steps, tables
from ground_station.adapters.store.database import Database, StoreError
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.upgrade import upgrade_schema
from ground_station.app.cli.main import app
from ground_station.core.schema.holds import ALL_DRONES
from ground_station.core.schema.orders import AssignmentState, OrderState
from tests.ground_station.store.test_order_store import FLIGHT, opened, states

SCHEMAS = Path(__file__).with_name("schemas")


def of_schema_2(url: str) -> str:
    """Create a store as left by the desk of schema 2 in the middle of a day."""
    kind = url.partition(":")[0]
    script = (SCHEMAS / f"schema_2_{kind}.sql").read_text()
    if kind == "sqlite":
        raw = sqlite3.connect(url.removeprefix("sqlite:///"))
        raw.executescript(script)
        raw.close()
        Path(url.removeprefix("sqlite:///")).chmod(0o600)
        return url
    engine = sa.create_engine(url.replace("postgresql:", "postgresql+psycopg:"))
    with engine.begin() as db:
        db.exec_driver_sql(script.replace("%", "%%"))
    engine.dispose()
    return url


def upgraded(url: str) -> str:
    database = Database(of_schema_2(url), create=False, any_schema=True)
    upgrade_schema(database, 1, "anna")
    database.close()
    return url


def test_a_desk_leaves_an_older_store_alone_and_says_what_to_do(store_url: str):
    url = of_schema_2(store_url)
    with pytest.raises(
        StoreError, match="schema 2, expected 4: run `ground-station store upgrade`"
    ):
        Database(url)


def test_an_upgraded_store_has_the_tables_of_a_new_one_and_all_its_rows(store_url: str):
    database = Database(of_schema_2(store_url), create=False, any_schema=True)
    assert upgrade_schema(database, 1, "anna") == (2, tables.SCHEMA)
    assert upgrade_schema(database, 1, "anna") == (tables.SCHEMA, tables.SCHEMA)
    with database.read() as db:
        assert compare_metadata(MigrationContext.configure(db), tables.metadata) == []
    database.close()
    with opened(store_url) as store:
        assert states(store) == {
            "o1": OrderState.ASSIGNED,
            "o2": OrderState.ASSIGNED,
            "o3": OrderState.OPEN,
        }
        assert [row.state for row in store.assignments()] == [
            AssignmentState.IN_FLIGHT,
            AssignmentState.ORDERED,
        ]
        assert store.assign_order("o3", "d3", FLIGHT, None, "desk") == "o3.1"


def fail_at_the_end(*_: object) -> None:
    raise ZeroDivisionError


def test_an_upgrade_that_fails_half_way_leaves_the_store_as_it_was(store_url, monkeypatch):
    database = Database(of_schema_2(store_url), create=False, any_schema=True)
    monkeypatch.setattr(audit_steps, "add_entry", fail_at_the_end)
    with pytest.raises(ZeroDivisionError):
        upgrade_schema(database, 1, "anna")
    monkeypatch.undo()
    assert upgrade_schema(database, 1, "anna")[0] == 2
    database.close()


def ground_station(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, arguments)
    return done.exit_code, done.output + (str(done.exception) if done.exception else "")


def test_the_command_keeps_a_copy_of_the_store_as_it_was(tmp_path: Path):
    url = of_schema_2(f"sqlite:///{tmp_path}/d.db")
    code, said = ground_station(
        "store", "upgrade", "--store", url, "--backup", str(tmp_path / "old.db"), "--user", "anna"
    )
    assert (code, said.startswith("upgraded from schema 2 to 4")) == (0, True)
    with pytest.raises(StoreError, match="schema 2"):
        Database(f"sqlite:///{tmp_path}/old.db", create=False)
    assert ground_station("audit", "--verify", "--store", url)[0] == 0


def needs(program: str, url: str) -> None:
    if url.startswith("postgresql") and shutil.which(program) is None:
        pytest.skip(f"no {program} is installed")


def test_a_copy_that_is_put_back_is_the_store_as_it_was_and_nobody_is_launched_by_it(
    store_url: str, tmp_path: Path
):
    needs("pg_restore", store_url)
    needs("pg_dump", store_url)
    upgraded(store_url)
    copy, before = str(tmp_path / "copy"), tmp_path / "before"
    assert ground_station("store", "backup", copy, "--store", store_url)[0] == 0
    assert Path(copy).stat().st_mode & 0o777 == 0o600
    with opened(store_url) as store:
        assert store.assign_order("o3", "d3", FLIGHT, None, "desk")
    code, said = ground_station("store", "restore", copy, "--store", store_url)
    assert (code, "add --replace FILE" in said) == (1, True)
    restore = ("store", "restore", copy, "--store", store_url, "--user", "anna")
    code, said = ground_station(*restore, "--replace", str(before))
    assert code == 0, said
    assert before.exists()
    with opened(store_url) as store:
        assert states(store)["o3"] is OrderState.OPEN
        holds = store.holds_in_force()
        assert [(hold.scope, hold.by) for hold in holds] == [
            (ALL_DRONES, "anna"),
            (ALL_DRONES, "store restore"),
        ]
        assert store.assign_order("o3", "d3", FLIGHT, None, "desk") is None
    assert ground_station("store", "check", "--store", store_url)[0] == 0


def test_a_backup_of_a_store_that_is_being_written_has_what_only_the_log_holds(tmp_path: Path):
    """A plain copy of SQLite's file would lack the content of its write-ahead log."""
    url = upgraded(f"sqlite:///{tmp_path}/d.db")
    with opened(url) as store:
        assert store.assign_order("o3", "d3", FLIGHT, None, "desk")
        shutil.copy(tmp_path / "d.db", tmp_path / "plain.db")
        code, said = ground_station("store", "backup", f"{tmp_path}/copy.db", "--store", url)
        assert code == 0, said
    with opened(f"sqlite:///{tmp_path}/copy.db") as copy:
        assert "o3.1" in [row.id for row in copy.assignments()]
    assert _rows_of(tmp_path / "plain.db") != 3


def _rows_of(path: Path) -> int | None:
    """Count the assignments in a file; None if it is no store."""
    try:
        store = Store(Database(f"sqlite:///{path}", create=False), lambda: 1)
    except StoreError:
        return None
    with store.database.read() as db:
        count = db.execute(sa.select(sa.func.count()).select_from(tables.assignments)).scalar_one()
    store.close()
    return count


def test_a_damaged_file_is_not_put_into_the_place_of_a_store(tmp_path: Path):
    url, bad = f"sqlite:///{tmp_path}/d.db", tmp_path / "bad.db"
    with opened(url):
        pass
    bad.write_bytes((tmp_path / "d.db").read_bytes()[:6000])
    code, said = ground_station(
        "store", "restore", str(bad), "--store", url, "--replace", f"{tmp_path}/before.db"
    )
    assert code == 1
    assert "bad.db" in said
    assert ground_station("store", "check", "--store", url)[0] == 0


def test_check_names_an_open_file_and_a_broken_audit(tmp_path: Path):
    path = tmp_path / "d.db"
    upgraded(f"sqlite:///{path}")
    path.chmod(0o644)
    raw = sqlite3.connect(path)
    raw.executescript("UPDATE audit SET who = 'ben'")
    raw.close()
    code, said = ground_station("store", "check", "--store", f"sqlite:///{path}")
    assert code == 3
    assert "mode 0644, expected 0600" in said
    assert "audit: row 1: altered" in said
