"""One member floods the desk: messages and replies of others still arrive.

Judged by counts and order, never by the speed of this machine.
"""

from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.fleet.envelope import MAX_OVERHEAD_BYTES
from companion.fleet.messages import (
    MAX_MESSAGE_BYTES,
    CommandStatus,
    EventKind,
    FleetEvent,
    Recall,
    Refused,
    Result,
    encode_message,
)
from ground_station.adapters import fleet_inbox
from ground_station.adapters.fleet_inbox import (
    EVENTS_BURST,
    EVENTS_PER_CYCLE,
    MAX_INSTANCES,
    MAX_MEMBERS,
    NOT_ON_ROSTER,
    REQUESTED_STATES_PER_CYCLE,
    STATES_PER_CYCLE,
    FleetInbox,
)
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk import exchange as exchange_module
from ground_station.app.desk.exchange import (
    RETRY_DELAY_S,
    STATE_REQUEST_MIN_INTERVAL_S,
    FleetExchange,
)
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    EventsReceived,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)
from tests.ground_station.desk_parts import HandClock, Wire, a_state

FLOOD = 30_000
"""Three seconds of 10,000 messages."""


def key(vehicle: str, kind: str) -> str:
    return f"leeway/harbour/vehicle/{vehicle}/{kind}"


def event(vehicle: str, seq: int) -> bytes:
    told = FleetEvent(
        vehicle=vehicle, log="l", seq=seq, epoch_us=0, kind=EventKind.TEXT, text=f"words {seq}"
    )
    return encode_message(told)


def state(vehicle: str, uptime_s: float, last_seq: int = 0) -> bytes:
    return encode_message(a_state(vehicle, uptime_s=uptime_s, last_seq=last_seq))


class Inboxed(Wire):
    """A network whose messages are put in the desk's inbox; it counts the requests."""

    def __init__(self, clock: HandClock) -> None:
        super().__init__()
        self.inbox = FleetInbox(clock_s=clock.monotonic_s)
        self.states_asked = 0
        self.events_asked: list[tuple[str, int]] = []

    def receive(self, wait_s: float) -> list[Any]:
        return self.inbox.wait_and_pop_inputs(0.0)

    def request_states(self, wait_s: float) -> None:
        self.states_asked += 1

    def request_events(self, vehicle: str, after: int, wait_s: float) -> None:
        self.events_asked.append((vehicle, after))


@pytest.fixture
def desk(tmp_path: Path) -> Any:
    clock = HandClock()
    store = Store(Database(f"sqlite:///{tmp_path}/desk.db", durable=False), clock.epoch_us)
    said: list[str] = []
    exchange = FleetExchange(store, Inboxed(clock), said.append, clock=clock)
    exchange.request_initial_states()
    yield exchange, clock, said
    store.close()


def flood(inbox: FleetInbox, vehicle: str = "d1") -> None:
    for seq in range(1, FLOOD + 1):
        inbox.add_event(key(vehicle, "event"), event(vehicle, seq))
        inbox.add_state(key(vehicle, "state"), state(vehicle, float(seq), seq))


