"""Successive assignments in one process: objects that remain after a flight."""

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
from companion.app.flight.fleet_port import FleetPort, StoredAssignment
from companion.app.flight.loaded_flight import RunOptions, Settings
from companion.app.flight.loop import Loop
from companion.app.flight.recorder import Recorder
from companion.app.flight.run import INTERRUPTED
from companion.app.flight.standby import Standby
from companion.core.base.errors import LeewayError
from companion.core.pilot.pilot import Pilot
from companion.fleet.messages import Assign, Command, CommandAction, Withdraw, encode_message
from companion.fleet.network import MemberRequest, RequestKind
from ground_station.adapters.files.day_files import read_day
from ground_station.core.dispatch.flight_tables import depot_delivery_flight_table
from sim_bridge.app.world.memory_link import MemoryLink
from tests.fleet.zenoh_net import FLEET, config_file, free_port

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
FLIGHTS = 3
OF_A_FLIGHT = (Pilot, Loop, Recorder)


class Wire(MemoryLink):
    """A link to an autopilot that only sends heartbeats; the desk acts at each turn."""

    def __init__(self, desk_turns: Callable[[], None]) -> None:
        super().__init__()
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._desk_turns = desk_turns

    def receive(self, timeout_s: float) -> Incoming:
        self._desk_turns()
        beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
        self._mav.seq = (self._mav.seq + 1) % 256
        return Incoming(bytes(beat.pack(self._mav)), ("here", 1))


def put_command(
    port: FleetPort, id_: str, deed: CommandAction, reply: Callable[[Any], None]
) -> None:
    stamp = {
        "vehicle": "d1",
        "instance_id": port.member.instance_id,
        "as_of_s": port.member.uptime_s,
        "by": "desk",
    }
    command = Command(id=id_, action=deed, **stamp)
    port.member.link.request_queues.add_request_and_call_back(
        MemberRequest(RequestKind.COMMAND, reply, encode_message(command))
    )  # type: ignore[attr-defined]


class Desk:
    """Assigns flights and withdraws each on the pad; counts the live objects at each standby."""

    def __init__(self, port: FleetPort, earlier: list[object]) -> None:
        self._port = port
        self._earlier_ids = {id(one) for one in earlier}
        self._asked = self.assigned = 0
        self.alive: list[Counter[type]] = []

    def run_cycle(self) -> None:
        (self.at_standby if self._port.current is None else self.in_flight)()

    def at_standby(self) -> None:
        if len(self.alive) > self.assigned:
            return
        self.alive.append(
            Counter(type(one) for one in gc.get_objects() if id(one) not in self._earlier_ids)
        )
        if self.assigned == FLIGHTS:
            signal.raise_signal(signal.SIGTERM)
            return
        self.assigned += 1
        flight = depot_delivery_flight_table(DAY.day, DAY.day.drones[0], DAY.orders[0])
        self._ask(Assign(assignment=f"a{self.assigned}", order="o1", flight=flight))

    def in_flight(self) -> None:
        self._ask(Withdraw(assignment=f"a{self.assigned}"))

    def _ask(self, deed: CommandAction) -> None:
        self._asked += 1
        put_command(self._port, f"c{self._asked}", deed, lambda replies: None)


