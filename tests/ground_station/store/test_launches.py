"""Launches from a depot: one after the other by whichever desk, and by a person's word."""

import threading
from dataclasses import dataclass
from pathlib import Path

from typer.testing import CliRunner

from companion.fleet.messages import Answered, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store import order_steps
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.cli.main import app
from ground_station.app.desk.depot_dispatcher import DepotDispatcher
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.schema.orders import AssignmentRow
from tests.ground_station.store.test_holds import aboard
from tests.ground_station.store.test_order_store import an_order, opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


def ready(store: Store, count: int) -> list[str]:
    store.add_orders([an_order(f"o{k}") for k in range(count)])
    return [aboard(store, f"o{k}", f"d{k}") for k in range(count)]


def launched(store: Store) -> int:
    return sum(row.id.partition(":")[2].startswith("launch") for row in store.commands())


def both_desks_launch(url: str, ids: list[str], after: int) -> list[bool]:
    """Two desks that both saw the gap end launch a drone each at the same moment."""
    start, done = threading.Barrier(2), [False, False]

    def desk(number: int) -> None:
        with opened(url) as mine:
            start.wait()
            done[number] = mine.launch(ids[number], f"desk{number}", after=after)

    threads = [threading.Thread(target=desk, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return done


def test_safety_rule_7_two_desks_keep_one_gap_between_launches(store_url: str):
    with opened(store_url) as store:
        ids = ready(store, 4)
        assert sorted(both_desks_launch(store_url, ids[:2], store.newest_launch())) == [False, True]
        assert launched(store) == 1
        assert store.launch(ids[2], "desk", after=store.newest_launch())


def test_without_a_look_at_the_newest_launch_two_desks_would_launch_at_once(tmp_path, monkeypatch):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        ids = ready(store, 2)
        monkeypatch.setattr(order_steps, "newest_launch", lambda db: 0)
        assert both_desks_launch(url, ids, 0) == [True, True]


def test_safety_rule_1_a_word_for_a_launch_is_good_for_one(store_url: str):
    with opened(store_url) as store:
        (id_,) = ready(store, 1)
        assert not store.launch(id_, "desk", confirmed=True)
        assert store.confirm_launch("o0", "anna") == id_
        assert store.assignments()[0].confirmed_by == "anna"
        assert store.launch(id_, "desk", confirmed=True)
        assert store.confirm_launch("o0", "anna") is None  # its launch is under way
        assert store.answered(f"{id_}:launch1", Answered.REFUSED, "gusts", "life")
        assert not store.launch(id_, "desk", confirmed=True)


def test_a_word_that_nobody_asks_for_would_launch_without_one(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        assert store.launch(*ready(store, 1), "desk", confirmed=False)


def test_a_hold_takes_a_word_back_and_none_is_taken_while_it_is_in_force(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        (id_,) = ready(store, 1)
        holds = HoldStore(store.database, lambda: 1)
        assert store.confirm_launch("o0", "anna")
        holds.set(["d0"], "gusts", "ben")
        assert store.confirm_launch("o0", "anna") is None
        holds.release(["d0"], "ben")
        assert not store.launch(id_, "desk", confirmed=True)


@dataclass
class HandClock:
    """A desk's clock that is set by hand."""

    t_s: float

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return 1


def flying(row: AssignmentRow) -> State:
    return State(
        vehicle=row.vehicle, life="a", uptime_s=9.0, epoch_us=0, airframe="m100",
        max_payload_kg=1.0, phase="climb", log="l", last_seq=0, assignment=row.id, armed=True,
    )  # fmt: skip


def test_safety_rule_7_a_desk_waits_a_whole_gap_after_a_launch_of_another_one(tmp_path):
    """By its own clock, from when it saw it: the two clocks have nothing in common."""
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        ready(store, 2)
        clocks = HandClock(5.0), HandClock(9_000.0)
        ours, theirs = (
            DepotDispatcher(store, DAY, DepotAssigner(DAY.day, DAY.airframes), clock, len)
            for clock in clocks
        )
        ours.begin()
        theirs.begin()
        first, second = store.assignments(in_force=True)
        ours.on_ready(first)
        assert launched(store) == 1
        theirs.on_ready(second)
        clocks[1].t_s = 9_030.0  # ordered, and not flown yet
        theirs.on_ready(second)
        assert launched(store) == 1
        theirs.on_state(flying(first))
        for clocks[1].t_s in (9_030.0, 9_049.9):
            theirs.on_ready(second)
            assert launched(store) == 1
        clocks[1].t_s = 9_050.0
        theirs.on_ready(second)
        assert launched(store) == 2


def test_the_command_says_who_confirmed_or_why_not(tmp_path):
    url = f"sqlite:///{tmp_path}/d.db"

    def run(order: str) -> str:
        done = CliRunner().invoke(app, ["order", "launch", order, "--store", url, "--user", "anna"])
        return (done.output + str(done.exception or "")).strip()

    with opened(url) as store:
        ready(store, 1)
        assert run("o0") == "o0.1: confirmed by anna; it goes when its slot comes"
        assert run("o9") == "order o9: no drone has it"
        HoldStore(store.database, lambda: 1).set(["d0"], "gusts", "ben")
        assert run("o0") == "order o0: d0 is held by ben: gusts"
