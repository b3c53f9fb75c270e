"""The truck as a member of the fleet: what it is told, what its driver says, what it keeps."""

import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import NeighbourFleet
from companion.fleet.messages import (
    Answered,
    Command,
    Deed,
    Drive,
    EventKind,
    FleetEvent,
    Launch,
    PutOut,
    Recover,
    Result,
    Serve,
    State,
    Withdraw,
    decode_event,
    decode_result,
    decode_state,
    encode,
)
from companion.fleet.network import Ask, Asked, Told
from ground_station.app.truck.driver_console import obey
from ground_station.app.truck.truck_member import TruckMember
from ground_station.core.fleet.truck_state import TaskKind

TO_1 = Drive(stop="stop-1", lat_deg=55.1, lon_deg=8.1)
SERVE = Serve(assignment="o1.1", order="o1")
OUT = PutOut(assignment="o2.1", order="o2", vehicle="d1", lat_deg=55.0, lon_deg=8.0)
BACK = Recover(assignment="o2.1", vehicle="d1", lat_deg=55.0, lon_deg=8.0)


class Wire:
    """A link in memory: what was asked waits, what was told is kept."""

    def __init__(self) -> None:
        self.waiting: list[Asked] = []
        self.states: list[State] = []
        self.events: list[FleetEvent] = []

    def asked(self) -> list[Asked]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def be_woken(self, wake: Callable[[], None]) -> None:
        del wake

    def publish_state(self, raw: bytes) -> None:
        state = decode_state(raw)
        assert isinstance(state, State)
        self.states.append(state)

    def publish_event(self, raw: bytes) -> None:
        event = decode_event(raw)
        assert isinstance(event, FleetEvent)
        self.events.append(event)

    def publish_track(self, raw: bytes, cell: str) -> None:
        del raw, cell

    def hear_near(self, lat_deg: float, lon_deg: float) -> None:
        del lat_deg, lon_deg

    def hear_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        del neighbours

    def tracks(self) -> list[Told]:
        return []

    def winds(self) -> list[bytes]:
        return []

    def wind_cov_is_read(self) -> bool:
        return True

    def close(self) -> None:
        pass


class Terminal:
    """A truck's port and its wire, with a clock that stands."""

    def __init__(self, folder: Path) -> None:
        self.wire = Wire()
        self.port = TruckMember.open(
            "truck", folder, lambda life: self.wire,
            stop="depot", lat_deg=55.0, lon_deg=8.0, clock_s=lambda: 0.0, epoch_us=lambda: 0,
        )  # fmt: skip

    def ask(self, deed: Deed, id_: str) -> Result:
        life = self.port.member.life
        command = Command(id=id_, vehicle="truck", life=life, as_of_s=0.0, by="desk", deed=deed)
        replies: list[bytes] = []
        self.wire.waiting.append(Asked(Ask.COMMAND, replies.extend, encode(command)))
        self.port.turn()
        result = decode_result(replies[0])
        assert isinstance(result, Result)
        return result

    def state(self) -> State:
        self.port.publish()
        return self.wire.states[-1]

    def outcomes(self) -> list[tuple[str | None, str | None, bool | None]]:
        found = [e for e in self.wire.events if e.kind is EventKind.OUTCOME]
        return [(e.assignment, e.outcome, e.delivered) for e in found]


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[[], Terminal]]:
    """Starts the terminal, and again: over the same folder, as after a kill."""
    made: list[Terminal] = []

    def start() -> Terminal:
        made.append(Terminal(tmp_path))
        return made[-1]

    yield start
    for one in made:
        one.port.close()


def test_a_truck_drives_where_it_is_told_and_arrives_when_its_driver_says_so(terminal):
    truck = terminal()
    assert (truck.state().phase, truck.state().stop) == ("at_stop", "depot")
    assert truck.ask(TO_1, "c1").answer is Answered.DONE
    state = truck.state()
    assert (state.phase, state.stop, state.lat_deg) == ("driving", "stop-1", None)
    truck.port.confirm(truck.port.todo[0])
    state = truck.state()
    assert (state.phase, state.stop, state.lat_deg) == ("at_stop", "stop-1", 55.1)
    assert truck.ask(TO_1, "c2").answer is Answered.DONE  # it stands there
    assert truck.port.todo == []


