"""Launches from a depot: one at a time for all desks, and with a person's confirmation."""

import threading
from pathlib import Path

from typer.testing import CliRunner

from companion.fleet.messages import CommandStatus
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store import order_steps
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.launch_store import newest_launch_command_number
from ground_station.adapters.store.order_store import Store
from ground_station.app.cli.main import app
from ground_station.app.desk.depot_dispatcher import DepotDispatcher
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from tests.ground_station.desk_parts import HandClock, a_state
from tests.ground_station.store.test_holds import aboard, left_desk
from tests.ground_station.store.test_order_store import an_order, opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


def ready(store: Store, count: int) -> list[str]:
    store.add_orders_unless_conflict([an_order(f"o{k}") for k in range(count)])
    return [aboard(store, f"o{k}", f"d{k}") for k in range(count)]


def launched(store: Store) -> int:
    return sum(row.id.partition(":")[2].startswith("launch") for row in store.commands())


def both_desks_launch(url: str, ids: list[str], after: int) -> list[bool]:
    """Two desks launch one drone each at the moment when both see the gap end."""
    start, done = threading.Barrier(2), [False, False]

    def desk(number: int) -> None:
        with opened(url) as mine:
            start.wait()
            done[number] = mine.launch(ids[number], f"desk{number}", newest_known_launch=after)

    threads = [threading.Thread(target=desk, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return done


def test_safety_rule_7_two_desks_keep_one_gap_between_launches(store_url: str):
    with opened(store_url) as store:
        ids = ready(store, 4)
        assert sorted(
            both_desks_launch(store_url, ids[:2], newest_launch_command_number(store.database))
        ) == [False, True]
        assert launched(store) == 1
        assert store.launch(
            ids[2], "desk", newest_known_launch=newest_launch_command_number(store.database)
        )


def test_without_a_look_at_the_newest_launch_two_desks_would_launch_at_once(tmp_path, monkeypatch):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        ids = ready(store, 2)
        monkeypatch.setattr(order_steps, "newest_launch", lambda db: 0)
        assert both_desks_launch(url, ids, 0) == [True, True]


def test_safety_rule_1_a_word_for_a_launch_is_good_for_one(store_url: str):
    with opened(store_url) as store:
        (id_,) = ready(store, 1)
        assert not store.launch(id_, "desk", requires_confirmation=True)
        assert store.record_launch_confirmation("o0", "anna") == id_
        assert store.assignments()[0].confirmed_by == "anna"
        assert store.launch(id_, "desk", requires_confirmation=True)
        assert store.record_launch_confirmation("o0", "anna") is None  # its launch is in progress
        assert store.record_and_apply_response(
            f"{id_}:launch1", CommandStatus.REFUSED, "gusts", "life"
        )
        assert not store.launch(id_, "desk", requires_confirmation=True)


def test_a_word_that_nobody_asks_for_would_launch_without_one(store):
    assert store.launch(*ready(store, 1), "desk", requires_confirmation=False)


def test_a_hold_takes_a_word_back_and_none_is_taken_while_it_is_in_force(store):
    (id_,) = ready(store, 1)
    holds = HoldStore(store.database, lambda: 1)
    assert store.record_launch_confirmation("o0", "anna")
    holds.place_holds(["d0"], "gusts", "ben")
    assert store.record_launch_confirmation("o0", "anna") is None
    holds.clear_holds(["d0"], "ben")
    assert not store.launch(id_, "desk", requires_confirmation=True)


def test_safety_rule_7_a_desk_waits_a_whole_gap_after_a_launch_of_another_one(store):
    """By its own clock, from the time it saw the launch: the two clocks are unrelated."""
    ready(store, 2)
    clocks = HandClock(5.0), HandClock(9_000.0)
    ours, theirs = (
        DepotDispatcher(store, DAY, DepotAssigner(DAY.day, DAY.airframes), clock, len)
        for clock in clocks
    )
    ours.prepare_first_cycle()
    theirs.prepare_first_cycle()
    first, second = store.assignments(in_force=True)
    ours.on_vehicle_ready(first)
    assert launched(store) == 1
    assert left_desk(store, store.outbox()[0])
    theirs.on_vehicle_ready(second)
    clocks[1].t_s = 9_030.0  # ordered, not yet airborne
    theirs.on_vehicle_ready(second)
    assert launched(store) == 1
    theirs.on_state(a_state(first.vehicle, phase="climb", assignment=first.id, armed=True))
    for clocks[1].t_s in (9_030.0, 9_049.9):
        theirs.on_vehicle_ready(second)
        assert launched(store) == 1
    clocks[1].t_s = 9_050.0
    theirs.on_vehicle_ready(second)
    assert launched(store) == 2


def test_the_gap_of_a_desk_counts_from_its_own_launch_not_from_the_next_request(store):
    ready(store, 2)
    clock = HandClock(5.0)
    desk = DepotDispatcher(store, DAY, DepotAssigner(DAY.day, DAY.airframes), clock, len)
    desk.prepare_first_cycle()
    first, second = store.assignments(in_force=True)
    desk.on_vehicle_ready(first)
    desk.on_state(a_state(first.vehicle, phase="climb", assignment=first.id, armed=True))
    for clock.t_s, launches in ((24.9, 1), (25.1, 2)):
        desk.on_vehicle_ready(second)
        assert launched(store) == launches


def test_the_command_says_who_confirmed_or_why_not(tmp_path):
    url = f"sqlite:///{tmp_path}/d.db"

    def run(order: str) -> str:
        done = CliRunner().invoke(app, ["order", "launch", order, "--store", url, "--user", "anna"])
        return (done.output + str(done.exception or "")).strip()

    with opened(url) as store:
        ready(store, 1)
        assert run("o0").startswith("o0: launch confirmed by anna; it launches when the gap")
        assert run("o9") == "order o9: no drone is assigned"
        HoldStore(store.database, lambda: 1).place_holds(["d0"], "gusts", "ben")
        assert run("o0") == "order o0: d0 is held by ben: gusts"
