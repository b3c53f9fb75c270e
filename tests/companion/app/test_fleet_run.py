"""Assignment after assignment in one process: what is left of a flight that is over."""

import gc
import json
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.autopilots.link import Incoming
from companion.app.flight import fleet_run, standby
from companion.app.flight.assignment import MISSION, load_assignment
from companion.app.flight.fleet_port import Assigned, FleetPort
from companion.app.flight.loaded_flight import RunOptions, Settings
from companion.app.flight.loop import Loop
from companion.app.flight.recorder import Recorder
from companion.app.flight.run import STOPPED
from companion.app.flight.standby import Standby
from companion.core.base.errors import LeewayError
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
    strangers = 0

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

    def turn(self) -> None:
        (self.at_standby if self._port.current is None else self.in_flight)()

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
    port = fleet_run.open_port(fleet, options, Settings.read(options))
    desk = Desk(port)
    monkeypatch.setattr(fleet_run, "open_port", lambda *_: port)
    monkeypatch.setattr(fleet_run, "open_link", lambda _: Wire(desk.turn))
    assert fleet_run.serve(fleet, options, say=lambda _: None) == STOPPED
    assert [port.log.has_outcome(f"a{k + 1}") for k in range(FLIGHTS)] == [True] * FLIGHTS
    assert len(desk.alive) == FLIGHTS + 1
    for alive in desk.alive:
        assert [alive[kind] - before[kind] for kind in OF_A_FLIGHT] == [0, 0, 0]
        assert alive[Standby] - before[Standby] == 1


def moonlit() -> Assign:
    """A flight in a wind process that this vehicle does not have."""
    table = delivery_table(DAY.day, DAY.day.drones[0], DAY.orders[0])
    table["mission"] |= {"wind_process": "moon"}
    return Assign(assignment="a1", order="o1", flight=table)


class Served:
    """A companion that serves a fleet until the desk's plan (one step a turn) is through."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        nowhere = config_file(folder / "v.json5", connect=free_port())
        self.options = RunOptions("", "m100", folder, folder / "d1")
        self._fleet = fleet_run.FleetOptions(FLEET, "d1", nowhere)
        self.port = fleet_run.open_port(self._fleet, self.options, Settings.read(self.options))
        monkeypatch.setattr(fleet_run, "open_port", lambda *_: self.port)
        monkeypatch.setattr(fleet_run, "open_link", lambda _: Wire(self._turn))
        self.answers: list[bytes] = []
        self.asking: list[Deed] = []

    def _turn(self) -> None:
        if not self.asking:
            signal.raise_signal(signal.SIGTERM)
            return
        deed, port = self.asking.pop(0), self.port
        command = Command(
            id="c1", vehicle="d1", life=port.life, as_of_s=port.uptime_s, by="desk", deed=deed
        )
        port.link.put(Asked(Ask.COMMAND, self.answers.extend, encode(command)))  # type: ignore[attr-defined]

    def serve(self) -> int:
        return fleet_run.serve(self._fleet, self.options, say=lambda _: None)

    def leave_aboard(self, deed: Assign) -> None:
        """As a version that did not look into what it took has left it."""
        self.port.take_aboard(Assigned(assignment=deed.assignment, order=deed.order))
        path = self.port.folder_of(deed.assignment) / MISSION
        path.parent.mkdir()
        path.write_text(json.dumps(deed.flight))


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Served:
    return Served(tmp_path, monkeypatch)


def test_an_assignment_that_cannot_be_loaded_is_refused_and_the_service_goes_on(served):
    served.asking = [moonlit()]
    assert served.serve() == STOPPED
    assert b'"answer":"refused"' in served.answers[0]
    assert b"no such wind process" in served.answers[0]


def test_canary_an_assignment_answered_unseen_is_done_and_ends_in_a_refusal(served, monkeypatch):
    def unseen(deed: Assign, port: FleetPort, *_: Any) -> None:
        folder = port.folder_of(deed.assignment)
        folder.mkdir()
        (folder / MISSION).write_text(json.dumps(deed.flight))

    monkeypatch.setattr(standby, "write_assignment", unseen)
    served.asking = [moonlit()]
    assert served.serve() == STOPPED
    assert b'"answer":"done"' in served.answers[0]
    assert served.port.log.has_outcome("a1")


def test_a_service_restarted_with_a_bad_assignment_refuses_it_and_stands_by(served):
    served.leave_aboard(moonlit())
    assert served.serve() == STOPPED
    assert served.port.log.has_outcome("a1")


def test_canary_without_the_refusal_a_bad_assignment_ends_the_service(served, monkeypatch):
    served.leave_aboard(moonlit())
    loads = lambda port, options, settings: load_assignment("a1", port, options, settings)  # noqa: E731
    monkeypatch.setattr(fleet_run, "take_up", loads)
    with pytest.raises(LeewayError, match="no such wind process"):
        served.serve()
