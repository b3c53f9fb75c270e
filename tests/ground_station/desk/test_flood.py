"""One member floods the desk: what others say, and their answers, come through as before.

Judged by counts and by order, never by how fast this machine is.
"""

from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.fleet.envelope import OVERHEAD_BYTES
from companion.fleet.messages import (
    LARGEST_BYTES,
    Answered,
    EventKind,
    FleetEvent,
    Recall,
    Refused,
    Result,
    State,
    encode,
)
from ground_station.adapters import fleet_inbox
from ground_station.adapters.fleet_inbox import (
    ASKED_A_TURN,
    EVENTS_A_TURN,
    EVENTS_BURST,
    MOST_LIVES,
    MOST_MEMBERS,
    NOT_LISTED,
    STATES_A_TURN,
    FleetInbox,
)
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk import exchange as exchange_module
from ground_station.app.desk.exchange import RETRY_S, STATES_S, Exchange
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    EventsReceived,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)

FLOOD = 30_000
"""Three seconds of 10,000 messages."""


def key(vehicle: str, kind: str) -> str:
    return f"leeway/harbour/vehicle/{vehicle}/{kind}"


def event(vehicle: str, seq: int) -> bytes:
    told = FleetEvent(
        vehicle=vehicle, log="l", seq=seq, epoch_us=0, kind=EventKind.SAID, text=f"words {seq}"
    )
    return encode(told)


def state(vehicle: str, uptime_s: float, last_seq: int = 0) -> bytes:
    told = State(
        vehicle=vehicle, life="a", uptime_s=uptime_s, epoch_us=0, airframe="m100",
        max_payload_kg=1.0, phase="standby", log="l", last_seq=last_seq,
    )  # fmt: skip
    return encode(told)


class Clock:
    def __init__(self) -> None:
        self.t_s = 0.0

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return round(self.t_s * 1e6)


class Inboxed:
    """A network whose messages are handed to the desk's inbox; what is asked for is counted."""

    def __init__(self, clock: Clock) -> None:
        self.inbox = FleetInbox(clock_s=clock.monotonic_s)
        self.states_asked = 0
        self.events_asked: list[tuple[str, int]] = []

    def receive(self, wait_s: float) -> list[Any]:
        return self.inbox.receive(0.0)

    def ask_states(self, wait_s: float) -> None:
        self.states_asked += 1

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        self.events_asked.append((vehicle, after))

    def tell_winds(self, winds: Any) -> None: ...
    def neighbour_keys(self, fleet: str) -> dict[str, str]: ...
    def send(self, command: Any, wait_s: float) -> None: ...
    def close(self) -> None: ...


@pytest.fixture
def desk(tmp_path: Path) -> Any:
    clock = Clock()
    store = Store(Database(f"sqlite:///{tmp_path}/desk.db", durable=False), clock.epoch_us)
    said: list[str] = []
    exchange = Exchange(store, Inboxed(clock), said.append, clock=clock)
    exchange.begin()
    yield exchange, clock, said
    store.close()


def flood(inbox: FleetInbox, vehicle: str = "d1") -> None:
    for seq in range(1, FLOOD + 1):
        inbox.hear_event(key(vehicle, "event"), event(vehicle, seq))
        inbox.hear_state(key(vehicle, "state"), state(vehicle, float(seq), seq))


@contextmanager
def counted(database: Database, monkeypatch: pytest.MonkeyPatch) -> Any:
    """How many transactions are written inside."""
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
        monkeypatch.setattr(fleet_inbox.RateLimit, "take", lambda *_: True)
    inbox = FleetInbox(clock_s=lambda: 0.0)
    flood(inbox)
    inbox.hear_event(key("d2", "event"), event("d2", 1))
    inbox.hear_state(key("d2", "state"), state("d2", 1.0, 1))
    inbox.hear_answer("c1", None)
    found = inbox.receive(0.0)
    kinds = [type(x) for x in found]
    assert kinds.index(CommandAnswered) == EVENTS_A_TURN + 1  # after events, d2's among them
    of_d1 = [x for x in found if isinstance(x, EventsReceived) and x.vehicle == "d1"]
    of_d2 = [x for x in found if isinstance(x, EventsReceived) and x.vehicle == "d2"]
    states = [x.state for x in found if isinstance(x, StateReceived)]
    assert (len(of_d1), len(of_d2)) == (EVENTS_A_TURN, 1)
    assert [(s.vehicle, s.uptime_s) for s in states] == [("d1", float(FLOOD)), ("d2", 1.0)]
    rejected = [(x.key, x.count) for x in found if isinstance(x, MessageRejected)]
    assert rejected == ([("d1", FLOOD - EVENTS_BURST)] if guarded else [])


