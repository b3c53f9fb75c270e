"""The vehicle's side of the fleet link without a network: stored state, and storage failures."""

import contextlib
import errno
import json
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.adapters.clock import unix_time_us, wall_s
from companion.app.flight import fleet_port
from companion.app.flight.assignment import MISSION, load_current_assignment, write_assignment
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions, Settings
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Decision
from companion.core.mission.event_text import DecisionEvent
from companion.core.pilot.telemetry_state import TelemetryState
from companion.fleet import member as fleet_member
from companion.fleet.command_log import CommandReply
from companion.fleet.event_log import (
    MAX_EVENTS,
    MAX_EVENTS_PER_REPLY,
    REWRITE_SURPLUS,
    SEQ_GAP_AT_RESTART,
    EventLog,
)
from companion.fleet.identity import TLS_CERTIFICATE, read_and_verify_identity
from companion.fleet.member import FleetMember
from companion.fleet.messages import (
    Assign,
    Command,
    CommandAction,
    CommandStatus,
    EventKind,
    FleetEvent,
    Launch,
    Recall,
    Result,
    State,
    decode_message,
)
from companion.fleet.messages import encode_message as encoded
from companion.fleet.network import MemberRequest, RequestKind
from companion.fleet.roles import Role
from companion.fleet.signed_link import SignedLink
from companion.fleet.trust import MemberTrust
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.pki.pki_folder import PkiFolder, utc_datetime
from ground_station.core.dispatch.flight_tables import depot_delivery_flight_table
from tests.fleet.wire import valid_from
from tests.fleet.zenoh_net import AT_HARBOUR, Vehicle, config_file, free_port

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
OPTIONS = RunOptions("memory", "m100", Path(), Path())
SETTINGS = Settings.read_settings_files(OPTIONS)


def an_event(text: str, kind: EventKind = EventKind.TEXT) -> FleetEvent:
    return FleetEvent(vehicle="d1", log="x", seq=1, epoch_us=0, kind=kind, text=text)


@pytest.fixture
def port(tmp_path: Path) -> Any:
    nowhere = config_file(tmp_path / "v.json5", connect=free_port())
    vehicle = Vehicle("d1", tmp_path / "d1", nowhere)
    vehicle.stop()
    yield vehicle.port
    vehicle.port.close()


def ask(port: fleet_port.FleetPort, deed: CommandAction, id_: str = "c1") -> Result:
    """Pass the port a command as its link would."""
    replies: list[bytes] = []
    command = Command(
        id=id_,
        vehicle="d1",
        instance_id=port.member.instance_id,
        as_of_s=port.member.uptime_s,
        by="desk",
        action=valid_from(deed, port.member.instance_id, port.member.uptime_s),
    )
    port.member.link.request_queues.add_request_and_call_back(
        MemberRequest(RequestKind.COMMAND, replies.extend, encoded(command))
    )
    port.process_commands(lambda asked: CommandReply(CommandStatus.DONE, "done"))
    (raw,) = replies
    result = decode_message(Result, raw)
    assert isinstance(result, Result)
    return result


def test_a_confirmed_release_is_reported_with_its_position_and_evidence(port):
    port.publish_state_if_due("release", TelemetryState(position=AT_HARBOUR))
    port.report_action_to_desk(Decision(2.0, "delivered", "hover power fell by 33 %"))
    known = DecisionEvent.parse(port.member.log.next_stored_events_after(0)[-1].text)
    assert known.release_evidence == "hover power fell by 33 %"
    expected = (AT_HARBOUR.lat_deg, AT_HARBOUR.lon_deg)
    assert known.release_position == pytest.approx(expected, abs=1e-6)
    earlier_version = DecisionEvent.parse("delivered: hover power fell by 33 %")
    assert earlier_version.release_position is None
    assert earlier_version.release_evidence == known.release_evidence


