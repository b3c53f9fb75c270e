"""Launches from the depot while the network delays commands: the gap applies to take-offs."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from companion.fleet.messages import Command, CommandStatus, Launch, Result, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    LivelinessChanged,
    StateReceived,
)
from tests.ground_station.desk_parts import HandClock, Wire, a_state
from tests.ground_station.store.test_holds import aboard
from tests.ground_station.store.test_order_store import an_order, opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
GAP_S = 10.0
CLIMB_S = 3.0
"""Time from the arrival of a launch command to the take-off."""


class Fleet:
    """A desk with five ready vehicles on a network that can delay commands."""

    def __init__(self, store: Store) -> None:
        self.store, self.wire, self.clock = store, Wire(), HandClock(100.0)
        self.names = [f"d{n}" for n in range(1, 6)]
        orders = [f"o{n}" for n in range(1, 6)]
        store.add_orders_unless_conflict([an_order(order) for order in orders])
        pairs = zip(orders, self.names, strict=True)
        self.assignments = {name: aboard(store, order, name) for order, name in pairs}
        params = DepotParams(assigns_orders=False, launch_gap_s=GAP_S)
        self.reported: list[str] = []
        self.desk = open_depot_desk(
            DAY, store, self.wire, self.reported.append, params, clock=self.clock
        )
        for name in self.names:
            self.wire.heard.append(LivelinessChanged(name, "a", has_joined=True))
        self.delivers = True
        self.arrived_s: dict[str, float] = {}
        self.kept_back: list[Command] = []
        self.silent: set[str] = set()

    def second(self) -> None:
        """Advance one second: vehicles process what arrives and report, then the desk decides."""
        self.clock.t_s += 1.0
        now_s = self.clock.t_s
        self.kept_back += [c for c in self.wire.sent if isinstance(c.action, Launch)]
        self.wire.sent.clear()
        for command in self.kept_back if self.delivers else []:
            self.arrived_s.setdefault(command.vehicle, now_s)
            done = Result(
                id=command.id, vehicle=command.vehicle, instance_id="a", status=CommandStatus.DONE
            )
            self.wire.heard.append(CommandResponse(command.id, done))
        if self.delivers:
            self.kept_back.clear()
        for name in self.names:
            if name not in self.silent:
                self.wire.heard.append(StateReceived(self._state(name, now_s)))
        self.desk.exchange.changed = True
        self.desk.run_cycle(0.0)

    def _state(self, name: str, now_s: float) -> State:
        flies = now_s - self.arrived_s.get(name, now_s) >= CLIMB_S
        phase, assignment = "outbound" if flies else "ready", self.assignments[name]
        return a_state(name, uptime_s=now_s, phase=phase, assignment=assignment, armed=flies)

    def run(self, seconds: int) -> None:
        for _ in range(seconds):
            self.second()

    def take_offs_s(self) -> list[float]:
        return sorted(at_s + CLIMB_S for at_s in self.arrived_s.values())

    def unanswered(self) -> list[str]:
        return [row.id for row in self.store.outbox() if isinstance(row.command, Launch)]


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        yield Fleet(store)


def gaps_s(fleet: Fleet) -> list[float]:
    times = fleet.take_offs_s()
    return [later - earlier for earlier, later in pairwise(times)]


def test_safety_rule_7_commands_that_arrive_together_are_no_volley_of_take_offs(fleet: Fleet):
    fleet.delivers = False
    fleet.run(55)
    assert len(fleet.unanswered()) == 1
    fleet.delivers = True
    fleet.run(120)
    assert len(fleet.take_offs_s()) == 5
    assert min(gaps_s(fleet)) >= GAP_S


def test_the_gap_begins_with_the_take_off_and_not_with_the_order(fleet: Fleet):
    fleet.run(120)
    assert len(fleet.take_offs_s()) == 5
    assert min(gaps_s(fleet)) >= GAP_S + CLIMB_S - 1.0


@pytest.mark.sample
def test_a_vehicle_that_falls_silent_with_its_launch_blocks_until_it_can_no_longer_take_off(
    fleet: Fleet,
):
    fleet.delivers = False
    fleet.run(5)
    first = fleet.unanswered()[0].partition(".")[0].replace("o", "d")
    fleet.silent.add(first)
    fleet.run(250)
    assert len(fleet.unanswered()) == 1
    assert sum("has not taken off" in words for words in fleet.reported) == 1
    fleet.delivers = True
    fleet.run(120)
    assert len(fleet.take_offs_s()) >= 2


def test_a_restarted_desk_still_waits_for_a_launch_under_way(fleet: Fleet):
    fleet.delivers = False
    fleet.run(5)
    params = DepotParams(assigns_orders=False, launch_gap_s=GAP_S)
    fleet.desk = open_depot_desk(
        DAY, fleet.store, fleet.wire, fleet.reported.append, params, clock=fleet.clock
    )
    fleet.desk.start_dispatching()
    for name in fleet.names:
        fleet.wire.heard.append(LivelinessChanged(name, "a", has_joined=True))
    fleet.run(40)
    assert len(fleet.unanswered()) == 1