def test_the_flood_of_one_leaves_the_others_acknowledgement_and_event_in_the_next_turn(
    desk, monkeypatch
):
    exchange, _, said = desk
    inbox = exchange.fleet.inbox
    exchange.store.command("c1", "d2", Recall(), "desk")
    flood(inbox)
    inbox.hear_event(key("d2", "event"), event("d2", 1))
    done = Result(id="c1", vehicle="d2", life="a", answer=Answered.DONE)
    inbox.hear_answer("c1", done)
    with counted(exchange.store.database, monkeypatch) as written:
        exchange.listen(0.0)
    assert exchange.store.answers(["c1"]) == {"c1": Answered.DONE}
    assert any(e.vehicle == "d2" for e in exchange.store.events())
    assert written[0] == 2  # the answer, and all events
    assert sum("rejected" in words for words in said) == 1


def test_canary_without_limit_and_batch_the_flood_is_taken_whole_and_one_by_one(desk, monkeypatch):
    exchange, _, _ = desk
    inbox = exchange.fleet.inbox
    monkeypatch.setattr(fleet_inbox, "EVENTS_A_TURN", FLOOD)
    monkeypatch.setattr(fleet_inbox.RateLimit, "take", lambda *_: True)
    monkeypatch.setattr(fleet_inbox, "EVENTS_BURST", FLOOD)
    for seq in range(1, 501):
        inbox.hear_event(key("d1", "event"), event("d1", seq))

    def one_by_one(self: Store, batches: Any) -> list[FleetEvent]:
        return [e for events, replayed in batches for e in self._take_all([(events, replayed)])]

    monkeypatch.setattr(Store, "take_event_batches", one_by_one)
    with counted(exchange.store.database, monkeypatch) as written:
        exchange.listen(0.0)
    assert written[0] == 500