def test_on_a_full_disk_nothing_is_launched_but_a_recall_is_taken(port, monkeypatch):
    def full(*args: Any, **more: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(fleet_member, "write_json_atomically", full)
        launch = ask(port, Launch(assignment="a1"))
        assert (launch.status, launch.reason) == (
            CommandStatus.LATER,
            "cannot store the command: No space left on device",
        )
        assert ask(port, Recall(), "c2").status is CommandStatus.DONE
    assert ask(port, Launch(assignment="a1")).status is CommandStatus.DONE


def written(port: fleet_port.FleetPort, deed: Assign) -> LoadedFlight:
    return write_assignment(deed, port, OPTIONS, SETTINGS)


def test_a_flight_that_the_vehicle_may_not_fly_is_refused_in_words(port):
    good = depot_delivery_flight_table(DAY.day, DAY.day.drones[0], DAY.orders[0])
    deed = Assign(assignment="a1", order="o1", flight=good, obstacles=DAY.no_fly)
    path = written(port, deed).options.mission
    assert json.loads(path.read_text())["site"]["obstacles"] == "obstacles.geojson"
    for change, words in (
        ({"vehicle": good["vehicle"] | {"airframe": "octo8"}}, "this is m100"),
        ({"vehicle": good["vehicle"] | {"payload_kg": 7.5}}, "at most 1"),
        ({"site": good["site"] | {"obstacles": "/etc/passwd"}}, "site.obstacles"),
        (
            {"site": good["site"] | {"terrain": {"kind": "grid", "grid": "/etc/passwd"}}},
            "site.terrain.grid",
        ),
        ({"colour": "red"}, "colour"),
        ({"mission": good["mission"] | {"max_loss": 3.0}}, "mission.max_loss"),
        ({"mission": good["mission"] | {"wind_process": "moon"}}, "no such wind process"),
        ({"site": "here"}, "expected a table"),
    ):
        deed = Assign(assignment="a2", order="o1", flight=good | change)
        with pytest.raises(LeewayError, match=words):
            written(port, deed)


NASTY = st.sampled_from(
    [None, True, -1, 0, 1e308, -1e308, 10**30, "", "moon", "../../etc/passwd", "\x00", [], {}, [[]]]
)


def replaced(tree: Any, path: list[int], value: Any) -> Any:
    """Return the tree with one branch, located by indices, replaced."""
    if not isinstance(tree, dict | list) or not tree or not path:
        return value
    keys = list(tree) if isinstance(tree, dict) else list(range(len(tree)))
    key, copy = keys[path[0] % len(keys)], tree.copy()
    copy[key] = replaced(tree[key], path[1:], value)
    return copy


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    in_flight=st.booleans(),
    path=st.lists(st.integers(0, 30), min_size=1, max_size=6),
    value=NASTY,
)
def test_a_mutated_assignment_is_loaded_whole_or_refused_in_words(port, in_flight, path, value):
    flight = depot_delivery_flight_table(DAY.day, DAY.day.drones[0], DAY.orders[0])
    assert DAY.no_fly is not None
    flight = replaced(flight, path, value) if in_flight else flight
    no_fly = DAY.no_fly if in_flight else replaced(DAY.no_fly, path, value)
    if not isinstance(flight, dict) or not isinstance(no_fly, dict | None):
        return
    with contextlib.suppress(LeewayError):
        written(port, Assign(assignment="a1", order="o1", flight=flight, obstacles=no_fly))


def aboard(port: fleet_port.FleetPort, **mission: object) -> Path:
    """Store an assignment as an earlier version may have left it; return its flight file."""
    table = depot_delivery_flight_table(DAY.day, DAY.day.drones[0], DAY.orders[0])
    table["mission"] |= mission
    port.store_assignment(fleet_port.StoredAssignment(assignment="a1", order="o1"))
    path = port.assignment_folder("a1") / MISSION
    path.parent.mkdir()
    path.write_text(json.dumps(table))
    return path


def taken_up(port: fleet_port.FleetPort) -> Any:
    return load_current_assignment(port, OPTIONS, SETTINGS)


def test_a_bad_assignment_aboard_at_a_restart_is_refused_and_the_companion_stands_by(port):
    aboard(port, wind_process="moon")
    assert taken_up(port) is None
    assert port.current is None
    (told,) = [
        e for e in port.member.log.next_stored_events_after(0) if e.kind is EventKind.OUTCOME
    ]
    assert (told.outcome, told.home, told.assignment) == ("ABRT", True, "a1")
    assert "no such wind process" in told.text
    again = ask(port, Launch(assignment="a1"))
    assert (again.status, again.reason) == (CommandStatus.REFUSED, "assignment a1 is closed")


