"""Assignment after assignment in one process: what is left of a flight that is over."""

import gc
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.autopilots.link import Incoming
from companion.app.flight import fleet_run
from companion.app.flight import run as run_module
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loop import Loop
from companion.app.flight.recorder import Recorder
from companion.app.flight.run import STOPPED, RunOptions
from companion.app.flight.standby import Standby
from companion.core.pilot.pilot import Pilot
from companion.fleet.messages import Assign, Command, Deed, Withdraw, encode
from companion.fleet.network import Ask, Asked
from ground_station.adapters.files.day_files import read_day
from ground_station.core.dispatch.flight_tables import delivery_table
from tests.fleet.zenoh_net import FLEET, config_file, free_port

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
FLIGHTS = 3
OF_A_FLIGHT = (Pilot, Loop, Recorder)


class Wire:
    """A link to an autopilot that only beats; at each turn the desk may act."""

    datagrams = True

    def __init__(self, desk_turns: Callable[[], None]) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._desk_turns = desk_turns

    def receive(self, timeout_s: float) -> Incoming:
        self._desk_turns()
        beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
        self._mav.seq = (self._mav.seq + 1) % 256
        return Incoming(bytes(beat.pack(self._mav)), ("here", 1))

    def waiting(self) -> int:
        return 0

    def send(self, data: bytes) -> None: ...
    def settle(self) -> None: ...
    def wake(self) -> None: ...
    def answer_to(self, peer: Any) -> None: ...
    def close(self) -> None: ...


class Desk:
    """Assigns flights and withdraws each on the pad; counts what lives at each standby."""

    def __init__(self, port: FleetPort) -> None:
        self._port = port
        self._asked = 0
        self.assigned = 0
        self.alive: list[Counter[type]] = []

    def at_standby(self) -> None:
        if len(self.alive) > self.assigned:
            return
        self.alive.append(Counter(type(one) for one in gc.get_objects()))
        if self.assigned == FLIGHTS:
            signal.raise_signal(signal.SIGTERM)
            return
        self.assigned += 1
        flight = delivery_table(DAY.day, DAY.day.drones[0], DAY.orders[0])
        self._ask(Assign(assignment=f"a{self.assigned}", order="o1", flight=flight))

    def in_flight(self) -> None:
        self._ask(Withdraw(assignment=f"a{self.assigned}"))

    def _ask(self, deed: Deed) -> None:
        self._asked += 1
        port = self._port
        command = Command(
            id=f"c{self._asked}",
            vehicle=port.vehicle,
            life=port.life,
            as_of_s=port.uptime_s,
            by="desk",
            deed=deed,
        )
        port.link.put(Asked(Ask.COMMAND, lambda replies: None, encode(command)))  # type: ignore[attr-defined]


@pytest.fixture
def no_collector() -> Iterator[None]:
    """The collector comes by itself at any time, and would free what nobody let go."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def test_nothing_of_a_flight_that_is_over_is_kept(tmp_path, monkeypatch, no_collector):
    fleet = fleet_run.FleetOptions(
        FLEET, "d1", config_file(tmp_path / "v.json5", connect=free_port())
    )
    options = RunOptions("", "m100", tmp_path, tmp_path / "d1")
    before = Counter(type(one) for one in gc.get_objects())
    port = fleet_run.open_port(fleet, options)
    desk = Desk(port)
    monkeypatch.setattr(fleet_run, "open_port", lambda *_: port)
    monkeypatch.setattr(fleet_run, "open_link", lambda _: Wire(desk.at_standby))
    monkeypatch.setattr(run_module, "open_link", lambda _: Wire(desk.in_flight))
    assert fleet_run.serve(fleet, options, say=lambda _: None) == STOPPED
    assert [port.log.has_outcome(f"a{k + 1}") for k in range(FLIGHTS)] == [True] * FLIGHTS
    assert len(desk.alive) == FLIGHTS + 1
    for alive in desk.alive:
        assert [alive[kind] - before[kind] for kind in OF_A_FLIGHT] == [0, 0, 0]
        assert alive[Standby] - before[Standby] == 1