def test_what_a_rate_left_out_is_asked_for_again(desk):
    exchange, _, _ = desk
    inbox = exchange.fleet.inbox
    inbox.hear_life("d1", "a", up=True)
    for seq in range(1, EVENTS_BURST + 11):
        inbox.hear_event(key("d1", "event"), event("d1", seq))
    for _ in range(EVENTS_BURST // EVENTS_A_TURN):
        exchange.listen(0.0)
    inbox.hear_state(key("d1", "state"), state("d1", 1.0, EVENTS_BURST + 10))
    exchange.listen(0.0)
    assert exchange.fleet.events_asked == [("d1", EVENTS_BURST)]
    missed = [event("d1", n) for n in range(EVENTS_BURST + 1, EVENTS_BURST + 11)]
    inbox.hear_replay("d1", missed)
    exchange.listen(0.0)
    assert len(exchange.store.events()) == EVENTS_BURST + 10


def test_a_member_that_always_has_more_events_is_asked_ever_more_rarely(desk, monkeypatch):
    monkeypatch.setattr(exchange_module, "REPLAYS_HZ", 1.0)
    monkeypatch.setattr(exchange_module, "REPLAYS_BURST", 40.0)
    exchange, clock, _ = desk
    inbox = exchange.fleet.inbox
    inbox.hear_life("d1", "a", up=True)
    batch, seconds, told = 10, 60, 0
    for second in range(seconds):
        clock.t_s = float(second)
        inbox.hear_state(key("d1", "state"), state("d1", float(second), 10**6))
        before = len(exchange.fleet.events_asked)
        exchange.listen(0.0)
        if len(exchange.fleet.events_asked) > before:
            inbox.hear_replay("d1", [event("d1", told + n) for n in range(1, batch + 1)])
            told += batch
    assert told <= 40 + 1 * seconds + batch


def test_all_are_asked_for_their_states_once_however_many_join(desk):
    exchange, clock, _ = desk
    fleet = exchange.fleet
    for number in range(500):
        fleet.inbox.hear_life(f"d{number}", "a", up=True)
        exchange.listen(0.0)
    assert fleet.states_asked == 1  # at the beginning
    clock.t_s = STATES_S
    exchange.listen(0.0)
    exchange.listen(0.0)
    assert fleet.states_asked == 2


def test_all_are_asked_for_their_states_once_a_minute_where_nobody_joins(desk):
    exchange, clock, _ = desk
    for second in range(1, 181):
        clock.t_s = float(second)
        exchange.listen(0.0)
    assert exchange.fleet.states_asked == 1 + 3


def test_a_roll_call_finds_who_was_missed_and_nobody_who_left_meanwhile():
    inbox = FleetInbox(clock_s=lambda: 0.0)
    inbox.hear_life("d1", "a", up=True)
    inbox.receive(0.0)
    inbox.begin_roll_call()
    inbox.hear_life("d1", "a", up=False)
    inbox.hear_present("d1", "a")
    inbox.hear_present("d2", "b")
    inbox.hear_present("d2", "b")
    assert inbox.receive(0.0) == [
        LivelinessChanged("d1", "a", up=False),
        LivelinessChanged("d2", "b", up=True),
    ]
    inbox.begin_roll_call()
    inbox.hear_present("d1", "a")
    inbox.hear_present("d2", "b")
    assert inbox.receive(0.0) == [LivelinessChanged("d1", "a", up=True)]


def test_canary_asked_at_each_arrival_500_that_join_are_asked_500_times(desk, monkeypatch):
    exchange, _, _ = desk
    monkeypatch.setattr("ground_station.app.desk.exchange.STATES_S", 0.0)
    for number in range(500):
        exchange.fleet.inbox.hear_life(f"d{number}", "a", up=True)
        exchange.listen(0.0)
    assert exchange.fleet.states_asked == 501


def believing_own(kind: str, raw: bytes, vehicle: str) -> bytes | Refused:
    """Stands for a signature: what a stranger sent begins with a mark."""
    return Refused("not believed: forged") if raw.startswith(b"forged") else raw


def states_of(inbox: FleetInbox) -> list[float]:
    return [x.state.uptime_s for x in inbox.receive(0.0) if isinstance(x, StateReceived)]


def test_forged_states_that_come_faster_do_not_hide_the_true_one():
    inbox = FleetInbox(believing_own, clock_s=lambda: 0.0)
    inbox.hear_state(key("d1", "state"), state("d1", 7.0))
    for _ in range(STATES_A_TURN - 1):
        inbox.hear_state(key("d1", "state"), b"forged")
    assert states_of(inbox) == [7.0]


def test_canary_of_the_newest_state_alone_a_forged_one_hides_the_true_one(monkeypatch):
    monkeypatch.setattr(fleet_inbox, "STATES_A_TURN", 1)
    inbox = FleetInbox(believing_own, clock_s=lambda: 0.0)
    inbox.hear_state(key("d1", "state"), state("d1", 7.0))
    inbox.hear_state(key("d1", "state"), b"forged")
    assert states_of(inbox) == []


def test_a_state_that_was_asked_for_is_heard_however_many_come_unasked():
    inbox = FleetInbox(believing_own, clock_s=lambda: 0.0)
    inbox.hear_state(key("d1", "state"), state("d1", 7.0), asked=True)
    for _ in range(FLOOD):
        inbox.hear_state(key("d1", "state"), b"forged")
    assert states_of(inbox) == [7.0]


def test_a_turn_looks_at_a_bounded_number_of_signatures_of_one_member():
    looked: list[bytes] = []

    def opened(kind: str, raw: bytes, vehicle: str) -> bytes | Refused:
        looked.append(raw)
        return Refused("not believed: forged")

    inbox = FleetInbox(opened, clock_s=lambda: 0.0)
    for _ in range(FLOOD):
        inbox.hear_state(key("d1", "state"), b"forged")
        inbox.hear_state(key("d1", "state"), b"forged", asked=True)
    inbox.receive(0.0)
    assert len(looked) == STATES_A_TURN + ASKED_A_TURN


def test_an_old_state_that_is_played_again_does_not_take_the_place_of_the_newest():
    inbox = FleetInbox(clock_s=lambda: 0.0)
    for uptime_s in (7.0, 3.0, 5.0):
        inbox.hear_state(key("d1", "state"), state("d1", uptime_s))
    assert states_of(inbox) == [7.0]


def test_while_forged_states_come_the_true_ones_are_asked_for(desk):
    exchange, clock, _ = desk
    inbox, asked = exchange.fleet.inbox, exchange.fleet.states_asked
    inbox.hear_state(key("d1", "state"), b"forged")
    exchange.listen(0.0)
    assert exchange.fleet.states_asked == asked, "at most every 2 s"
    clock.t_s += STATES_S
    exchange.listen(0.0)
    assert exchange.fleet.states_asked == asked + 1
    clock.t_s += STATES_S
    exchange.listen(0.0)
    assert exchange.fleet.states_asked == asked + 1, "it has ended"


def test_lives_names_and_sizes_are_bounded():
    inbox = FleetInbox(clock_s=lambda: 0.0)
    for number in range(1000):
        inbox.hear_life("d1", f"life-{number}", up=True)
    joined = [x for x in inbox.receive(0.0) if isinstance(x, LivelinessChanged)]
    assert len(joined) == MOST_LIVES
    inbox.hear_life("d1", "life-0", up=False)
    inbox.hear_life("d1", "life-900", up=False)
    left = [x for x in inbox.receive(0.0) if isinstance(x, LivelinessChanged)]
    assert left == [LivelinessChanged("d1", "life-0", up=False)]
    for number in range(MOST_MEMBERS + 100):
        inbox.hear_state(key(f"x{number}", "state"), b"{}")
    assert len(inbox.receive(0.0)) <= MOST_MEMBERS + 1
    inbox.hear_event(key("d1", "event"), b" " * (LARGEST_BYTES["event"] + OVERHEAD_BYTES + 1))
    assert inbox.waiting == 0


@pytest.mark.parametrize("guarded", [True, False], ids=["no room", "canary: all of it"])
def test_names_that_nobody_listed_leave_the_room_to_members(guarded):
    inbox = FleetInbox(clock_s=lambda: 0.0, is_member=lambda name: name == "d1" or not guarded)
    for number in range(MOST_MEMBERS):
        inbox.hear_life(f"x{number}", "a", up=True)
        inbox.hear_state(key(f"x{number}", "state"), b"forged")
        inbox.hear_event(key(f"x{number}", "event"), b"forged")
    found = inbox.receive(0.0)
    assert (found == [MessageRejected("", NOT_LISTED, 3 * MOST_MEMBERS)]) is guarded
    inbox.hear_life("d1", "a", up=True)
    assert (inbox.receive(0.0) == [LivelinessChanged("d1", "a", up=True)]) is guarded


def test_a_turn_looks_only_at_members_from_whom_something_has_come(monkeypatch):
    inbox, looked = FleetInbox(clock_s=lambda: 0.0), list[object]()
    for number in range(100):
        inbox.hear_state(key(f"d{number}", "state"), state(f"d{number}", 1.0))
    taken = fleet_inbox.MemberBox.taken_states
    assert len(states_of(inbox)) == 100
    monkeypatch.setattr(
        fleet_inbox.MemberBox, "taken_states", lambda box: looked.append(1) or taken(box)
    )
    inbox.hear_state(key("d7", "state"), state("d7", 2.0))
    assert states_of(inbox) == [2.0]
    assert len(looked) == 1


def test_the_desk_looks_for_missed_events_only_where_something_has_come_or_is_missing(
    desk, monkeypatch
):
    exchange, clock, _ = desk
    inbox = exchange.fleet.inbox
    for number in range(20):
        inbox.hear_life(f"d{number}", "a", up=True)
        inbox.hear_state(key(f"d{number}", "state"), state(f"d{number}", 1.0, int(number == 3)))
    exchange.listen(0.0)
    assert exchange.fleet.events_asked == [("d3", 0)]
    looked: list[str] = []
    of = exchange.status.of
    monkeypatch.setattr(type(exchange.status), "of", lambda self, v: looked.append(v) or of(v))
    clock.t_s = RETRY_S
    exchange.listen(0.0)
    assert looked == ["d3"]
    assert exchange.fleet.events_asked == [("d3", 0)] * 2, "nothing came: it is asked again"
    inbox.hear_replay("d3", [event("d3", 1)])
    clock.t_s += RETRY_S
    exchange.listen(0.0)
    looked.clear()
    exchange.listen(0.0)
    assert looked == []


def test_who_comes_and_goes_between_two_turns_was_never_there():
    inbox = FleetInbox(clock_s=lambda: 0.0)
    inbox.hear_life("d1", "a", up=True)
    inbox.hear_life("d1", "a", up=False)
    assert inbox.receive(0.0) == []
