"""Holds that come while a launch is on its way, from its transaction to the vehicle's answer."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from companion.fleet.messages import Answered, Command, Launch, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.exchange import RETRY_S
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    LivelinessChanged,
    StateReceived,
)
from ground_station.core.schema.orders import AssignmentState, CommandRow
from tests.ground_station.store.test_holds import aboard
from tests.ground_station.store.test_launches import HandClock
from tests.ground_station.store.test_order_store import an_order, opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


@dataclass
class Wire:
    """The desk's end of a network: what it hears is put here, what it sends is kept."""

    heard: list[Any] = field(default_factory=list)
    sent: list[Command] = field(default_factory=list)

    def receive(self, wait_s: float) -> list[Any]:
        found, self.heard = self.heard, []
        return found

    def ask_states(self, wait_s: float) -> None: ...
    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None: ...

    def neighbour_keys(self, fleet: str) -> dict[str, str]:
        del fleet
        return {}

    def tell_winds(self, winds: object) -> None:
        del winds

    def send(self, command: Command, wait_s: float) -> None:
        self.sent.append(command)

    def launches(self) -> list[str]:
        return [command.id for command in self.sent if isinstance(command.deed, Launch)]

    def close(self) -> None: ...


@dataclass
class Bench:
    """A desk whose drone d1 has o1 aboard and is ready; launches need no person's word."""

    store: Store
    wire: Wire
    desk: Desk
    clock: HandClock
    uptime_s: float = 0.0

    def hear(self, phase: str = "ready") -> None:
        self.uptime_s += 1.0
        self.wire.heard.append(StateReceived(a_state(phase, self.uptime_s)))

    def turn(self, phase: str = "ready") -> None:
        self.hear(phase)
        self.desk.exchange.changed = True
        self.desk.turn(0.0)

    def no_answer(self) -> None:
        self.wire.heard.append(CommandAnswered(self.wire.sent[-1].id, None))

    @property
    def holds(self) -> HoldStore:
        return HoldStore(self.store.database, lambda: 1)


def a_state(phase: str, uptime_s: float) -> State:
    return State(
        vehicle="d1", life="a", uptime_s=uptime_s, epoch_us=0, airframe="m100",
        max_payload_kg=1.0, phase=phase, log="l", last_seq=0, assignment="o1.1", armed=False,
    )  # fmt: skip


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        store.add_orders([an_order("o1")])
        assert aboard(store) == "o1.1"
        wire, params = Wire(), DepotParams(assigns=False, launch_gap_s=0.0)
        clock = HandClock(100.0)
        desk = open_depot_desk(DAY, store, wire, lambda words: None, params, clock=clock)
        wire.heard.append(LivelinessChanged("d1", "a", up=True))
        yield Bench(store, wire, desk, clock)


def holding_behind_the_outbox(monkeypatch: pytest.MonkeyPatch, bench: Bench) -> None:
    """The hold comes just when the desk has read what it is about to send."""
    read = Store.outbox

    def outbox(self: Store) -> list[CommandRow]:
        rows = read(self)
        if rows and not bench.store.holds():
            bench.holds.set(["d1"], "gusts", "anna")
        return rows

    monkeypatch.setattr(Store, "outbox", outbox)


@pytest.mark.parametrize("guarded", [True, False], ids=["not sent", "canary: sent"])
def test_safety_rule_1_a_hold_between_the_transaction_and_the_sending_stops_the_launch(
    bench, monkeypatch, guarded
):
    holding_behind_the_outbox(monkeypatch, bench)
    if not guarded:
        monkeypatch.setattr(Store, "may_send_launch", lambda self, row: True)
    bench.turn()
    assert bench.store.holds()
    assert bench.wire.launches() == ([] if guarded else ["o1.1:launch1"])


@pytest.mark.parametrize("guarded", [True, False], ids=["not sent", "canary: sent"])
def test_safety_rule_1_a_launch_without_an_answer_is_not_repeated_under_a_hold(
    bench, monkeypatch, guarded
):
    bench.turn()
    assert bench.wire.launches() == ["o1.1:launch1"]
    if not guarded:
        monkeypatch.setattr(Store, "may_send_launch", lambda self, row: True)
    bench.holds.set(["d1"], "gusts", "anna")
    bench.no_answer()
    bench.turn()
    bench.clock.t_s += RETRY_S
    bench.turn()
    assert len(bench.wire.launches()) == (1 if guarded else 2)


def test_after_a_release_the_desk_decides_anew_in_a_launch_of_its_own(bench):
    bench.turn()
    bench.holds.set(["d1"], "gusts", "anna")
    bench.no_answer()
    bench.turn()
    bench.holds.release(["d1"], "anna")
    bench.turn()
    assert bench.wire.launches() == ["o1.1:launch1", "o1.1:launch2"]


def test_a_drone_that_took_off_before_the_hold_counts_as_flying(bench):
    bench.turn()
    bench.holds.set(["d1"], "gusts", "anna")
    bench.turn("outbound")
    (row,) = bench.store.assignments()
    assert row.state is AssignmentState.FLYING
    assert bench.wire.launches() == ["o1.1:launch1"]
    assert bench.store.commands_of("o1.1")[-1].answer is Answered.DONE
