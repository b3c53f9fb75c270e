"""Launches from the depot while the network delays commands: the gap applies to take-offs."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from companion.fleet import command_log
from companion.fleet.command_log import CommandLog, CommandReply
from companion.fleet.messages import Command, CommandStatus, Launch, Result, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.settle import close_order_with_outcome
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.launch_pacing import LaunchPacing
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    LivelinessChanged,
    StateReceived,
)
from ground_station.core.schema.order_states import ParcelOutcome
from tests.ground_station.desk_parts import HandClock, Wire, a_state
from tests.ground_station.store.test_holds import aboard
from tests.ground_station.store.test_order_store import an_order, opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
GAP_S = 10.0
CLIMB_S = 3.0
"""Time from the execution of a launch to the take-off."""

HOUR_S = 3600.0


class Fleet:
    """Desks with five ready vehicles on a network that delays commands and replies.

    The vehicles' clocks are an hour ahead of the desks'. `delay_s` draws a command's delay.
    """

    def __init__(self, store: Store, desks: int = 1) -> None:
        self.store, self.clock = store, HandClock(100.0)
        self.wires, self.desks = [Wire() for _ in range(desks)], list[Desk]()
        self.names = [f"d{n}" for n in range(1, 6)]
        orders = [f"o{n}" for n in range(1, 6)]
        store.add_orders_unless_conflict([an_order(order) for order in orders])
        pairs = zip(orders, self.names, strict=True)
        self.assignments = {name: aboard(store, order, name) for order, name in pairs}
        self.logs = {name: CommandLog() for name in self.names}
        self.reported: list[str] = []
        self.rng = np.random.default_rng(7)
        self.delivers, self.delay_s = True, (0.0, 0.0)
        self.started_s: dict[str, float] = {}
        self.in_transit: list[tuple[float, Wire, Command]] = []
        self.sent: list[Command] = []
        self.silent: set[str] = set()
        for index in range(desks):
            self.start_desk(index)

    def start_desk(self, index: int) -> None:
        params = DepotParams(f"desk{index}", assigns_orders=False, launch_gap_s=GAP_S)
        wire = self.wires[index]
        desk = open_depot_desk(
            DAY, self.store, wire, self.reported.append, params, clock=self.clock
        )
        self.desks[index : index + 1] = [desk]
        desk.start_dispatching()
        wire.heard += [LivelinessChanged(name, "a", has_joined=True) for name in self.names]

    def second(self) -> None:
        """Advance one second: vehicles process what arrives and report, then the desks decide."""
        self.clock.t_s += 1.0
        now_s = self.clock.t_s
        for wire in self.wires:
            for command in wire.sent:
                self.sent.append(command)
                at_s = now_s + float(self.rng.uniform(*self.delay_s))
                self.in_transit.append((at_s, wire, command))
            wire.sent.clear()
        due = [item for item in self.in_transit if self.delivers and item[0] <= now_s]
        self.in_transit = [item for item in self.in_transit if item not in due]
        for index in self.rng.permutation(len(due)):
            self.execute(*due[index][1:])
        for name in self.names:
            if name not in self.silent:
                for wire in self.wires:
                    wire.heard.append(StateReceived(self.state(name)))
        for desk in self.desks:
            desk.exchange.changed = True
            desk.run_cycle(0.0)

    def execute(self, wire: Wire, command: Command) -> None:
        name, log, uptime_s = command.vehicle, self.logs[command.vehicle], self.clock.t_s + HOUR_S
        reply = log.reply_without_execution_or_none(command, "a", uptime_s)
        if reply is None:
            reply = CommandReply(CommandStatus.DONE)
            if isinstance(command.action, Launch):
                self.started_s.setdefault(name, self.clock.t_s)
            log.record_final_reply_or_remove_command(command, reply)
        result = Result(id=command.id, vehicle=name, instance_id="a", status=reply.status)
        if name not in self.silent:
            wire.heard.append(CommandResponse(command.id, result))

    def state(self, name: str) -> State:
        started_s, now_s = self.started_s.get(name), self.clock.t_s
        flies = started_s is not None and now_s - started_s >= CLIMB_S
        phase = "ready" if started_s is None else "outbound" if flies else "arm"
        here = {"assignment": self.assignments[name], "uptime_s": now_s + HOUR_S}
        height_m = 30.0 if flies else 0.0
        return a_state(name, phase=phase, armed=phase != "ready", height_rel_m=height_m, **here)

    def run(self, seconds: int) -> None:
        for _ in range(seconds):
            self.second()

    def take_offs_s(self) -> list[float]:
        return sorted(at_s + CLIMB_S for at_s in self.started_s.values())

    def unanswered(self) -> list[str]:
        return [row.id for row in self.store.outbox() if isinstance(row.command, Launch)]

    def least_gap_s(self) -> float:
        return min(later - earlier for earlier, later in pairwise(self.take_offs_s()))


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        yield Fleet(store)


@pytest.fixture
def two_desks(tmp_path: Path) -> Iterator[Fleet]:
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        yield Fleet(store, desks=2)


def test_safety_rule_7_commands_that_arrive_together_are_no_volley_of_take_offs(fleet: Fleet):
    fleet.delivers = False
    fleet.run(55)
    assert len(fleet.unanswered()) == 1
    fleet.delivers = True
    fleet.run(150)
    assert len(fleet.take_offs_s()) == 5
    assert fleet.least_gap_s() >= GAP_S


def test_without_the_validity_on_board_commands_from_long_ago_would_start_a_volley(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(command_log, "reply_outside_launch_window", lambda *given: None)
    fleet.delivers = False
    fleet.run(55)
    fleet.delivers = True
    fleet.run(150)
    assert fleet.least_gap_s() < GAP_S


@pytest.mark.parametrize("seed", range(4))
def test_safety_rule_7_two_desks_keep_the_gap_while_commands_are_late_and_out_of_order(
    two_desks: Fleet, seed: int
):
    fleet, fleet.rng = two_desks, np.random.default_rng(seed)
    fleet.delay_s = (0.0, 25.0)
    for _ in range(10):
        fleet.run(40)
        fleet.start_desk(int(fleet.rng.integers(2)))  # a restart, perhaps with a pending launch
    assert len(fleet.take_offs_s()) >= 3
    assert fleet.least_gap_s() >= GAP_S


def test_without_the_wait_for_unanswered_launches_late_commands_would_break_the_gap(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(LaunchPacing, "_may_still_take_off", lambda pacing, row: False)
    fleet.delivers = False
    fleet.run(14)
    fleet.delivers = True
    fleet.run(150)
    assert fleet.least_gap_s() < GAP_S


def test_a_launch_is_sent_again_as_it_was_and_a_later_one_has_another_id(fleet: Fleet):
    fleet.delivers = False
    fleet.run(60)
    launches = {c.id: c for c in fleet.sent if isinstance(c.action, Launch)}
    assert len(launches) >= 2
    assert all(launches[c.id] == c for c in fleet.sent if c.id in launches)


def test_the_gap_begins_with_the_take_off_and_not_with_the_order(fleet: Fleet):
    fleet.run(120)
    assert len(fleet.take_offs_s()) == 5
    assert fleet.least_gap_s() >= GAP_S + CLIMB_S - 1.0


def test_safety_rule_7_a_take_off_by_another_persons_hand_starts_the_gap(fleet: Fleet):
    fleet.desks[0].dispatcher.prepare_first_cycle()
    stray = a_state("d9", phase="standby", armed=True, height_rel_m=3.0)
    fleet.wires[0].heard.append(StateReceived(stray))
    fleet.run(int(GAP_S) - 1)
    assert not fleet.sent
    fleet.run(20)
    assert fleet.take_offs_s()


def test_a_vehicle_that_falls_silent_with_its_launch_blocks_until_a_person_settles_it(
    fleet: Fleet,
):
    fleet.delivers = False
    fleet.run(3)
    first = fleet.unanswered()[0].partition(".")[0]
    fleet.silent.add(first.replace("o", "d"))
    fleet.run(600)
    assert len(fleet.unanswered()) == 1
    (said,) = [words for words in fleet.reported if "has not taken off" in words]
    assert f"order settle {first}" in said
    database, parcel = fleet.store.database, ParcelOutcome.BACK
    assert close_order_with_outcome(database, lambda: 1, first, parcel, "on its pad", "anna")
    fleet.delivers = True
    fleet.run(120)
    assert len(fleet.take_offs_s()) == 4
    assert fleet.least_gap_s() >= GAP_S


def test_a_restarted_desk_still_waits_for_a_launch_under_way(fleet: Fleet):
    fleet.delivers = False
    fleet.run(5)
    fleet.start_desk(0)
    fleet.run(40)
    assert len(fleet.unanswered()) == 1
