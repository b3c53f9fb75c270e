"""`sim-bridge research bench-fleet`: a desk with many vehicles that fly orders, for some minutes.

Members are the companion's own fleet ports and zenoh links around a small state machine: no
physics, a process for every 50. Desk, store and (where asked for) routers are the product's own.
All of them share this machine.
"""

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import sqlalchemy as sa

from companion.adapters.clock import epoch_us, wall_s
from companion.adapters.files.params import read_airframe
from companion.app.flight.fleet_port import STANDBY, Assigned, FleetPort
from companion.core.pilot.telemetry_state import TelemetryState
from companion.fleet.command_log import Verdict
from companion.fleet.messages import Answered, Assign, Command, EventKind, Launch, State
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters.pki.access_rules import MANY_CALLERS
from ground_station.adapters.store import tables
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.dispatcher import Progress
from ground_station.app.desk.exchange import Exchange
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.orders import AssignmentRow, Order, OrderState

FLEET = "bench"
A_PROCESS = 50
TURN_S = 0.1
FLIGHT_S = (50.0, 70.0)
"""How long a member is in the air, drawn."""

A_TURN = 10
"""Assignments of one turn; then the desk listens again."""

JOIN_LIMIT_S = 180.0
SETTLE_S = 90.0
"""After the last assignment, until every flight has landed and told of it."""

FLIGHT: dict[str, Any] = {"format": "flight/1", "site": {"customer": {"name": "x"}}}


# --- the members' process ------------------------------------------------------------------------


@dataclass(slots=True)
class Member:
    """One vehicle: standby, ready, outbound for some seconds, and an outcome."""

    port: FleetPort
    rng: np.random.Generator
    phase: str = STANDBY
    lands_s: float = 0.0
    flown: list[str] = field(default_factory=list)

    def turn(self) -> None:
        """Answer, land when it is time, tell the state."""
        self.port.turn(self._carry_out)
        if self.phase == "outbound" and wall_s() >= self.lands_s:
            self._land()
        self.port.publish(self.phase, TelemetryState())

    def _carry_out(self, command: Command) -> Verdict:
        deed = command.deed
        match deed:
            case Assign() if self.phase == STANDBY:
                self.port.take_aboard(Assigned(assignment=deed.assignment, order=deed.order))
                self.phase = "ready"
            case Launch() if self.phase == "ready":
                self.flown.append(deed.assignment)
                self.phase, self.lands_s = "outbound", wall_s() + self.rng.uniform(*FLIGHT_S)
            case _:
                return Verdict(Answered.REFUSED, f"in phase {self.phase}")
        return Verdict(Answered.DONE, self.phase)

    def _land(self) -> None:
        self.port.tell(EventKind.OUTCOME, "landed", outcome="SUC", delivered=True, home=True)
        self.port.put_ashore()
        self.phase = STANDBY


def _members(first: int, count: int, config_file: Path, folder: Path, seed: int) -> None:
    """Say that it is loaded; join at a word; serve until standard input ends, then tell what was
    flown.
    """
    print("loaded", flush=True)
    sys.stdin.readline()
    config, airframe = read_config(config_file), read_airframe("m100")
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
    members: list[Member] = []
    for number in range(first, first + count):
        name = f"v{number}"
        keys = VehicleKeys(FLEET, name)

        def link_of(life: str, keys: VehicleKeys = keys) -> ZenohLink:
            return ZenohLink(config, keys, life, lambda: None)

        port = FleetPort.open(name, "m100", airframe, folder / name, link_of)
        members.append(Member(port, np.random.default_rng([seed, number])))
    while not stop.is_set():
        begun_s = wall_s()
        for member in members:
            member.turn()
        stop.wait(max(0.0, TURN_S - (wall_s() - begun_s)))
    print(json.dumps([x for member in members for x in member.flown]), flush=True)
    os._exit(0)


# --- the desk -------------------------------------------------------------------------------------


@dataclass(slots=True)
class GiveAll:
    """A dispatcher without a day: any free vehicle takes the next open order, launched at once."""

    store: Store
    assigns: bool = True

    def begin(self) -> None:
        """Nothing to take up."""

    def on_state(self, state: State) -> None:
        """Nothing: `turn` reads the fleet's status."""

    def on_ready(self, assignment: AssignmentRow) -> None:
        """Launch it."""
        self.store.launch(assignment.id, "bench")

    def turn(self, status: FleetStatus, *, changed: bool) -> Progress:
        """Orders to vehicles on standby."""
        del changed
        if not self.assigns:
            return Progress.NONE
        opened = [row.order.id for row in self.store.orders(OrderState.OPEN)][:A_TURN]
        if not opened:
            return Progress.NONE
        held = {row.vehicle for row in self.store.assignments(in_force=True)}
        idle = [s.vehicle for s in status.vehicles.values() if _is_idle(s.state)]
        free = [name for name in idle if name not in held]
        for order, vehicle in zip(opened, free, strict=False):
            self.store.assign(order, vehicle, FLIGHT, None, "bench")
        return Progress.CHANGED if opened and free else Progress.NONE

    @property
    def is_done(self) -> bool:
        """Never: the bench ends it."""
        return False

    @property
    def replans(self) -> None:
        """There is no plan."""
        return None

    def why_left(self, order_id: str) -> str | None:
        """Nothing is known."""
        del order_id
        return None

    def close(self) -> None:
        """Nothing runs beside the desk."""


