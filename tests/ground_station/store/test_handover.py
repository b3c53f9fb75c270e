"""A shift is handed over with notes, and accepted by another person."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.fleet.messages import EventKind, FleetEvent
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.shift.handover import accept_handover, hand_over, read_handover
from ground_station.app.cli.main import app
from ground_station.core.fleet.attention import AttentionLimits, FleetFacts, attention_items
from tests.ground_station.store.test_order_store import an_order, an_outcome, flown, opened


def test_only_another_person_accepts_a_shift_and_until_then_notes_are_kept(store_url):
    with opened(store_url) as store:
        database = store.database

        def titles() -> list[str]:
            facts = FleetFacts(handover=read_handover(database))
            return [item.title for item in attention_items(facts, AttentionLimits())]

        with pytest.raises(LeewayError, match="no hand-over waits"):
            accept_handover(database, lambda: 1, "ben")
        hand_over(database, lambda: 2, "anna", "d1: motor")
        hand_over(database, lambda: 3, "anna", "pad 2 is wet")
        assert titles() == ["anna has handed over the shift"]
        with pytest.raises(LeewayError, match="expected another person"):
            accept_handover(database, lambda: 4, "anna")
        assert accept_handover(database, lambda: 5, "ben") == "accepted by ben from anna"
        assert titles() == []
        with pytest.raises(LeewayError, match="no hand-over waits"):
            accept_handover(database, lambda: 6, "carl")
        found = read_handover(database)
        assert found is not None
        assert (found.accepted_by, found.accepted_us) == ("ben", 5)
        assert [note.text for note in found.notes] == ["d1: motor", "pad 2 is wet"]
        hand_over(database, lambda: 7, "ben", "calm")
        found = read_handover(database)
        assert found is not None
        assert [note.text for note in found.notes] == ["calm"]
        rows, _ = read_audit_rows_and_head(database)
        assert [(row.entry.who, row.entry.deed) for row in rows] == [
            ("anna", "hand_over"), ("anna", "hand_over"), ("ben", "accept_handover"),
            ("ben", "hand_over"),
        ]  # fmt: skip


def test_the_summary_states_what_flies_what_waits_what_is_held_and_by_whom(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"

    def run(*words: str) -> list[str]:
        done = CliRunner().invoke(app, ["handover", *words, "--store", url])
        assert done.exit_code == 0, done.output
        return done.output.splitlines()

    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        lost = flown(store)
        store.record_event_batches([([an_outcome(lost, "FAIL")], False)])
        store.add_orders_unless_conflict([an_order("o2"), an_order("o3")])
        id_ = flown(store, "o2", "d2")
        event = FleetEvent(
            vehicle="d2", log="m", seq=1, epoch_us=1, kind=EventKind.PHASE,
            text="deliver -> return: released", assignment=id_,
        )  # fmt: skip
        store.record_event_batches([([event], False)])
        HoldStore(store.database, lambda: 0).place_holds(["d4"], "propeller", "anna")
    first = run()
    assert first[:2] == ["in the air: d2 with o2, return", "1 open orders: o3"]
    assert first[2].startswith("stuck: o1: FAIL")
    assert first[3:] == ["hold: d4 is held by anna: propeller"]
    told = run("--note", "d1: in the sea", "--user", "anna")
    assert told[4].endswith("anna: d1: in the sea")
    assert told[5].endswith(": not accepted yet")
    assert run("--accept", "--user", "ben")[-1] == "accepted by ben from anna"
    assert "accepted by ben at" in run()[-1]
    bad = CliRunner().invoke(app, ["handover", "--accept", "--note", "x", "--store", url])
    assert "expected --note TEXT, or --accept" in str(bad.exception)