def test_a_flight_that_began_and_cannot_be_read_any_more_is_not_said_to_be_home(port):
    path = aboard(port)
    (path.parent / "checkpoint.json").write_text("{}")
    path.write_text("torn")
    assert taken_up(port) is None
    (told,) = [
        e for e in port.member.log.next_stored_events_after(0) if e.kind is EventKind.OUTCOME
    ]
    assert (told.outcome, told.home, told.drop_unproven) == ("FAIL", False, True)


def test_a_good_assignment_aboard_at_a_restart_is_gone_on_with(port):
    aboard(port)
    assert taken_up(port).flight.mission.wind_process == "coast"
    assert port.current is not None


def test_a_record_of_the_assignment_that_is_torn_is_moved_aside(tmp_path):
    folder = tmp_path / "d1"
    folder.mkdir()
    (folder / fleet_port.CURRENT).write_text('{"content": "{}", "crc32": 1}')
    nowhere = config_file(tmp_path / "v.json5", connect=free_port())
    vehicle = Vehicle("d1", folder, nowhere)
    vehicle.close()
    assert vehicle.port.current is None
    assert (folder / "current.broken").exists()
    assert "moved aside" in vehicle.port.member.log.next_stored_events_after(0)[0].text


def test_events_outlive_a_kill_and_a_torn_last_line_is_left_out(tmp_path):
    path = tmp_path / "events.jsonl"
    first = EventLog(path)
    for n in range(3):
        first.number_and_store_event(an_event(f"words {n}"))
    path.write_bytes(path.read_bytes()[:-20])
    again = EventLog(path)
    assert (again.log, again.last_stored_seq) == (first.log, 2)
    assert (
        again.number_and_store_event(an_event("next")).seq == 2 + SEQ_GAP_AT_RESTART
    )  # 3 may have been sent before the cut
    assert [e.text for e in again.next_stored_events_after(1)] == ["words 1", "next"]
    first.close()
    again.close()


def test_a_vehicle_without_a_ground_keeps_its_newest_events_and_never_fills_its_disk(tmp_path):
    log = EventLog(tmp_path / "events.jsonl")
    for n in range(MAX_EVENTS + REWRITE_SURPLUS + 5):
        log.number_and_store_event(an_event(f"{n}"))
    kept = len((tmp_path / "events.jsonl").read_bytes().splitlines())
    assert kept == MAX_EVENTS + 4
    oldest = log.next_stored_events_after(0)
    assert len(oldest) == MAX_EVENTS_PER_REPLY
    assert oldest[0].seq == REWRITE_SURPLUS + 2
    assert log.next_stored_events_after(log.last_stored_seq) == []
    log.close()


def test_an_outcome_is_known_again_after_a_restart(tmp_path):
    log = EventLog(tmp_path / "events.jsonl")
    event = FleetEvent(
        vehicle="d1", log="x", seq=1, epoch_us=0, kind=EventKind.OUTCOME, text="", assignment="a1"
    )
    log.number_and_store_event(event)
    log.close()
    again = EventLog(tmp_path / "events.jsonl")
    assert again.has_stored_outcome("a1")
    assert not again.has_stored_outcome("a2")
    again.close()


@pytest.mark.parametrize(
    "deed", [Launch(assignment="a1"), Assign(assignment="a1", order="o1", flight={})]
)
def test_no_flight_begins_that_would_outlast_the_certificate_and_a_recall_is_taken(port, deed):
    deed = valid_from(deed, port.member.instance_id, port.member.uptime_s)
    assert ask(port, deed).status is CommandStatus.DONE
    port.start_refusal_reason = lambda: "the certificate of d1 ends in 9 min"
    assert (
        ask(port, deed).status is CommandStatus.DONE
    )  # already answered: known, not started again
    refused = ask(port, deed, "c2")
    assert (refused.status, refused.reason) == (
        CommandStatus.REFUSED,
        "the certificate of d1 ends in 9 min",
    )
    assert ask(port, Recall(), "c3").status is CommandStatus.DONE


def test_what_is_aboard_stays_aboard_when_the_certificate_ends(port):
    port.store_assignment(fleet_port.StoredAssignment(assignment="a1", order="o1"))
    port.start_refusal_reason = lambda: "the certificate of d1 ends in 9 min"
    again = Assign(assignment="a1", order="o1", flight={})
    assert ask(port, again).status is CommandStatus.DONE


