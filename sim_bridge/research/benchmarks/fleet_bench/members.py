"""Members: the companion's own fleet ports and zenoh links around a small state machine.

No physics; a process for many.
"""

import heapq
import json
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
from companion.app.flight.fleet_port import STANDBY, Assigned, FleetPort
from companion.core.mission.events import Position
from companion.core.pilot.telemetry_state import TelemetryState
from companion.fleet.command_log import Verdict
from companion.fleet.membership import JoinOptions, Membership, join
from companion.fleet.messages import Answered, Assign, Command, EventKind, Launch
from companion.fleet.topics import VehicleKeys

STOP_LOOK_S = 0.5
SLACK_S = 0.005
"""The port tells nothing sooner than a second after it told last."""


@dataclass(frozen=True, slots=True)
class AirTimes:
    """How long each is in the air: drawn between these."""

    seed: int
    least_s: float
    most_s: float

    def drawn_s(self, rng: np.random.Generator) -> float:
        """One flight's."""
        return float(rng.uniform(self.least_s, self.most_s))


@dataclass(slots=True)
class Member:
    """One vehicle: standby, ready, outbound for some seconds, and an outcome."""

    port: FleetPort
    flights: AirTimes
    rng: np.random.Generator
    telemetry: TelemetryState
    tells_every_s: float
    phase: str = STANDBY
    lands_s: float = 0.0
    told_phase: str = ""
    tells_s: float = 0.0
    flown: list[str] = field(default_factory=list)

    def turn(self) -> float:
        """Answer, land when it is time, tell the state; when to look again at the latest."""
        self.port.turn(self._carry_out)
        if self.phase == "outbound" and wall_s() >= self.lands_s:
            self._land()
        if self.phase != self.told_phase or wall_s() >= self.tells_s:
            self.told_phase, self.tells_s = self.phase, wall_s() + self.tells_every_s + SLACK_S
            self.port.publish(self.phase, self.telemetry)
        return min(self.tells_s, self.lands_s) if self.phase == "outbound" else self.tells_s

    def _carry_out(self, command: Command) -> Verdict:
        deed = command.deed
        match deed:
            case Assign() if self.phase == STANDBY:
                self.port.take_aboard(Assigned(assignment=deed.assignment, order=deed.order))
                self.phase = "ready"
            case Launch() if self.phase == "ready":
                self.flown.append(deed.assignment)
                self.phase, self.lands_s = "outbound", wall_s() + self.flights.drawn_s(self.rng)
            case _:
                return Verdict(Answered.REFUSED, f"in phase {self.phase}")
        return Verdict(Answered.DONE, self.phase)

    def _land(self) -> None:
        self.port.tell(EventKind.OUTCOME, "landed", outcome="SUC", delivered=True, home=True)
        self.port.put_ashore()
        self.phase = STANDBY


def _membership(keys: VehicleKeys, config: Path) -> Membership:
    if config.is_dir():
        return join(keys, None, JoinOptions(config / keys.vehicle))
    return join(keys, config)


def read_stands(file: str | None) -> list[tuple[float, float]]:
    """Where each member stands, by its number, degrees; none are told without a file."""
    return [] if file is None else json.loads(Path(file).read_text())


def _telemetry(stands: list[tuple[float, float]], number: int) -> TelemetryState:
    """What it tells of its place."""
    if not stands:
        return TelemetryState()
    lat_deg, lon_deg = stands[number]
    return TelemetryState(position=Position(0.0, lat_deg, lon_deg, 0.0, 0.0, 0.0, 0.0, 0.0))


def serve(
    fleet: str,
    numbers: range,
    config_file: Path,
    folder: Path,
    flights: AirTimes,
    states_every_s: float,
    stands: list[tuple[float, float]],
) -> None:
    """Say that all is loaded; join at a word; fly until standard input ends, then tell what was
    flown. `config_file`: a network file, or a folder with the identities of all. As in a companion,
    what comes for a member wakes it.
    """
    joins = [_membership(VehicleKeys(fleet, f"v{number}"), config_file) for number in numbers]
    print("loaded", flush=True)
    sys.stdin.readline()
    airframe = read_airframe("m100")
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
    members: list[Member] = []
    woken: queue.SimpleQueue[int] = queue.SimpleQueue()
    for number, membership in zip(numbers, joins, strict=True):
        name = f"v{number}"
        port = FleetPort.open(name, "m100", airframe, folder / name, membership.open_link)
        port.link.be_woken(partial(woken.put, len(members)))
        rng = np.random.default_rng([flights.seed, number])
        members.append(Member(port, flights, rng, _telemetry(stands, number), states_every_s))
    turn_until(stop, members, woken)
    print(json.dumps([x for member in members for x in member.flown]), flush=True)
    os._exit(0)


def turn_until(stop: threading.Event, members: list[Member], woken: queue.SimpleQueue[int]) -> None:
    """Each when it is woken, and when it has to tell or to land."""
    at_s = [0.0] * len(members)
    waiting = [(0.0, number) for number in range(len(members))]
    while not stop.is_set():
        number = _next(waiting, at_s, woken)
        if number is None:
            continue
        at_s[number] = members[number].turn()
        heapq.heappush(waiting, (at_s[number], number))


def _next(
    waiting: list[tuple[float, int]], at_s: list[float], woken: queue.SimpleQueue[int]
) -> int | None:
    """Who is due, or is woken before anybody is; None: nobody for some time. `waiting`: a heap with
    each of them, in which only the newest time of each counts, which is in `at_s`.
    """
    while waiting[0][0] != at_s[waiting[0][1]]:
        heapq.heappop(waiting)
    rests_s = waiting[0][0] - wall_s()
    if rests_s <= 0.0:
        return heapq.heappop(waiting)[1]
    try:
        return woken.get(timeout=min(rests_s, STOP_LOOK_S))
    except queue.Empty:
        return None
