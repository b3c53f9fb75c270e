"""A simulated day with desk and companions as separate processes: `sim-bridge day --processes`.

MAVLink runs over UDP on loopback, the fleet over zenoh, in wall-clock time. This process is the
world (vehicles, truck with driver, wind). It meets the others only through their messages. All
other processes end with it, however it ends.
"""

import contextlib
import json
import os
import subprocess
import sys
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import msgspec
import numpy as np

from companion.adapters.clock import epoch_us
from companion.core.base.errors import LeewayError
from companion.fleet.messages import State
from companion.fleet.network import MemberLink
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import StateReceived
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from sim_bridge.adapters.endpoint import EndpointSet, free_tcp_port
from sim_bridge.adapters.lifeline import entry
from sim_bridge.adapters.lossy_relay import Dice, LossyRelay
from sim_bridge.adapters.realtime import Pacer
from sim_bridge.app.day.build import BuiltDay, Plumb, Plumbing
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.desk import LOG, Books, store_url
from sim_bridge.app.day.drone import Companion, DayDrone
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.stopping import LEAVES_AT_ONCE

DESK, MEMBER, PLAN = "desk.json5", "member.json5", "plan.json"
ROUTER, DESK_ROUTER = "router.json5", "desk-router.json5"
DESK_MAIN = "from ground_station.app.cli.main import main; main()"


def write_network(folder: Path, *, relayed: bool) -> None:
    """Write the zenoh configurations for loopback; all members connect to a router of the
    simulator.

    With `relayed` the desk connects to a second router, and only a lossy relay joins the two.
    """
    here = "tcp/127.0.0.1:{}"
    members, desk = here.format(free_tcp_port()), here.format(free_tcp_port())
    files = {ROUTER: _listens(members), MEMBER: _calls(members), DESK: _calls(members)}
    if relayed:
        files |= {DESK_ROUTER: _listens(desk), DESK: _calls(desk)}
    for name, table in files.items():
        (folder / name).write_text(json.dumps(table))


ALONE: dict[str, Any] = {"scouting": {"multicast": {"enabled": False}}}


def _listens(endpoint: str) -> dict[str, Any]:
    return ALONE | {"mode": "router", "listen": {"endpoints": [endpoint]}}


def _calls(endpoint: str) -> dict[str, Any]:
    retry = {"period_init_ms": 50, "period_max_ms": 500}
    call = {"endpoints": [endpoint], "retry": retry}
    return ALONE | {"mode": "client", "connect": call}


@dataclass(slots=True)
class Wires:
    """One UDP endpoint per drone, by its index in the fleet; `pace` follows the wall clock."""

    endpoints: EndpointSet
    inbox: dict[int, deque[bytes]] = field(default_factory=dict)
    pacer: Pacer = field(default_factory=Pacer)

    def pace(self, t_s: float) -> None:
        """Wait until the wall clock reaches the day's time; keep datagrams that arrive
        meanwhile.
        """
        self._keep(self.pacer.wait_until(t_s, self.endpoints))

    def exchange(self, number: int, datagrams: list[bytes]) -> list[bytes]:
        """Send datagrams to a companion; returns what it sent since the last call."""
        for datagram in datagrams:
            self.endpoints.send(number, datagram)
        self._keep(self.endpoints.poll(0.0))
        box = self.inbox.setdefault(number, deque())
        said = list(box)
        box.clear()
        return said

    def _keep(self, received: list[tuple[int, bytes]]) -> None:
        for number, datagram in received:
            self.inbox.setdefault(number, deque()).append(datagram)


@dataclass(slots=True)
class UdpCompanion:
    """A `companion run --fleet` process at the far end of a UDP link."""

    process: CompanionProcess
    wires: Wires
    number: int

    def hear(self, datagrams: list[bytes]) -> list[bytes]:
        """Send datagrams; returns those received since the last call."""
        return self.wires.exchange(self.number, datagrams)

    def kill(self) -> None:
        """SIGKILL."""
        self.process.kill()
        self.process.end()

    def stop(self) -> None:
        """SIGTERM, and wait."""
        self.process.end()

    @property
    def running(self) -> bool:
        """False once it has ended."""
        return self.process.running