def test_a_truck_with_something_to_do_here_does_not_leave(terminal):
    truck = terminal()
    for number, deed in enumerate((SERVE, OUT, BACK)):
        assert truck.ask(deed, f"c{number}").answer is Answered.DONE
        refused = truck.ask(TO_1, f"d{number}")
        assert refused.answer is Answered.REFUSED
        assert "still to do" in refused.reason
        truck.port.confirm(truck.port.todo[0])
    assert truck.ask(TO_1, "c9").answer is Answered.DONE


def test_what_the_driver_confirms_or_cannot_do_is_told_for_its_assignment(terminal):
    truck = terminal()
    for number, deed in enumerate((SERVE, OUT, BACK, Serve(assignment="o3.1", order="o3"))):
        truck.ask(deed, f"c{number}")
    serve, out, back, closed = truck.port.todo
    assert [t.kind for t in (serve, out, back)] == [
        TaskKind.SERVE, TaskKind.PUT_OUT, TaskKind.RECOVER,
    ]  # fmt: skip
    truck.port.confirm(serve)
    truck.port.confirm(back)
    truck.port.cannot(out, "a rotor is broken")
    truck.port.cannot(closed, "nobody at home")
    assert truck.outcomes() == [("o1.1", "SUC", True), ("o3.1", "ABRT", False)]
    told = [(e.kind, e.assignment) for e in truck.wire.events if e.kind in (
        EventKind.RECOVERED, EventKind.CANNOT, EventKind.PLACED)]  # fmt: skip
    assert told == [(EventKind.RECOVERED, "o2.1"), (EventKind.CANNOT, "o2.1")]
    with pytest.raises(LeewayError, match="not to be done"):
        truck.port.confirm(serve)


@pytest.mark.parametrize("gone", [True, False])
def test_a_drone_is_not_aboard_before_its_parcel_has_been_looked_for(terminal, gone):
    truck = terminal()
    truck.ask(msgspec.structs.replace(BACK, parcel="o2"), "c1")
    (back,) = truck.port.todo
    assert "is the parcel o2 still on it?" in back.words
    with pytest.raises(LeewayError, match="gone or still on it"):
        truck.port.confirm(back)
    assert truck.port.todo == [back]
    truck.port.confirm(back, gone=gone)
    told = [(e.order, e.delivered) for e in truck.wire.events if e.kind is EventKind.RECOVERED]
    assert told == [("o2", gone)]


@pytest.mark.parametrize(("typed", "gone"), [("1 gone", True), ("1 aboard", False)])
def test_what_the_driver_types_tells_where_the_parcel_is(terminal, typed, gone):
    truck, console = terminal(), Console(file=io.StringIO())
    truck.ask(msgspec.structs.replace(BACK, parcel="o2"), "c1")
    for line in ("", "1 maybe", "2 gone", "gone"):
        obey(truck.port, line, console)
        assert len(truck.port.todo) == 1, line
    obey(truck.port, typed, console)
    told = [e.delivered for e in truck.wire.events if e.kind is EventKind.RECOVERED]
    assert told == [gone]


def test_a_terminal_that_is_killed_knows_what_was_to_be_done_and_what_was(terminal):
    first = terminal()
    first.ask(SERVE, "c1")
    first.ask(OUT, "c2")
    first.port.confirm(first.port.todo[0])
    second = terminal()  # nobody closed the first
    assert [t.kind for t in second.port.todo] == [TaskKind.PUT_OUT]
    assert second.ask(SERVE, "c9").answer is Answered.DONE  # in other words: done before
    assert len(second.port.todo) == 1
    assert second.ask(Withdraw(assignment="o2.1"), "c10").answer is Answered.DONE
    assert second.port.todo == []


def test_a_withdrawal_that_comes_late_leaves_the_recovery_to_be_done(terminal):
    truck = terminal()
    assert truck.ask(BACK, "c1").answer is Answered.DONE
    assert truck.ask(Withdraw(assignment="o2.1"), "c2").answer is Answered.DONE
    assert [task.kind for task in truck.port.todo] == [TaskKind.RECOVER]


def test_a_truck_refuses_what_only_a_drone_can_do_and_is_told_nothing_on_its_way(terminal):
    truck = terminal()
    assert truck.ask(Launch(assignment="o1.1"), "c1").answer is Answered.REFUSED
    truck.ask(TO_1, "c2")
    assert truck.ask(SERVE, "c3").answer is Answered.LATER
    with pytest.raises(LeewayError, match="call the dispatcher"):
        truck.port.cannot(truck.port.todo[0], "a flat tyre")