@pytest.fixture
def no_collector() -> Iterator[None]:
    """Disable the garbage collector, which could free leaked objects at any time."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.sample
def test_nothing_of_a_flight_that_is_over_is_kept(tmp_path, monkeypatch, no_collector):
    fleet = fleet_run.FleetOptions(
        FLEET, "d1", config_file(tmp_path / "v.json5", connect=free_port())
    )
    options = RunOptions("", "m100", tmp_path, tmp_path / "d1")
    earlier = [one for one in gc.get_objects() if issubclass(type(one), (*OF_A_FLIGHT, Standby))]
    port = fleet_run.open_fleet_port(fleet, options, Settings.read_settings_files(options))
    desk = Desk(port, earlier)
    monkeypatch.setattr(fleet_run, "open_fleet_port", lambda *_: port)
    monkeypatch.setattr(fleet_run, "open_link", lambda _: Wire(desk.run_cycle))
    assert (
        fleet_run.fly_fleet_assignments_until_stopped(fleet, options, print_line=lambda _: None)
        == INTERRUPTED
    )
    assert [port.member.log.has_stored_outcome(f"a{k + 1}") for k in range(FLIGHTS)] == [
        True
    ] * FLIGHTS
    assert len(desk.alive) == FLIGHTS + 1
    for alive in desk.alive:
        assert [alive[kind] for kind in OF_A_FLIGHT] == [0, 0, 0]
        assert alive[Standby] == 1


def moonlit() -> Assign:
    """Return a flight in a wind process that this vehicle does not have."""
    table = depot_delivery_flight_table(DAY.day, DAY.day.drones[0], DAY.orders[0])
    table["mission"] |= {"wind_process": "moon"}
    return Assign(assignment="a1", order="o1", flight=table)


class Served:
    """A companion that serves a fleet until the desk's plan (one step a turn) is complete."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        nowhere = config_file(folder / "v.json5", connect=free_port())
        self.options = RunOptions("", "m100", folder, folder / "d1")
        self._fleet = fleet_run.FleetOptions(FLEET, "d1", nowhere)
        self.port = fleet_run.open_fleet_port(
            self._fleet, self.options, Settings.read_settings_files(self.options)
        )
        monkeypatch.setattr(fleet_run, "open_fleet_port", lambda *_: self.port)
        monkeypatch.setattr(fleet_run, "open_link", lambda _: Wire(self._turn))
        self.answers: list[bytes] = []
        self.asking: list[CommandAction] = []

    def _turn(self) -> None:
        if not self.asking:
            signal.raise_signal(signal.SIGTERM)
            return
        put_command(self.port, "c1", self.asking.pop(0), self.answers.extend)

    def serve(self) -> int:
        return fleet_run.fly_fleet_assignments_until_stopped(
            self._fleet, self.options, print_line=lambda _: None
        )

    def leave_assigned(self, deed: Assign) -> None:
        """Leave an assignment as a version that did not validate it would have stored it."""
        self.port.store_assignment(StoredAssignment(assignment=deed.assignment, order=deed.order))
        path = self.port.assignment_folder(deed.assignment) / MISSION
        path.parent.mkdir()
        path.write_text(json.dumps(deed.flight))


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Served:
    return Served(tmp_path, monkeypatch)


def test_an_assignment_that_cannot_be_loaded_is_refused_and_the_service_goes_on(served):
    served.asking = [moonlit()]
    assert served.serve() == INTERRUPTED
    assert b'"answer":"refused"' in served.answers[0]
    assert b"no such wind process" in served.answers[0]


def test_canary_an_assignment_answered_unseen_is_done_and_ends_in_a_refusal(served, monkeypatch):
    def unseen(deed: Assign, port: FleetPort, *_: Any) -> None:
        folder = port.assignment_folder(deed.assignment)
        folder.mkdir()
        (folder / MISSION).write_text(json.dumps(deed.flight))

    monkeypatch.setattr(standby, "write_assignment", unseen)
    served.asking = [moonlit()]
    assert served.serve() == INTERRUPTED
    assert b'"answer":"done"' in served.answers[0]
    assert served.port.member.log.has_stored_outcome("a1")


def test_a_service_restarted_with_a_bad_assignment_refuses_it_and_stands_by(served):
    served.leave_assigned(moonlit())
    assert served.serve() == INTERRUPTED
    assert served.port.member.log.has_stored_outcome("a1")


def test_canary_without_the_refusal_a_bad_assignment_ends_the_service(served, monkeypatch):
    served.leave_assigned(moonlit())
    loads = lambda port, options, settings: load_assignment("a1", port, options, settings)  # noqa: E731
    monkeypatch.setattr(fleet_run, "load_current_assignment", loads)
    with pytest.raises(LeewayError, match="no such wind process"):
        served.serve()