@pytest.mark.parametrize("carried", [False, True], ids=["not carried", "canary: carried"])
def test_a_launch_waits_until_the_renewed_certificate_is_carried(port, tmp_path, carried):
    """The desk sends the new roster immediately; the vehicle's certificate is in its folder."""
    pki = PkiFolder.create_fleet(
        tmp_path / "pki", "harbour", utc_datetime(unix_time_us()) - timedelta(days=365)
    )
    pki.add_member("desk", Role.DESK, 800, "")
    pki.add_member("d1", Role.VEHICLE, 365, "")
    home = pki.folder / "members" / "d1"
    d1, desk = (
        read_and_verify_identity(home).trust,
        read_and_verify_identity(pki.folder / "members" / "desk").trust,
    )
    old = (home / TLS_CERTIFICATE).read_bytes()
    pki.renew_member_certificates(["d1"], 800)
    if not carried:
        (home / TLS_CERTIFICATE).write_bytes(old)
    wire = port.member.link
    port.member.link = SignedLink(wire, d1, port.member.instance_id, wall_s)
    port.start_refusal_reason = lambda: d1.certificate_error_within(3600.0)
    roster = (pki.folder / "roster.json").read_bytes()
    wire.request_queues.add_request_and_call_back(
        MemberRequest(RequestKind.ROSTER, lambda replies: None, roster)
    )
    port.process_commands(lambda asked: CommandReply(CommandStatus.DONE, "done"))
    assert d1.roster.number == pki.roster.number
    result = ask_signed(port, wire, desk, Launch(assignment="a1"))
    assert result.status is (CommandStatus.DONE if carried else CommandStatus.REFUSED)
    assert carried or "copy tls.pem to d1" in result.reason


def ask_signed(
    port: fleet_port.FleetPort, wire: Any, desk: MemberTrust, deed: CommandAction
) -> Result:
    """Return the vehicle's signed reply to a command that the desk signed."""
    replies: list[bytes] = []
    made = {
        "id": "c1",
        "vehicle": "d1",
        "instance_id": port.member.instance_id,
        "as_of_s": 0.0,
        "by": "desk",
    }
    command = desk.sign_in_envelope(
        "command", encoded(Command(**made, action=valid_from(deed, port.member.instance_id, 0.0)))
    )
    wire.request_queues.add_request_and_call_back(
        MemberRequest(RequestKind.COMMAND, replies.extend, command)
    )
    port.process_commands(lambda asked: CommandReply(CommandStatus.DONE, "done"))
    (sealed,) = replies
    raw = desk.verify_message_of_signer("result", sealed, "d1")
    assert isinstance(raw, bytes), raw
    result = decode_message(Result, raw)
    assert isinstance(result, Result)
    return result


class HeldDisk:
    """A card that is busy until `let_go`: all writes wait; `full` accepts none."""

    def __init__(self) -> None:
        self.waiting: list[Any] = []
        self.full = False

    def submit_write_job(
        self,
        record: str,
        deed: Any,
        *,
        is_replaced_at_each_write: bool = False,
        replace_queued_job: bool = False,
    ) -> bool:
        if not self.full:
            self.waiting.append(deed)
        return not self.full

    def let_go(self) -> None:
        while self.waiting:
            self.waiting.pop(0)()

    wait_until_done = close = let_go


class HandLink:
    """A manual network: requests are put in `waiting`, published messages are kept in lists."""

    trust = None

    def __init__(self) -> None:
        self.waiting: list[MemberRequest] = []
        self.events: list[FleetEvent] = []
        self.states: list[State] = []

    def drain_requests(self) -> list[MemberRequest]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def publish_event(self, raw: bytes) -> None:
        event = decode_message(FleetEvent, raw)
        assert isinstance(event, FleetEvent)
        self.events.append(event)

    def publish_state(self, raw: bytes) -> None:
        state = decode_message(State, raw)
        assert isinstance(state, State)
        self.states.append(state)

    def close(self) -> None:
        pass