@dataclass(slots=True)
class Launcher:
    """Starts companions as processes."""

    data: DayData
    wires: Wires
    folder: Path

    def start(self, drone: DayDrone) -> Companion:
        """Start one drone's companion."""
        port = self.wires.endpoints.urls[drone.number - 1].rsplit(":", 1)[1]
        (own,) = [d for d in self.data.day.drones if d.id == drone.name]
        process = CompanionProcess(
            run_dir=drone.folder,
            arguments=[
                f"--link=udpout:127.0.0.1:{port}",
                f"--airframe={own.airframe}",
                f"--fleet={self.data.day.fleet}",
                f"--vehicle={drone.name}",
                f"--zenoh={self.folder / MEMBER}",
                f"--monitor={drone.folder / 'monitor'}",
                "--configure",
                *(["--keep-apart"] if self.data.day.neighbours else []),
            ],
        )
        process.start()
        return UdpCompanion(process, self.wires, drone.number - 1)


@dataclass(slots=True)
class ZenohNetwork:
    """The world's listener on the fleet network, on the vehicles' side; states only, for the judge.

    With `dice`, a lossy relay connects the vehicles' side to the desk.
    """

    ears: ZenohFleet
    states: dict[str, State] = field(default_factory=dict)
    dice: Dice | None = None
    relay: LossyRelay | None = None
    heard: int = 0

    @classmethod
    def open(
        cls, folder: Path, fleet: str, loss: float, rng: np.random.Generator
    ) -> "ZenohNetwork":
        """Write a folder's zenoh configurations and connect to them."""
        write_network(folder, relayed=loss > 0.0)
        if loss == 0.0:
            return cls(ZenohFleet(fleet, folder / ROUTER))
        dice = Dice(rng, loss)
        ends = read_config(folder / ROUTER), read_config(folder / DESK_ROUTER)
        relay = LossyRelay(fleet, *ends, dice)
        return cls(ZenohFleet(fleet, folder / MEMBER), dice=dice, relay=relay)

    @property
    def sent(self) -> int:
        """Messages offered to the relay; without a relay, states received."""
        return self.heard if self.dice is None else self.dice.sent

    @property
    def lost(self) -> int:
        """Messages that the relay dropped."""
        return 0 if self.dice is None else self.dice.lost

    def deliver(self, t_s: float) -> None:
        """Take the states received; `t_s` is not used."""
        for heard in self.ears.receive(0.0):
            if isinstance(heard, StateReceived):
                self.heard += 1
                self.states[heard.state.vehicle] = heard.state

    def close(self) -> None:
        """Close the listener and the relay."""
        self.ears.close()
        if self.relay is not None:
            self.relay.close()


def apart(folder: Path, loss: float) -> Plumb:
    """Companions and truck over UDP and zenoh, in wall-clock time; `loss`: of fleet messages."""
    LEAVES_AT_ONCE.set()

    def plumb(data: DayData, clock: DayClock, rng: np.random.Generator) -> Plumbing:
        config, fleet = folder / MEMBER, data.day.fleet
        wires = Wires(EndpointSet(["udpin:127.0.0.1:0"] * len(data.day.drones)))
        network = ZenohNetwork.open(folder, fleet, loss, rng)

        def truck_link(life: str) -> MemberLink:
            keys = VehicleKeys(fleet, TRUCK)
            return ZenohLink(read_config(config), keys, life, lambda: None)

        def close() -> None:
            with contextlib.closing(wires.endpoints):
                network.close()

        start = Launcher(data, wires, folder).start
        return Plumbing(network, start, truck_link, epoch_us, pace=wires.pace, close=close)

    return plumb


