"""`sim-bridge research bench dispatch`: one order, from the desk's store to its acknowledgement.

The vehicles are the companion's own fleet ports (command book and event log on the disk, zenoh
sessions of their own) without a flight behind them, all in one process of their own. The desk is
the ground station's. What is timed: from before the assignment is written into the store until the
vehicle's acknowledgement has been noted there; and the part of it on the network.
"""

import json
import socket
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from companion.adapters.clock import epoch_us, wall_s
from companion.adapters.files.params import read_airframe
from companion.app.flight.fleet_port import STANDBY, FleetPort
from companion.core.pilot.telemetry_state import TelemetryState
from companion.fleet.command_log import Verdict
from companion.fleet.messages import Answered, Command
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import ZenohLink, leave_process
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import CommandAnswered, StateReceived
from ground_station.core.schema.orders import Order
from sim_bridge.research.benchmarks.timing import Samples

FLEET = "bench"
ANSWER_S = 10.0
GATHER_S = 120.0
GOAL_MS = 20.0
FLIGHT: dict[str, Any] = {"format": "flight/1", "site": {"customer": {"name": "x"}}}


@dataclass(frozen=True, slots=True)
class Timed:
    """One order: all of it, and the part between sending and hearing, ms."""

    whole_ms: float
    network_ms: float


def bench(vehicles: int, orders: int, seed: int, json_file: Path | None) -> None:
    """Print the figures, and write them where asked; ends the process."""
    with tempfile.TemporaryDirectory(prefix="leeway-bench-") as name:
        folder = Path(name)
        desk, peers = _configs(folder)
        arguments = [
            sys.executable,
            "-m",
            "sim_bridge.research.benchmarks.dispatch_bench",
            str(vehicles),
        ]
        with subprocess.Popen([*arguments, str(peers), str(folder / "vehicles")]) as fleet:
            try:
                timed = _measure(folder, desk, vehicles, orders, seed)
            finally:
                fleet.terminate()
    figures = _figures(vehicles, timed)
    table = Table("what", "p50 ms", "p99 ms", "max ms")
    for what in ("order to acknowledgement in the store", "of it on the network"):
        table.add_row(what, *(f"{figures[what][k]:.1f}" for k in ("p50", "p99", "max")))
    Console().print(table)
    typer.echo(f"{orders} orders, {vehicles} vehicles connected; goal {GOAL_MS:g} ms at p99")
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1))
    leave_process(0)


def _configs(folder: Path) -> tuple[Path, Path]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    quiet = {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}
    desk = {"mode": "peer", "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    call = {"endpoints": [f"tcp/127.0.0.1:{port}"], "retry": {"period_init_ms": 100}}
    peer = {"mode": "client", "connect": call}
    for name, table in (("desk", desk), ("vehicle", peer)):
        (folder / f"{name}.json5").write_text(json.dumps(quiet | table))
    return folder / "desk.json5", folder / "vehicle.json5"


def _measure(folder: Path, config: Path, vehicles: int, orders: int, seed: int) -> list[Timed]:
    store = Store(Database(f"sqlite:///{folder}/desk.db"), epoch_us)
    desk = ZenohFleet(FLEET, config)
    rng = np.random.default_rng(seed)
    try:
        with Progress(transient=True) as progress:
            states = _gather(desk, vehicles, progress)
            task = progress.add_task("dispatching", total=orders)
            timed: list[Timed] = []
            for number in range(orders):
                name = f"v{rng.integers(vehicles)}"
                timed.append(_dispatch(store, desk, states, name, number))
                progress.advance(task)
    finally:
        desk.close()
        store.close()
    return timed


def _gather(desk: ZenohFleet, vehicles: int, progress: Progress) -> dict[str, StateReceived]:
    states: dict[str, StateReceived] = {}
    task = progress.add_task("vehicles connecting", total=vehicles)
    until_s = wall_s() + GATHER_S
    while len(states) < vehicles:
        _keep(states, desk.receive(0.1))
        progress.update(task, completed=len(states))
        if wall_s() > until_s:
            typer.echo(f"{len(states)} of {vehicles} vehicles after {GATHER_S:.0f} s", err=True)
            raise typer.Exit(1)
    return states


def _keep(states: dict[str, StateReceived], heard: list[Any]) -> list[CommandAnswered]:
    states |= {h.state.vehicle: h for h in heard if isinstance(h, StateReceived)}
    return [h for h in heard if isinstance(h, CommandAnswered)]


def _dispatch(
    store: Store, desk: ZenohFleet, states: dict[str, StateReceived], name: str, number: int
) -> Timed:
    """One order, and its vehicle freed again (not timed)."""
    order = Order(id=f"o{number}", lat_deg=55.0, lon_deg=8.0, alt_amsl_m=0.0, mass_kg=0.1)
    store.add_orders([order])
    _keep(states, desk.receive(0.0001))
    begin_s = wall_s()
    store.assign(order.id, name, FLIGHT, None, "bench")
    row = store.outbox()[0]
    state = states[name].state
    command = Command(
        id=row.id,
        vehicle=name,
        life=state.life,
        as_of_s=state.uptime_s,
        by=row.by,
        deed=row.deed,
    )
    sent_s = wall_s()
    desk.send(command, ANSWER_S)
    answers: list[CommandAnswered] = []
    while not answers:
        answers = _keep(states, desk.receive(ANSWER_S))
    heard_s = wall_s()
    result = answers[0].result
    if result is None or result.answer is not Answered.DONE:
        raise typer.BadParameter(f"{name} answered {result}")
    store.answered(row.id, result.answer, result.reason, result.life)
    end_s = wall_s()
    store.withdraw(row.assignment or "", "bench")
    for waiting in store.outbox():
        store.answered(waiting.id, Answered.DONE, "", state.life)
    return Timed(1e3 * (end_s - begin_s), 1e3 * (heard_s - sent_s))


def _figures(vehicles: int, timed: list[Timed]) -> dict[str, Any]:
    def spread(values: list[float]) -> dict[str, float]:
        each = Samples.of(values)
        return {"p50": each.median, "p99": each.p99, "max": each.most}

    return {
        "vehicles": vehicles,
        "orders": len(timed),
        "order to acknowledgement in the store": spread([t.whole_ms for t in timed]),
        "of it on the network": spread([t.network_ms for t in timed]),
    }


def _vehicles(count: int, config_file: Path, folder: Path) -> None:
    """The vehicles' process: one thread serves them all; it ends with SIGTERM."""
    config, airframe, woken = read_config(config_file), read_airframe("m100"), threading.Event()

    def opened(name: str) -> FleetPort:
        keys = VehicleKeys(FLEET, name)
        return FleetPort.open(
            name,
            "m100",
            airframe,
            folder / name,
            lambda life: ZenohLink(config, keys, life, woken.set),
        )

    ports = [opened(f"v{number}") for number in range(count)]
    nothing_known = TelemetryState()

    def accept(command: Command) -> Verdict:
        return Verdict(Answered.DONE, "aboard")

    while True:
        for port in ports:
            port.turn(accept)
            port.publish(STANDBY, nothing_known)
        woken.wait(0.1)
        woken.clear()


if __name__ == "__main__":
    _vehicles(int(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]))
