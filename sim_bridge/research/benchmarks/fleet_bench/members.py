"""Members: the companion's fleet ports and zenoh links around a small state machine.

Without physics; one process runs many members.
"""

import json
import math
import os
import queue
import sys
import threading
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from companion.adapters.clock import wall_s
from companion.adapters.files.params import read_airframe
from companion.app.flight.fleet_port import STANDBY, FleetPort, StoredAssignment
from companion.core.pilot.telemetry_state import TelemetryState
from companion.fleet.command_log import CommandReply
from companion.fleet.membership import JoinOptions, Membership, read_membership
from companion.fleet.messages import Assign, Command, CommandStatus, EventKind, Launch
from companion.fleet.topics import VehicleKeys

STOP_POLL_S = 0.5
PUBLICATION_MARGIN_S = 0.005
"""Margin over the port's minimum publication interval of one second."""


@dataclass(slots=True)
class Member:
    """One vehicle: standby, ready, outbound for some seconds, and an outcome."""

    port: FleetPort
    flight_s: tuple[float, float]
    """Shortest and longest time in the air."""
    rng: np.random.Generator
    telemetry: TelemetryState
    state_interval_s: float
    phase: str = STANDBY
    landing_s: float = 0.0
    sent_phase: str = ""
    next_publication_s: float = 0.0
    flown: list[str] = field(default_factory=list)

    def update_and_return_next_call_time_s(self) -> float:
        """Process commands, land if due, publish the state; return the time of the next call."""
        self.port.process_commands(self._execute_command)
        if self.phase == "outbound" and wall_s() >= self.landing_s:
            self._record_landing()
        if self.phase != self.sent_phase or wall_s() >= self.next_publication_s:
            self.sent_phase = self.phase
            self.next_publication_s = wall_s() + self.state_interval_s + PUBLICATION_MARGIN_S
            self.port.publish_state_if_due(self.phase, self.telemetry)
        landing_s = self.landing_s if self.phase == "outbound" else math.inf
        return min(self.next_publication_s, landing_s)

    def _execute_command(self, command: Command) -> CommandReply:
        deed = command.action
        match deed:
            case Assign() if self.phase == STANDBY:
                self.port.store_assignment(
                    StoredAssignment(assignment=deed.assignment, order=deed.order)
                )
                self.phase = "ready"
            case Launch() if self.phase == "ready":
                self.flown.append(deed.assignment)
                self.phase = "outbound"
                self.landing_s = wall_s() + float(self.rng.uniform(*self.flight_s))
            case _:
                return CommandReply(CommandStatus.REFUSED, f"in phase {self.phase}")
        return CommandReply(CommandStatus.DONE, self.phase)

    def _record_landing(self) -> None:
        self.port.record_event(
            EventKind.OUTCOME, "landed", outcome="SUC", delivered=True, home=True
        )
        self.port.unload_assignment()
        self.phase = STANDBY


def run_members(
    fleet: str,
    first: int,
    count: int,
    config: str,
    folder: str,
    seed: int,
    flight_s: tuple[float, float],
    state_interval_s: float,
) -> None:
    """Print "loaded"; join after one input line; fly until end of input; print flown assignments.

    `config`: a network file, or a folder of identities. Messages wake their member.
    """
    numbers = range(first, first + count)
    joins: list[Membership] = []
    for number in numbers:
        keys, path = VehicleKeys(fleet, f"v{number}"), Path(config)
        identity = JoinOptions(path / keys.vehicle)
        joins.append(
            read_membership(keys, None, identity) if path.is_dir() else read_membership(keys, path)
        )
    print("loaded", flush=True)
    sys.stdin.readline()
    airframe = read_airframe("m100")
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
    members: list[Member] = []
    woken: queue.SimpleQueue[int] = queue.SimpleQueue()
    for number, membership in zip(numbers, joins, strict=True):
        name = f"v{number}"
        port = FleetPort.open(name, "m100", airframe, Path(folder) / name, membership.open_link)
        port.member.link.set_request_callback(partial(woken.put, len(members)))
        rng = np.random.default_rng([seed, number])
        members.append(Member(port, flight_s, rng, TelemetryState(), state_interval_s))
    update_members_until_stopped(stop, members, woken)
    print(json.dumps([x for member in members for x in member.flown]), flush=True)
    os._exit(0)


def update_members_until_stopped(
    stop: threading.Event, members: list[Member], woken_member_indices: queue.SimpleQueue[int]
) -> None:
    """Update each member when a message wakes it, and when it must publish or land."""
    next_call_s = [0.0] * len(members)
    while not stop.is_set():
        number = min(range(len(members)), key=next_call_s.__getitem__)
        rests_s = next_call_s[number] - wall_s()
        if rests_s > 0.0:
            try:
                number = woken_member_indices.get(timeout=min(rests_s, STOP_POLL_S))
            except queue.Empty:
                continue
        next_call_s[number] = members[number].update_and_return_next_call_time_s()