class OnBusyDisk:
    """A member whose disk is busy: its commands, its replies, and the executed commands."""

    def __init__(self, folder: Path) -> None:
        self.link, self.disk = HandLink(), HeldDisk()
        self.member = FleetMember.restore_and_open_link(
            "d1", folder, lambda life: self.link, disk=self.disk
        )
        self.done: list[CommandAction] = []
        self.answers: dict[str, list[bytes]] = {}

    def ask(self, deed: CommandAction, id_: str) -> None:
        command = Command(
            id=id_,
            vehicle="d1",
            instance_id=self.member.instance_id,
            as_of_s=0.0,
            by="desk",
            action=valid_from(deed, self.member.instance_id, 0.0),
        )
        replies = self.answers.setdefault(id_, [])
        self.link.waiting.append(
            MemberRequest(RequestKind.COMMAND, replies.extend, encoded(command))
        )

    def turn(self) -> None:
        def carry_out(command: Command) -> CommandReply:
            self.done.append(command.action)
            return CommandReply(CommandStatus.DONE)

        self.member.process_requests_and_publish_events(carry_out)

    def answer(self, id_: str) -> tuple[CommandStatus, str] | None:
        results = [decode_message(Result, raw) for raw in self.answers[id_]]
        assert all(isinstance(result, Result) for result in results)
        return (results[-1].status, results[-1].reason) if results else None


@pytest.fixture
def on_busy_disk(tmp_path: Path) -> Any:
    one = OnBusyDisk(tmp_path / "d1")
    yield one
    one.member.close()


def test_a_launch_is_carried_out_once_it_lies_on_the_disk_and_nobody_waits_for_it(on_busy_disk):
    one = on_busy_disk
    one.ask(Launch(assignment="a1"), "c1")
    one.turn()
    one.turn()
    assert (one.done, one.answer("c1")) == ([], None)
    one.disk.let_go()
    one.turn()
    assert [type(deed) for deed in one.done] == [Launch]
    assert one.answer("c1") == (CommandStatus.DONE, "")


def test_a_recall_waits_for_no_disk_and_a_launch_behind_it_is_not_carried_out(on_busy_disk):
    one = on_busy_disk
    one.ask(Launch(assignment="a1"), "c1")
    one.turn()
    one.ask(Recall(), "c2")
    one.turn()
    assert one.done == [Recall()]
    assert one.answer("c2") == (CommandStatus.DONE, "")
    assert one.answer("c1") == (CommandStatus.LATER, "superseded by recall (c2)")
    one.disk.let_go()
    one.turn()
    assert one.done == [Recall()]


def test_a_launch_comes_once_though_the_desk_asks_again_while_it_is_written(on_busy_disk):
    one = on_busy_disk
    for _ in range(3):
        one.ask(Launch(assignment="a1"), "c1")
        one.turn()
    one.disk.let_go()
    one.turn()
    one.turn()
    assert [type(deed) for deed in one.done] == [Launch]


def test_nobody_hears_of_an_outcome_that_does_not_lie_on_the_disk_yet(on_busy_disk):
    one = on_busy_disk
    one.member.record_event(EventKind.OUTCOME, "home", outcome="SUC", delivered=True, home=True)
    one.turn()
    one.member.publish_state("m100", 1.0, "standby")
    assert (one.link.events, one.link.states[-1].last_seq) == ([], 0)
    assert one.member.log.next_stored_events_after(0) == []
    one.disk.let_go()
    one.turn()
    one.member.publish_state("m100", 1.0, "standby")
    assert [event.outcome for event in one.link.events] == ["SUC"]
    assert one.link.states[-1].last_seq == one.link.events[0].seq
    one.turn()
    assert len(one.link.events) == 1


def test_where_the_disk_takes_no_more_it_is_told_all_the_same_and_nothing_is_launched(on_busy_disk):
    one = on_busy_disk
    one.disk.full = True
    one.member.record_event(EventKind.OUTCOME, "home", outcome="SUC", delivered=True, home=True)
    one.ask(Launch(assignment="a1"), "c1")
    one.turn()
    one.member.publish_state("m100", 1.0, "standby")
    assert [event.outcome for event in one.link.events] == ["SUC"]
    assert "in memory only" in one.link.states[-1].text
    assert one.done == []
    assert one.answer("c1") == (
        CommandStatus.LATER,
        "cannot store the command: the disk queue is full",
    )


def test_what_waits_for_the_disk_when_a_member_leaves_is_written_and_told(on_busy_disk):
    one = on_busy_disk
    one.member.record_event(EventKind.OUTCOME, "home", outcome="SUC", delivered=True, home=True)
    one.member.close()
    assert [event.outcome for event in one.link.events] == ["SUC"]
    again = EventLog(one.member.folder / "events.jsonl")
    assert [event.outcome for event in again.next_stored_events_after(0)] == ["SUC"]
    again.close()
