"""The truck as a fleet member: commands, driver reports, and stored state."""

import io
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from companion.core.base.errors import LeewayError
from companion.fleet.messages import (
    Command,
    CommandAction,
    CommandStatus,
    Drive,
    EventKind,
    Launch,
    PutOut,
    Recover,
    Result,
    Serve,
    State,
    Withdraw,
    decode_message,
    encode_message,
)
from companion.fleet.network import MemberRequest, RequestKind
from ground_station.app.truck.driver_console import execute_driver_input
from ground_station.app.truck.truck_member import TruckMember
from ground_station.core.fleet.truck_state import TaskKind
from tests.fleet.wire import Wire

TO_1 = Drive(stop="stop-1", lat_deg=55.1, lon_deg=8.1)
SERVE = Serve(assignment="o1.1", order="o1")
OUT = PutOut(assignment="o2.1", order="o2", vehicle="d1", lat_deg=55.0, lon_deg=8.0)
BACK = Recover(assignment="o2.1", vehicle="d1", lat_deg=55.0, lon_deg=8.0)


class Terminal:
    """A truck's port and its wire, with a constant clock."""

    def __init__(self, folder: Path) -> None:
        self.wire = Wire()
        self.port = TruckMember.load_or_create(
            "truck", folder, lambda life: self.wire,
            initial_stop="depot", lat_deg=55.0, lon_deg=8.0, clock_s=lambda: 0.0,
            epoch_us=lambda: 0,
        )  # fmt: skip

    def ask(self, deed: CommandAction, id_: str) -> Result:
        life = self.port.member.instance_id
        command = Command(
            id=id_, vehicle="truck", instance_id=life, as_of_s=0.0, by="desk", action=deed
        )
        replies: list[bytes] = []
        self.wire.waiting.append(
            MemberRequest(RequestKind.COMMAND, replies.extend, encode_message(command))
        )
        self.port.process_commands()
        result = decode_message(Result, replies[0])
        assert isinstance(result, Result)
        return result

    def state(self) -> State:
        self.port.publish_state_if_due()
        return self.wire.states[-1]

    def outcomes(self) -> list[tuple[str | None, str | None, bool | None]]:
        found = [e for e in self.wire.events if e.kind is EventKind.OUTCOME]
        return [(e.assignment, e.outcome, e.delivered) for e in found]


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[[], Terminal]]:
    """Start the terminal; repeated calls use the same folder, as after a kill."""
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
    assert truck.ask(TO_1, "c1").status is CommandStatus.DONE
    state = truck.state()
    assert (state.phase, state.stop, state.lat_deg) == ("driving", "stop-1", None)
    truck.port.report_task_done(truck.port.tasks[0])
    state = truck.state()
    assert (state.phase, state.stop, state.lat_deg) == ("at_stop", "stop-1", 55.1)
    assert truck.ask(TO_1, "c2").status is CommandStatus.DONE  # it is already there
    assert truck.port.tasks == []


def test_a_truck_with_something_to_do_here_does_not_leave(terminal):
    truck = terminal()
    for number, deed in enumerate((SERVE, OUT, BACK)):
        assert truck.ask(deed, f"c{number}").status is CommandStatus.DONE
        refused = truck.ask(TO_1, f"d{number}")
        assert refused.status is CommandStatus.REFUSED
        assert "unfinished task" in refused.reason
        truck.port.report_task_done(truck.port.tasks[0])
    assert truck.ask(TO_1, "c9").status is CommandStatus.DONE