def _idle_of(desk: Desk) -> list[str]:
    """Members on standby."""
    seen = desk.exchange.status.vehicles.values()
    return [one.vehicle for one in seen if _is_idle(one.state)]


def _heard_of(desk: Desk) -> int:
    """Members whose states come."""
    now_s = desk.exchange.clock.monotonic_s()
    return sum(seen.present(now_s) for seen in desk.exchange.status.vehicles.values())


def _is_idle(state: State | None) -> bool:
    return state is not None and state.phase == STANDBY


@dataclass(slots=True)
class Bench:
    """One run; `figures` after it."""

    vehicles: int
    minutes: float
    routers: int
    store: Store
    store_file: Path | None
    folder: Path
    seed: int
    order_every_s: float
    gone: int = 0
    taken: int = 0

    def run(self) -> dict[str, Any]:
        """Start everything, let it fly, and count."""
        ports = [_free_port() for _ in range(max(1, self.routers))]
        with self._processes(ports) as members:
            return self._measured(self._config(ports), members)

    def _measured(self, config: Path, members: list["subprocess.Popen[str]"]) -> dict[str, Any]:
        store, load_before = self.store, os.getloadavg()[0]
        fleet = ZenohFleet(FLEET, config)
        desk = Desk(Exchange(store, fleet, self._hear), GiveAll(store))
        desk.begin()
        begun_s = _let_join(members)
        joined_s = self._join(desk)
        joined = len(_idle_of(desk))
        cpu_s, since_s, bytes_before = _cpu_s(), wall_s(), self._store_bytes()
        while wall_s() - since_s < 60.0 * self.minutes:
            self._take_orders((wall_s() - since_s) * self.vehicles / self.order_every_s)
            desk.turn(0.2)
        busy = (_cpu_s() - cpu_s) / (wall_s() - since_s)
        hours, grown = (wall_s() - since_s) / 3600, self._store_bytes() - bytes_before
        assert isinstance(desk.dispatcher, GiveAll)
        desk.dispatcher.assigns = False
        until_s = wall_s() + SETTLE_S
        while wall_s() < until_s and store.assignments(in_force=True):
            desk.turn(0.2)
        rss_mb, present = psutil.Process().memory_info().rss / 1e6, _heard_of(desk)
        fleet.close()
        flown = Counter(x for process in members for x in _flown(process))
        return {
            "vehicles": self.vehicles,
            "routers": self.routers,
            "order_every_s": self.order_every_s,
            **self._acknowledged(),
            "false_gone": self.gone,
            "desk_cpu_frac": round(busy, 3),
            "desk_rss_mb": round(rss_mb, 1),
            "store_mb_per_hour": round(grown / 1e6 / hours, 1),
            "joined_s": None if joined_s is None else round(joined_s - begun_s, 1),
            f"joined_in_{JOIN_LIMIT_S:.0f}_s": joined,
            "present_at_end": present,
            "load_of_machine": [round(load, 1) for load in (load_before, *os.getloadavg()[:2])],
            **self._orders(flown),
        }

    def _take_orders(self, due: float) -> None:
        """Orders that have come in by now."""
        fresh = [_order(number) for number in range(self.taken, int(due) + 1)]
        if fresh:
            self.store.add_orders(fresh)
            self.taken += len(fresh)

    def _hear(self, words: str) -> None:
        """A member that leaves while all are alive is falsely gone."""
        self.gone += "left the network" in words

    def _join(self, desk: Desk) -> float | None:
        until_s = wall_s() + JOIN_LIMIT_S
        while wall_s() < until_s:
            desk.turn(0.2)
            if len(_idle_of(desk)) >= self.vehicles:
                return wall_s()
        return None

    def _acknowledged(self) -> dict[str, Any]:
        """From a command's transaction to its answer's, as the store has stamped them."""
        asked = tables.commands.c
        with self.store.database.read() as db:
            rows = db.execute(sa.select(asked.made_us, asked.answered_us, asked.answer)).all()
        took = [(r.answered_us - r.made_us) / 1e3 for r in rows if r.answered_us is not None]
        p50, p99 = (round(float(x), 1) for x in np.percentile(took or [0.0], [50, 99]))
        return {
            "ack_ms_p50": p50 if took else None,
            "ack_ms_p99": p99 if took else None,
            "commands": len(rows),
            "unanswered": sum(row.answer is None for row in rows),
        }

    def _orders(self, flown: Counter[str]) -> dict[str, int]:
        """The members' own count against the store's."""
        rows = self.store.orders()
        delivered = sum(row.state is OrderState.DELIVERED for row in rows)
        orders = Counter(assignment.rpartition(".")[0] for assignment in flown.elements())
        lost = [x for x in orders if x not in {r.order.id for r in rows}]
        missing = len(orders) - delivered
        return {
            "orders": len(rows),
            "delivered": delivered,
            "twice": sum(count > 1 for count in orders.values()),
            "lost": len(lost) + max(0, missing),
        }

    def _store_bytes(self) -> int:
        if self.store_file is None:
            return 0
        return self.store_file.stat().st_size  # beside it lie at most 4 MB of its journal

    # --- processes and configurations ---------------------------------------------------------

    def _config(self, ports: list[int]) -> Path:
        """The desk's: it listens, or calls every router."""
        ends = [f"tcp/127.0.0.1:{port}" for port in ports]
        how = {"connect": {"endpoints": ends}} if self.routers else {"listen": {"endpoints": ends}}
        many = {"transport": {"unicast": MANY_CALLERS}}
        return _write(self.folder / "desk.json5", {"mode": "peer", **how, **many})

    @contextlib.contextmanager
    def _processes(self, ports: list[int]) -> Iterator[list["subprocess.Popen[str]"]]:
        started = [self._router(port) for port in ports] if self.routers else []
        members = [
            self._start("members", first, min(A_PROCESS, self.vehicles - first), ports[k])
            for k, first in _shares(self.vehicles, len(ports))
        ]
        try:
            yield members
        finally:
            for process in (*started, *members):
                process.kill()
                process.wait()
                for pipe in (process.stdin, process.stdout):
                    if pipe is not None:
                        pipe.close()

    def _router(self, port: int) -> "subprocess.Popen[str]":
        listens = {"listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
        table = {"mode": "router", **listens, "transport": {"unicast": MANY_CALLERS}}
        config = _write(self.folder / f"router-{port}.json5", table)
        return _python("router", str(config))

    def _start(self, what: str, first: int, count: int, port: int) -> "subprocess.Popen[str]":
        call = {"endpoints": [f"tcp/127.0.0.1:{port}"], "retry": {"period_init_ms": 200}}
        path = self.folder / f"member-{port}.json5"
        config = _write(path, {"mode": "client", "connect": call | {"exit_on_failure": False}})
        arguments = (str(first), str(count), str(config), str(self.folder / "v"), str(self.seed))
        return _python(what, *arguments)


def _shares(vehicles: int, ports: int) -> list[tuple[int, int]]:
    """(port's number, first vehicle) of each process."""
    return [(k % ports, first) for k, first in enumerate(range(0, vehicles, A_PROCESS))]


def _python(*arguments: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "sim_bridge.research.benchmarks.fleet_bench", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )


def _let_join(members: list["subprocess.Popen[str]"]) -> float:
    """All join at the same moment, when each has loaded its programs; returns that moment."""
    for process in members:
        assert process.stdout is not None
        process.stdout.readline()
    begun_s = wall_s()
    for process in members:
        assert process.stdin is not None
        process.stdin.write("join\n")
        process.stdin.flush()
    return begun_s


def _flown(process: "subprocess.Popen[str]") -> list[str]:
    """What its members have flown; ends the process."""
    out, _ = process.communicate("", timeout=60.0)
    return json.loads(out.splitlines()[-1])


def _write(path: Path, table: dict[str, Any]) -> Path:
    quiet = {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}
    path.write_text(json.dumps(quiet | table))
    return path


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _cpu_s() -> float:
    spent = psutil.Process().cpu_times()
    return spent.user + spent.system


Figures = dict[str, Any]


def _order(number: int) -> Order:
    return Order(id=f"o{number}", lat_deg=55.0, lon_deg=8.0, alt_amsl_m=0.0, mass_kg=0.1)


def bench(
    vehicles: int, minutes: float, routers: int, url: str | None, seed: int, order_every_s: float
) -> dict[str, Any]:
    """The figures of one run; a store of its own, unless `url` names one that is empty."""
    with tempfile.TemporaryDirectory(prefix="leeway-bench-") as name:
        folder = Path(name)
        file = folder / "desk.db" if url is None else None
        store = Store(Database(url or f"sqlite:///{file}"), epoch_us)
        try:
            return Bench(vehicles, minutes, routers, store, file, folder, seed, order_every_s).run()
        finally:
            store.close()


def _route(config_file: Path) -> None:
    """A router: zenoh's own, until standard input ends."""
    import zenoh

    with zenoh.open(read_config(config_file)):
        sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    if sys.argv[1] == "router":
        _route(Path(sys.argv[2]))
    else:
        _members(
            int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]), Path(sys.argv[5]),
            int(sys.argv[6]),
        )  # fmt: skip
