"""Holds placed while a launch is in progress, from its transaction to the vehicle's reply."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from companion.fleet.messages import CommandStatus
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk import exchange
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.exchange import RETRY_DELAY_S
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    LivelinessChanged,
    StateReceived,
)
from ground_station.core.schema.orders import AssignmentState, CommandRow
from tests.ground_station.desk_parts import HandClock, Wire, a_state
from tests.ground_station.store.test_holds import aboard
from tests.ground_station.store.test_order_store import an_order, opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


@dataclass
class Bench:
    """A desk whose drone d1 has loaded o1 and is ready; launches need no confirmation."""

    store: Store
    wire: Wire
    desk: Desk
    clock: HandClock
    uptime_s: float = 0.0

    def hear(self, phase: str = "ready") -> None:
        self.uptime_s += 1.0
        state = a_state(uptime_s=self.uptime_s, phase=phase, assignment="o1.1", armed=False)
        self.wire.heard.append(StateReceived(state))

    def turn(self, phase: str = "ready") -> None:
        self.hear(phase)
        self.desk.exchange.changed = True
        self.desk.run_cycle(0.0)

    def no_answer(self) -> None:
        self.wire.heard.append(CommandResponse(self.wire.sent[-1].id, None))

    @property
    def holds(self) -> HoldStore:
        return HoldStore(self.store.database, lambda: 1)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        store.add_orders_unless_conflict([an_order("o1")])
        assert aboard(store) == "o1.1"
        wire, params = Wire(), DepotParams(assigns_orders=False, launch_gap_s=0.0)
        clock = HandClock(100.0)
        desk = open_depot_desk(DAY, store, wire, lambda words: None, params, clock=clock)
        wire.heard.append(LivelinessChanged("d1", "a", has_joined=True))
        yield Bench(store, wire, desk, clock)


def holding_behind_the_outbox(monkeypatch: pytest.MonkeyPatch, bench: Bench) -> None:
    """Place the hold right after the desk has read the commands that it will send."""
    read = Store.outbox

    def outbox(self: Store) -> list[CommandRow]:
        rows = read(self)
        if rows and not bench.store.holds_in_force():
            bench.holds.place_holds(["d1"], "gusts", "anna")
        return rows

    monkeypatch.setattr(Store, "outbox", outbox)


@pytest.mark.parametrize("guarded", [True, False], ids=["not sent", "canary: sent"])
def test_safety_rule_1_a_hold_between_the_transaction_and_the_sending_stops_the_launch(
    bench, monkeypatch, guarded
):
    holding_behind_the_outbox(monkeypatch, bench)
    if not guarded:
        monkeypatch.setattr(exchange, "stamp_and_mark_launch_sent", lambda db, row, window: window)
    bench.turn()
    assert bench.store.holds_in_force()
    assert bench.wire.launches() == ([] if guarded else ["o1.1:launch1"])


@pytest.mark.parametrize("guarded", [True, False], ids=["not sent", "canary: sent"])
def test_safety_rule_1_a_launch_without_an_answer_is_not_repeated_under_a_hold(
    bench, monkeypatch, guarded
):
    bench.turn()
    assert bench.wire.launches() == ["o1.1:launch1"]
    if not guarded:
        monkeypatch.setattr(exchange, "stamp_and_mark_launch_sent", lambda db, row, window: window)
    bench.holds.place_holds(["d1"], "gusts", "anna")
    bench.no_answer()
    bench.turn()
    bench.clock.t_s += RETRY_DELAY_S
    bench.turn()
    assert len(bench.wire.launches()) == (1 if guarded else 2)


def test_after_a_release_the_desk_decides_anew_in_a_launch_of_its_own(bench):
    bench.turn()
    bench.holds.place_holds(["d1"], "gusts", "anna")
    bench.no_answer()
    bench.turn()
    bench.holds.clear_holds(["d1"], "anna")
    bench.turn()
    assert bench.wire.launches() == ["o1.1:launch1", "o1.1:launch2"]


def test_a_drone_that_took_off_before_the_hold_counts_as_flying(bench):
    bench.turn()
    bench.holds.place_holds(["d1"], "gusts", "anna")
    bench.turn("outbound")
    (row,) = bench.store.assignments()
    assert row.state is AssignmentState.IN_FLIGHT
    assert bench.wire.launches() == ["o1.1:launch1"]
    assert bench.store.commands_of_assignment("o1.1")[-1].response is CommandStatus.DONE