def test_what_the_driver_confirms_or_cannot_do_is_told_for_its_assignment(terminal):
    truck = terminal()
    for number, deed in enumerate((SERVE, OUT, BACK, Serve(assignment="o3.1", order="o3"))):
        truck.ask(deed, f"c{number}")
    serve, out, back, closed = truck.port.tasks
    assert [t.kind for t in (serve, out, back)] == [
        TaskKind.SERVE, TaskKind.PUT_OUT, TaskKind.RECOVER,
    ]  # fmt: skip
    truck.port.report_task_done(serve)
    truck.port.report_task_done(back)
    truck.port.report_task_not_possible(out, "a rotor is broken")
    truck.port.report_task_not_possible(closed, "nobody at home")
    assert truck.outcomes() == [("o1.1", "SUC", True), ("o3.1", "ABRT", False)]
    told = [(e.kind, e.assignment) for e in truck.wire.events if e.kind in (
        EventKind.RECOVERED, EventKind.TASK_FAILED, EventKind.DRONE_ON_PAD)]  # fmt: skip
    assert told == [(EventKind.RECOVERED, "o2.1"), (EventKind.TASK_FAILED, "o2.1")]
    with pytest.raises(LeewayError, match="no such task"):
        truck.port.report_task_done(serve)


@pytest.mark.parametrize("gone", [True, False])
def test_a_drone_is_not_aboard_before_its_parcel_has_been_looked_for(terminal, gone):
    truck = terminal()
    truck.ask(msgspec.structs.replace(BACK, parcel="o2"), "c1")
    (back,) = truck.port.tasks
    assert "is the parcel o2 still on it?" in back.driver_instruction
    with pytest.raises(LeewayError, match="gone or still on it"):
        truck.port.report_task_done(back)
    assert truck.port.tasks == [back]
    truck.port.report_task_done(back, parcel_is_missing=gone)
    told = [(e.order, e.delivered) for e in truck.wire.events if e.kind is EventKind.RECOVERED]
    assert told == [("o2", gone)]


@pytest.mark.parametrize(
    ("typed", "gone", "pack"),
    [("1 gone", True, None), ("1 aboard", False, None), ("1 gone P7", True, "P7")],
)
def test_what_the_driver_types_tells_where_parcel_and_pack_are(terminal, typed, gone, pack):
    truck, console = terminal(), Console(file=io.StringIO())
    truck.ask(msgspec.structs.replace(BACK, parcel="o2"), "c1")
    for line in ("", "1 maybe", "2 gone", "gone", "1 gone P7 P8", "1 gone -"):
        execute_driver_input(truck.port, line, console)
        assert len(truck.port.tasks) == 1, line
    execute_driver_input(truck.port, typed, console)
    told = [
        (e.delivered, e.fitted_pack or None)
        for e in truck.wire.events
        if e.kind is EventKind.RECOVERED
    ]
    assert told == [(gone, pack)]


def test_a_terminal_that_is_killed_knows_what_was_to_be_done_and_what_was(terminal):
    first = terminal()
    first.ask(SERVE, "c1")
    first.ask(OUT, "c2")
    first.port.report_task_done(first.port.tasks[0])
    second = terminal()  # the first was not closed
    assert [t.kind for t in second.port.tasks] == [TaskKind.PUT_OUT]
    assert second.ask(SERVE, "c9").status is CommandStatus.DONE  # new identifier: already done
    assert len(second.port.tasks) == 1
    assert second.ask(Withdraw(assignment="o2.1"), "c10").status is CommandStatus.DONE
    assert second.port.tasks == []


def test_a_withdrawal_that_comes_late_leaves_the_recovery_to_be_done(terminal):
    truck = terminal()
    assert truck.ask(BACK, "c1").status is CommandStatus.DONE
    assert truck.ask(Withdraw(assignment="o2.1"), "c2").status is CommandStatus.DONE
    assert [task.kind for task in truck.port.tasks] == [TaskKind.RECOVER]


def test_a_truck_refuses_what_only_a_drone_can_do_and_is_told_nothing_on_its_way(terminal):
    truck = terminal()
    assert truck.ask(Launch(assignment="o1.1"), "c1").status is CommandStatus.REFUSED
    truck.ask(TO_1, "c2")
    assert truck.ask(SERVE, "c3").status is CommandStatus.LATER
    with pytest.raises(LeewayError, match="call the dispatcher"):
        truck.port.report_task_not_possible(truck.port.tasks[0], "a flat tyre")