IN_ORDER = (0, 3)
"""Exit codes of a desk that finished; 3: orders are left that cannot be delivered."""


@dataclass(slots=True)
class DeskProcess:
    """`ground-station dispatch` on its store; `kill` is a real SIGKILL, `start` a real restart."""

    folder: Path
    day_file: Path
    clock: DayClock
    _process: subprocess.Popen[bytes] | None = None
    _output: IO[bytes] | None = field(default=None, repr=False)

    @classmethod
    def open(cls, path: Path, built: BuiltDay, plan: DayPlan, folder: Path) -> "DeskProcess":
        """Write the desk's files and start it; `path` is the day's file."""
        (folder / PLAN).write_bytes(msgspec.json.format(msgspec.json.encode(plan)))
        seat = cls(folder, write_day_file(path, built.data, folder), built.clock)
        built.faults.spread_over(plan.makespan_s)
        seat.start()
        return seat

    def start(self) -> None:
        """Run the desk's command, at first and after a kill."""
        if self._output is None:
            self._output = (self.folder / LOG).open("ab")
        arguments = [
            "dispatch",
            str(self.day_file),
            f"--store={store_url(self.folder)}",
            f"--plan={self.folder / PLAN}",
            f"--zenoh={self.folder / DESK}",
            "--until-done",
        ]
        self._process = subprocess.Popen(
            [sys.executable, "-c", entry(DESK_MAIN), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            start_new_session=True,
        )

    def turn(self) -> None:
        """Check the desk's process; it runs by itself. Raises LeewayError if it ended with
        an error.
        """
        code = None if self._process is None else self._process.poll()
        if code not in (None, *IN_ORDER):
            words = (self.folder / LOG).read_text(errors="replace").strip().splitlines()[-5:]
            raise LeewayError(
                "\n".join([f"{self.folder}: the desk ended with code {code}:", *words])
            )

    def kill(self) -> None:
        """SIGKILL."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    @property
    def is_done(self) -> bool:
        """Whether it has ended by itself with a code of IN_ORDER."""
        return self._process is not None and self._process.poll() in IN_ORDER

    @property
    def plans(self) -> list[DayPlan]:
        """All plans that were in force, from its store."""
        with self._books() as books:
            return books.plans

    @property
    def told(self) -> dict[str, str]:
        """Each order's state and the reason, from its store."""
        with self._books() as books:
            return books.told

    @property
    def brought_by(self) -> dict[str, str]:
        """Who brought each order that was delivered, from its store."""
        with self._books() as books:
            return books.brought_by

    @property
    def impossible(self) -> frozenset[str]:
        """Orders that the first plan does not bring."""
        return frozenset(line.order for plan in self.plans[:1] for line in plan.unplanned)

    @property
    def ended_by_itself(self) -> list[str]:
        """Nothing: `turn` raises."""
        return []

    def _books(self) -> contextlib.closing[Books]:
        return contextlib.closing(Books.open(store_url(self.folder), self.clock))

    def close(self) -> None:
        """SIGTERM, then SIGKILL after 10 s; leaves no process behind."""
        process = self._process
        if process is not None and process.poll() is None:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                self.kill()
        if self._output is not None:
            self._output.close()


def write_day_file(path: Path, data: DayData, folder: Path) -> Path:
    """Write the world's day for the desk: its forecast, and its files by absolute path."""
    day = data.day
    changed: dict[str, Any] = {"orders": [str((path.parent / o).resolve()) for o in day.orders]}
    for name in ("no_fly", "roads"):
        value = getattr(day, name)
        if value is not None:
            changed[name] = str((path.parent / value).resolve())
    table = msgspec.to_builtins(msgspec.structs.replace(day, **changed))
    written = folder / "day.toml"
    written.write_bytes(msgspec.toml.encode(_without_none(table)))
    return written


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, list):
        return [_without_none(v) for v in value]
    return value
