"""The audit contains every action once and names altered entries."""

import sqlite3
import threading
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.fleet.messages import CommandStatus
from ground_station.adapters.login import operating_system_account_name
from ground_station.adapters.store import audit_steps
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.database import Database, StoreError
from ground_station.app.cli.main import app
from ground_station.core.people import audit_chain
from tests.ground_station.store.test_order_store import FLIGHT, an_order, flown, opened


def ground_station(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, arguments)
    return done.exit_code, done.output + (str(done.exception) if done.exception else "")


def deeds(url: str) -> list[tuple[str, str, str]]:
    database = Database(url)
    rows, _ = read_audit_rows_and_head(database)
    database.close()
    return [(row.entry.who, row.entry.deed, row.entry.subject) for row in rows]


def a_day(url: str) -> None:
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")], "anna")
        flown(store)


def test_every_command_to_a_vehicle_and_its_answer_are_in_it(store_url: str):
    a_day(store_url)
    assert deeds(store_url) == [
        ("anna", "take_orders", "o1 and 1 more"),
        ("desk", "assign", "d1: o1.1:assign"),
        ("d1", "answer", "o1.1:assign"),
        ("desk", "launch", "d1: o1.1:launch1"),
        ("d1", "answer", "o1.1:launch1"),
    ]


def test_every_writing_command_of_a_person_is_in_it_with_the_name(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    place = ["--lat=55", "--lon=8", "--alt=3", "--mass=0.4"]
    for command in (
        ["order", "add", "H-1", *place], ["order", "change", "H-1", "--phone=12"],
        ["order", "cancel", "H-1", "--reason=asked"],
        ["order", "settle", "H-1", "--back", "--reason", "found"],
        ["hold", "d1", "--reason=propeller"], ["release", "d1"],
    ):  # fmt: skip
        code, said = ground_station(*command, "--store", url, "--user", "anna")
        assert code == 0, said
    assert deeds(url) == [
        ("anna", "take_orders", "H-1"),
        ("anna", "change", "H-1"),
        ("anna", "order", "H-1"),
        ("anna", "settle", "H-1"),
        ("anna", "hold", "d1"),
        ("anna", "release", "d1"),
    ]
    assert ground_station("order", "cancel", "H-1", "--reason", "x", "--store", url)[0] == 0
    assert deeds(url)[-1][0] == operating_system_account_name()


def test_what_was_undone_is_not_in_it(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    a_day(url)
    before = deeds(url)

    def fail() -> None:
        with opened(url) as store, store.database.write() as db:
            audit_steps.add_entry(db, 1, "anna", "hold", "d1", "")
            db.exec_driver_sql("INSERT INTO nowhere VALUES (1)")

    with pytest.raises(StoreError):
        fail()
    assert deeds(url) == before


ALTERED = {
    "the name": ("UPDATE audit SET who = 'ben' WHERE n = 1", "row 1: altered"),
    "the answer": ("UPDATE audit SET answer = '' WHERE n = 3", "row 3: altered"),
    "the time": ("UPDATE audit SET at_us = at_us - 1 WHERE n = 2", "row 2: altered"),
    "a row gone": ("DELETE FROM audit WHERE n = 2", "row 3: follows row 1, expected row 2"),
    "the newest gone": (
        "DELETE FROM audit WHERE n = 5",
        "row 4: last row found, expected row 5",
    ),
    "two exchanged": (
        "UPDATE audit SET n = CASE n WHEN 2 THEN -3 WHEN 3 THEN -2 END WHERE n IN (2, 3);"
        "UPDATE audit SET n = -n WHERE n < 0",
        "row 2: altered",
    ),
}


@pytest.mark.parametrize("what", ALTERED)
def test_a_row_that_was_altered_is_named_by_verify(what: str, tmp_path: Path):
    path, (statement, words) = tmp_path / "d.db", ALTERED[what]
    url = f"sqlite:///{path}"
    a_day(url)
    code, said = ground_station("audit", "--verify", "--store", url)
    assert code == 0
    assert said.startswith("audit intact: 5 rows; the newest is ")
    raw = sqlite3.connect(path)
    raw.executescript(statement)
    raw.close()
    code, said = ground_station("audit", "--verify", "--store", url)
    assert code == 3
    assert words in said


def test_a_digest_kept_elsewhere_finds_a_shortened_and_a_rewritten_chain(tmp_path: Path):
    path = tmp_path / "d.db"
    url = f"sqlite:///{path}"
    a_day(url)
    _, said = ground_station("audit", "--verify", "--store", url)
    kept = said.split()[-1]
    assert ground_station("audit", "--verify", "--expect", kept, "--store", url)[0] == 0
    database = Database(url)
    rows, _ = read_audit_rows_and_head(database)
    database.close()
    entries = [row.entry for row in rows]
    for remaining in (entries[:4], [*entries[:4], entries[0]]):  # shortened; written anew
        chain = list(audit_chain.build_chained_rows(audit_chain.AuditHead(), remaining))
        head = audit_chain.AuditHead(chain[-1].n, chain[-1].digest)
        assert list(audit_chain.find_chain_faults(chain, head)) == []
        (fault,) = audit_chain.find_chain_faults(chain, head, kept)
        assert fault.startswith(f"no row has the digest {kept}")
    code, said = ground_station("audit", "--verify", "--expect", "abc", "--store", url)
    assert code != 0
    assert "expected 64 hexadecimal digits" in said


def test_escape_sequences_in_the_store_do_not_reach_the_terminal(tmp_path: Path):
    path = tmp_path / "d.db"
    a_day(f"sqlite:///{path}")
    raw = sqlite3.connect(path)
    raw.execute("UPDATE audit SET subject = ?", ("\x1b[31mred\x1b]0;title\x07\u202e[/x]",))
    raw.commit()
    raw.close()
    code, said = ground_station("audit", "--store", f"sqlite:///{path}")
    assert code == 0
    assert not set(said) & set("\x1b\x07\u202e")
    assert "[31mred" in said


def test_a_row_whose_digest_was_made_anew_does_not_fit_the_next_one(tmp_path: Path):
    path = tmp_path / "d.db"
    a_day(f"sqlite:///{path}")
    database = Database(f"sqlite:///{path}")
    rows, _ = read_audit_rows_and_head(database)
    entry = audit_chain.AuditEntry(1, "ben", "x", "hold", "d1", "")
    with database.write() as db:
        digest = audit_chain.row_digest(2, rows[0].digest, entry)
        db.exec_driver_sql(
            f"UPDATE audit SET at_us=1, who='ben', login='x', deed='hold', subject='d1',"
            f" answer='', digest='{digest}' WHERE n = 2"
        )
    found = list(audit_chain.find_chain_faults(*read_audit_rows_and_head(database)))
    database.close()
    assert found == ["row 3: does not match the present row 2"]


def test_without_the_chain_an_altered_row_would_not_be_noticed(tmp_path: Path, monkeypatch):
    path = tmp_path / "d.db"
    monkeypatch.setattr(audit_chain, "row_digest", lambda n, before, entry: "same")
    a_day(f"sqlite:///{path}")
    raw = sqlite3.connect(path)
    raw.executescript("UPDATE audit SET who = 'ben' WHERE n = 2; UPDATE audit SET before = 'same'")
    raw.executescript(f"UPDATE audit SET before = '{audit_chain.INITIAL_DIGEST}' WHERE n = 1")
    raw.close()
    code, _ = ground_station("audit", "--verify", "--store", f"sqlite:///{path}")
    assert code == 0


def test_two_desks_append_to_one_chain(store_url: str):
    count = 15

    def desk(name: str) -> None:
        with opened(store_url) as mine:
            for k in range(count):
                mine.add_orders_unless_conflict([an_order(f"{name}-{k}")], name)

    with opened(store_url):
        threads = [threading.Thread(target=desk, args=(name,)) for name in ("anna", "ben")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    database = Database(store_url)
    rows, head = read_audit_rows_and_head(database)
    database.close()
    assert [row.n for row in rows] == list(range(1, 2 * count + 1))
    assert list(audit_chain.find_chain_faults(rows, head)) == []


def test_a_command_that_nobody_answered_is_in_it_too(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        assert store.assign_order("o1", "d1", FLIGHT, None, "desk")
        assert store.cancel_command("o1.1:assign", "not answered in time")
        assert not store.record_and_apply_response("o1.1:assign", CommandStatus.DONE, "", "life")
    assert deeds(url)[-1] == ("desk", "give_up", "o1.1:assign")


@pytest.mark.parametrize("name", ["", "anna b", "[red]", "-x", "a" * 41, "anna\n"])
def test_a_name_that_could_be_mistaken_for_something_else_is_refused(name: str, tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url):
        pass
    code, said = ground_station("release", "d1", "--store", url, "--user", name or " ")
    assert code != 0
    assert "expected 1 to 40 letters" in said