@contextmanager
def counted(database: Database, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Count the write transactions in this context."""
    count = [0]
    write: Callable[..., Any] = Database.write

    def counting(self: Database, **more: Any) -> Any:
        count[0] += 1
        return write(self, **more)

    with monkeypatch.context() as patch:
        patch.setattr(Database, "write", counting)
        yield count


@pytest.mark.parametrize("guarded", [True, False], ids=["limited", "canary"])
def test_of_a_flood_a_turn_takes_a_few_and_everything_of_the_others(monkeypatch, guarded):
    if not guarded:
        monkeypatch.setattr(fleet_inbox.RateLimit, "try_consume_tokens", lambda *_: True)
    inbox = FleetInbox(clock_s=lambda: 0.0)
    flood(inbox)
    inbox.add_event(key("d2", "event"), event("d2", 1))
    inbox.add_state(key("d2", "state"), state("d2", 1.0, 1))
    inbox.add_command_response("c1", None)
    found = inbox.wait_and_pop_inputs(0.0)
    kinds = [type(x) for x in found]
    assert kinds.index(CommandResponse) == EVENTS_PER_CYCLE + 1  # after the events, including d2's
    of_d1 = [x for x in found if isinstance(x, EventsReceived) and x.vehicle == "d1"]
    of_d2 = [x for x in found if isinstance(x, EventsReceived) and x.vehicle == "d2"]
    states = [x.state for x in found if isinstance(x, StateReceived)]
    assert (len(of_d1), len(of_d2)) == (EVENTS_PER_CYCLE, 1)
    assert [(s.vehicle, s.uptime_s) for s in states] == [("d1", float(FLOOD)), ("d2", 1.0)]
    rejected = [(x.key, x.count) for x in found if isinstance(x, MessageRejected)]
    assert rejected == ([("d1", FLOOD - EVENTS_BURST)] if guarded else [])


def test_the_flood_of_one_leaves_the_others_acknowledgement_and_event_in_the_next_turn(
    desk, monkeypatch
):
    exchange, _, said = desk
    inbox = exchange.fleet.inbox
    exchange.store.enqueue_command("c1", "d2", Recall(), "desk")
    flood(inbox)
    inbox.add_event(key("d2", "event"), event("d2", 1))
    done = Result(id="c1", vehicle="d2", instance_id="a", status=CommandStatus.DONE)
    inbox.add_command_response("c1", done)
    with counted(exchange.store.database, monkeypatch) as written:
        exchange.receive_and_process_messages(0.0)
    assert [command.response for command in exchange.store.commands()] == [CommandStatus.DONE]
    assert any(e.vehicle == "d2" for e in exchange.store.events())
    assert written[0] == 2  # the reply, and all events
    assert sum("rejected" in words for words in said) == 1


def test_canary_without_limit_and_batch_the_flood_is_taken_whole_and_one_by_one(desk, monkeypatch):
    exchange, _, _ = desk
    inbox = exchange.fleet.inbox
    monkeypatch.setattr(fleet_inbox, "EVENTS_PER_CYCLE", FLOOD)
    monkeypatch.setattr(fleet_inbox.RateLimit, "try_consume_tokens", lambda *_: True)
    monkeypatch.setattr(fleet_inbox, "EVENTS_BURST", FLOOD)
    for seq in range(1, 501):
        inbox.add_event(key("d1", "event"), event("d1", seq))

    def one_by_one(self: Store, batches: Any) -> list[FleetEvent]:
        return [
            e
            for events, replayed in batches
            for e in self._record_event_batches_in_transaction([(events, replayed)])
        ]

    monkeypatch.setattr(Store, "record_event_batches", one_by_one)
    with counted(exchange.store.database, monkeypatch) as written:
        exchange.receive_and_process_messages(0.0)
    assert written[0] == 500


def test_what_a_rate_left_out_is_asked_for_again(desk):
    exchange, _, _ = desk
    inbox = exchange.fleet.inbox
    inbox.record_instance_presence("d1", "a", has_joined=True)
    for seq in range(1, EVENTS_BURST + 11):
        inbox.add_event(key("d1", "event"), event("d1", seq))
    for _ in range(EVENTS_BURST // EVENTS_PER_CYCLE):
        exchange.receive_and_process_messages(0.0)
    inbox.add_state(key("d1", "state"), state("d1", 1.0, EVENTS_BURST + 10))
    exchange.receive_and_process_messages(0.0)
    assert exchange.fleet.events_asked == [("d1", EVENTS_BURST)]
    missed = [event("d1", n) for n in range(EVENTS_BURST + 1, EVENTS_BURST + 11)]
    inbox.add_events_of_query_reply("d1", missed)
    exchange.receive_and_process_messages(0.0)
    assert len(exchange.store.events()) == EVENTS_BURST + 10


@pytest.mark.sample
def test_a_member_that_always_has_more_events_is_asked_ever_more_rarely(desk, monkeypatch):
    monkeypatch.setattr(exchange_module, "EVENT_REPLAY_RATE_HZ", 1.0)
    monkeypatch.setattr(exchange_module, "EVENT_REPLAY_BURST", 40.0)
    exchange, clock, _ = desk
    inbox = exchange.fleet.inbox
    inbox.record_instance_presence("d1", "a", has_joined=True)
    batch, seconds, told = 10, 60, 0
    for second in range(seconds):
        clock.t_s = float(second)
        inbox.add_state(key("d1", "state"), state("d1", float(second), 10**6))
        before = len(exchange.fleet.events_asked)
        exchange.receive_and_process_messages(0.0)
        if len(exchange.fleet.events_asked) > before:
            inbox.add_events_of_query_reply(
                "d1", [event("d1", told + n) for n in range(1, batch + 1)]
            )
            told += batch
    assert told <= 40 + 1 * seconds + batch


def test_all_are_asked_for_their_states_once_however_many_join(desk):
    exchange, clock, _ = desk
    fleet = exchange.fleet
    for number in range(500):
        fleet.inbox.record_instance_presence(f"d{number}", "a", has_joined=True)
        exchange.receive_and_process_messages(0.0)
    assert fleet.states_asked == 1  # at the start
    clock.t_s = STATE_REQUEST_MIN_INTERVAL_S
    exchange.receive_and_process_messages(0.0)
    exchange.receive_and_process_messages(0.0)
    assert fleet.states_asked == 2


def test_all_are_asked_for_their_states_once_a_minute_where_nobody_joins(desk):
    exchange, clock, _ = desk
    for second in range(1, 181):
        clock.t_s = float(second)
        exchange.receive_and_process_messages(0.0)
    assert exchange.fleet.states_asked == 1 + 3


def test_a_roll_call_finds_who_was_missed_and_nobody_who_left_meanwhile():
    inbox = FleetInbox(clock_s=lambda: 0.0)
    inbox.record_instance_presence("d1", "a", has_joined=True)
    inbox.wait_and_pop_inputs(0.0)
    inbox.clear_departed_before_liveliness_query()
    inbox.record_instance_presence("d1", "a", has_joined=False)
    inbox.add_liveliness_reply("d1", "a")
    inbox.add_liveliness_reply("d2", "b")
    inbox.add_liveliness_reply("d2", "b")
    assert inbox.wait_and_pop_inputs(0.0) == [
        LivelinessChanged("d1", "a", has_joined=False),
        LivelinessChanged("d2", "b", has_joined=True),
    ]
    inbox.clear_departed_before_liveliness_query()
    inbox.add_liveliness_reply("d1", "a")
    inbox.add_liveliness_reply("d2", "b")
    assert inbox.wait_and_pop_inputs(0.0) == [LivelinessChanged("d1", "a", has_joined=True)]


def test_canary_asked_at_each_arrival_500_that_join_are_asked_500_times(desk, monkeypatch):
    exchange, _, _ = desk
    monkeypatch.setattr("ground_station.app.desk.exchange.STATE_REQUEST_MIN_INTERVAL_S", 0.0)
    for number in range(500):
        exchange.fleet.inbox.record_instance_presence(f"d{number}", "a", has_joined=True)
        exchange.receive_and_process_messages(0.0)
    assert exchange.fleet.states_asked == 501


def believing_own(kind: str, raw: bytes, vehicle: str) -> bytes | Refused:
    """Replaces the signature check: forged messages begin with a mark."""
    return Refused("not believed: forged") if raw.startswith(b"forged") else raw


def states_of(inbox: FleetInbox) -> list[float]:
    return [
        x.state.uptime_s for x in inbox.wait_and_pop_inputs(0.0) if isinstance(x, StateReceived)
    ]


def test_forged_states_that_come_faster_do_not_hide_the_true_one():
    inbox = FleetInbox(believing_own, clock_s=lambda: 0.0)
    inbox.add_state(key("d1", "state"), state("d1", 7.0))
    for _ in range(STATES_PER_CYCLE - 1):
        inbox.add_state(key("d1", "state"), b"forged")
    assert states_of(inbox) == [7.0]


def test_a_repeated_state_is_no_sign_of_life():
    inbox = FleetInbox(believing_own, clock_s=lambda: 0.0)
    for uptime_s, is_new in ((7.0, True), (7.0, False), (6.0, False), (8.0, True), (8.0, False)):
        inbox.add_state(key("d1", "state"), state("d1", uptime_s))
        assert states_of(inbox) == ([uptime_s] if is_new else [])
    inbox.add_state(key("d2", "state"), state("d2", 7.0))
    assert states_of(inbox) == [7.0], "canary: of another vehicle"


def test_canary_of_the_newest_state_alone_a_forged_one_hides_the_true_one(monkeypatch):
    monkeypatch.setattr(fleet_inbox, "STATES_PER_CYCLE", 1)
    inbox = FleetInbox(believing_own, clock_s=lambda: 0.0)
    inbox.add_state(key("d1", "state"), state("d1", 7.0))
    inbox.add_state(key("d1", "state"), b"forged")
    assert states_of(inbox) == []


def test_a_state_that_was_asked_for_is_heard_however_many_come_unasked():
    inbox = FleetInbox(believing_own, clock_s=lambda: 0.0)
    inbox.add_state(key("d1", "state"), state("d1", 7.0), is_query_reply=True)
    for _ in range(FLOOD):
        inbox.add_state(key("d1", "state"), b"forged")
    assert states_of(inbox) == [7.0]


def test_a_turn_looks_at_a_bounded_number_of_signatures_of_one_member():
    looked: list[bytes] = []

    def opened(kind: str, raw: bytes, vehicle: str) -> bytes | Refused:
        looked.append(raw)
        return Refused("not believed: forged")

    inbox = FleetInbox(opened, clock_s=lambda: 0.0)
    for _ in range(FLOOD):
        inbox.add_state(key("d1", "state"), b"forged")
        inbox.add_state(key("d1", "state"), b"forged", is_query_reply=True)
    inbox.wait_and_pop_inputs(0.0)
    assert len(looked) == STATES_PER_CYCLE + REQUESTED_STATES_PER_CYCLE


def test_an_old_state_that_is_played_again_does_not_take_the_place_of_the_newest():
    inbox = FleetInbox(clock_s=lambda: 0.0)
    for uptime_s in (7.0, 3.0, 5.0):
        inbox.add_state(key("d1", "state"), state("d1", uptime_s))
    assert states_of(inbox) == [7.0]


def test_while_forged_states_come_the_true_ones_are_asked_for(desk):
    exchange, clock, _ = desk
    inbox, asked = exchange.fleet.inbox, exchange.fleet.states_asked
    inbox.add_state(key("d1", "state"), b"forged")
    exchange.receive_and_process_messages(0.0)
    assert exchange.fleet.states_asked == asked, "at most every 2 s"
    clock.t_s += STATE_REQUEST_MIN_INTERVAL_S
    exchange.receive_and_process_messages(0.0)
    assert exchange.fleet.states_asked == asked + 1
    clock.t_s += STATE_REQUEST_MIN_INTERVAL_S
    exchange.receive_and_process_messages(0.0)
    assert exchange.fleet.states_asked == asked + 1, "it has ended"


def test_lives_names_and_sizes_are_bounded():
    inbox = FleetInbox(clock_s=lambda: 0.0)
    for number in range(1000):
        inbox.record_instance_presence("d1", f"life-{number}", has_joined=True)
    joined = [x for x in inbox.wait_and_pop_inputs(0.0) if isinstance(x, LivelinessChanged)]
    assert len(joined) == MAX_INSTANCES
    inbox.record_instance_presence("d1", "life-0", has_joined=False)
    inbox.record_instance_presence("d1", "life-900", has_joined=False)
    left = [x for x in inbox.wait_and_pop_inputs(0.0) if isinstance(x, LivelinessChanged)]
    assert left == [LivelinessChanged("d1", "life-0", has_joined=False)]
    for number in range(MAX_MEMBERS + 100):
        inbox.add_state(key(f"x{number}", "state"), b"{}")
    assert len(inbox.wait_and_pop_inputs(0.0)) <= MAX_MEMBERS + 1
    inbox.add_event(
        key("d1", "event"), b" " * (MAX_MESSAGE_BYTES["event"] + MAX_OVERHEAD_BYTES + 1)
    )
    assert not any(isinstance(x, EventsReceived) for x in inbox.wait_and_pop_inputs(0.0))


@pytest.mark.parametrize("guarded", [True, False], ids=["no room", "canary: all of it"])
def test_names_that_nobody_listed_leave_the_room_to_members(guarded):
    inbox = FleetInbox(clock_s=lambda: 0.0, is_member=lambda name: name == "d1" or not guarded)
    for number in range(MAX_MEMBERS):
        inbox.record_instance_presence(f"x{number}", "a", has_joined=True)
        inbox.add_state(key(f"x{number}", "state"), b"forged")
        inbox.add_event(key(f"x{number}", "event"), b"forged")
    found = inbox.wait_and_pop_inputs(0.0)
    assert (found == [MessageRejected("", NOT_ON_ROSTER, 3 * MAX_MEMBERS)]) is guarded
    inbox.record_instance_presence("d1", "a", has_joined=True)
    assert (
        inbox.wait_and_pop_inputs(0.0) == [LivelinessChanged("d1", "a", has_joined=True)]
    ) is guarded


def test_a_turn_looks_only_at_members_from_whom_something_has_come(monkeypatch):
    inbox, looked = FleetInbox(clock_s=lambda: 0.0), list[object]()
    for number in range(100):
        inbox.add_state(key(f"d{number}", "state"), state(f"d{number}", 1.0))
    taken = fleet_inbox.MemberBox.pop_states
    assert len(states_of(inbox)) == 100
    monkeypatch.setattr(
        fleet_inbox.MemberBox, "pop_states", lambda box: looked.append(1) or taken(box)
    )
    inbox.add_state(key("d7", "state"), state("d7", 2.0))
    assert states_of(inbox) == [2.0]
    assert len(looked) == 1


def test_the_desk_looks_for_missed_events_only_where_something_has_come_or_is_missing(
    desk, monkeypatch
):
    exchange, clock, _ = desk
    inbox = exchange.fleet.inbox
    for number in range(20):
        inbox.record_instance_presence(f"d{number}", "a", has_joined=True)
        inbox.add_state(key(f"d{number}", "state"), state(f"d{number}", 1.0, int(number == 3)))
    exchange.receive_and_process_messages(0.0)
    assert exchange.fleet.events_asked == [("d3", 0)]
    looked: list[str] = []
    of = exchange.status.status_of
    monkeypatch.setattr(
        type(exchange.status), "status_of", lambda self, v: looked.append(v) or of(v)
    )
    clock.t_s = RETRY_DELAY_S
    exchange.receive_and_process_messages(0.0)
    assert looked == ["d3"]
    assert exchange.fleet.events_asked == [("d3", 0)] * 2, "nothing came: it is asked again"
    inbox.add_events_of_query_reply("d3", [event("d3", 1)])
    clock.t_s += RETRY_DELAY_S
    exchange.receive_and_process_messages(0.0)
    looked.clear()
    exchange.receive_and_process_messages(0.0)
    assert looked == []


def test_who_comes_and_goes_between_two_turns_was_never_there():
    inbox = FleetInbox(clock_s=lambda: 0.0)
    inbox.record_instance_presence("d1", "a", has_joined=True)
    inbox.record_instance_presence("d1", "a", has_joined=False)
    assert inbox.wait_and_pop_inputs(0.0) == []
