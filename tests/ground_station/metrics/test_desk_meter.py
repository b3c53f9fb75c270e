"""The figures of real desks in one process, time by hand, read as Prometheus reads them."""

import re
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from companion.fleet.messages import FINAL, Answered, EventKind, FleetEvent, Recall, Result
from companion.fleet.roles import Role
from companion.fleet.roster import Roster, RosterMember
from ground_station.adapters.metrics.desk_collector import DeskCollector
from ground_station.adapters.metrics.metrics_page import MetricsPage
from ground_station.adapters.metrics.metrics_server import MetricsServer
from ground_station.adapters.store import database as database_module
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.outage import MOST_S, Outage
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.desk_meter import EVERY_S, DeskMeter
from ground_station.app.desk.exchange import ANSWER_S, Exchange
from ground_station.app.desk.replanner import InlineReplanner, NoPlan
from ground_station.core.fleet import desk_figures
from ground_station.core.fleet.desk_figures import CertificateFigures, certificates_of
from ground_station.core.fleet.door import DoorFigures, TurnedAway, Unwelcome
from ground_station.core.fleet.fleet_link import CommandAnswered
from ground_station.core.fleet.fleet_status import SILENT_S
from ground_station.core.fleet.name_counts import MOST_NAMES, NOBODY, OTHERS
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.holds import ALL
from tests.fleet.zenoh_net import free_port
from tests.ground_station.desk.test_flood import Inboxed, key, state
from tests.ground_station.desk.test_truck_dispatcher import HARBOUR, TURN_S, DayTold
from tests.ground_station.hand_made_day import by_truck
from tests.ground_station.metrics.scrape import Scrape, scrape
from tests.ground_station.truck_world import WorldClock


@dataclass
class Network:
    """What a network's end would say."""

    waiting: int = 0
    open_network: bool = False
    ends: CertificateFigures | None = None

    door: "Door | None" = None

    def certificates(self) -> CertificateFigures | None:
        return self.ends


@dataclass
class Door:
    """Where others call."""

    seen: DoorFigures

    def figures(self) -> DoorFigures:
        return self.seen


def desk_page(meter: DeskMeter, clock: WorldClock) -> MetricsPage:
    return MetricsPage(DeskCollector(lambda: meter.figures, clock), clock)


def page_of(meter: DeskMeter) -> Scrape:
    """A new page: none that was kept."""
    clock: Any = meter.desk.exchange.clock
    return Scrape(desk_page(meter, clock).text().decode())


# --- a whole day with a truck --------------------------------------------------------------------


@dataclass(slots=True)
class SlowAndDying(InlineReplanner):
    """Takes half a minute for each plan, and ends without an answer the first two times."""

    clock: WorldClock = field(default_factory=WorldClock)
    asked_s: list[float] = field(default_factory=list)

    def ask(self, data: DayData, start: DayState) -> None:
        self.asked_s.append(self.clock.t_s)
        InlineReplanner.ask(self, data, start)

    def made(self) -> DayPlan | NoPlan | None:
        if self.clock.t_s - self.asked_s[-1] < 30.0:
            return None
        made = InlineReplanner.made(self)
        return NoPlan("died", again=True) if len(self.asked_s) <= 2 else made


@dataclass
class Told:
    """A day that has been brought home, and what a witness beside the desk has counted."""

    day: DayTold
    last: Scrape
    replanning: int = 0
    timeouts: int = 0
    flying: set[str] = field(default_factory=set)


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Told]:
    folder = tmp_path_factory.mktemp("day")
    day = DayTold(f"sqlite:///{folder}/desk.db", 13, 0.1)
    day.world.driver.late_s = 400.0
    slow = SlowAndDying(plan=by_truck, clock=day.world.clock)
    day.dispatcher.active.replanner = slow
    meter = DeskMeter(day.desk, Network())
    meter.turn()
    found = Told(day, page_of(meter))
    while not day.desk.is_done:
        for _ in range(TURN_S):
            day.world.step()
        found.timeouts += sum(
            isinstance(one, CommandAnswered) and one.result is None for one in day.world.waiting
        )
        day.desk.turn(0.0)
        meter.turn()
        figures = meter.figures
        assert figures is not None
        assert figures.replans is not None
        found.replanning += figures.replans.is_replanning
        found.flying |= {member.vehicle for member in figures.members if member.flies}
        assert not day.world.wrong
    found.last = page_of(meter)
    yield found
    day.store.close()


def test_each_command_that_was_answered_is_in_the_times_of_its_deed(told):
    rows = [row for row in told.day.store.commands() if row.answer in FINAL and row.life]
    tags = Counter(row.deed.__struct_config__.tag for row in rows)
    assert {"assign", "launch", "drive", "serve", "put_out", "recover"} <= set(tags)
    shown = {tag: told.last.of("command_answer_seconds_count", deed=str(tag)) for tag in tags}
    assert shown == dict(tags)
    assert told.last.label_values("command_answer_seconds_count", "deed") == set(tags)
    for tag in tags:
        buckets = [
            told.last.of("command_answer_seconds_bucket", deed=str(tag), le=le)
            for le in ("0.01", "1.0", "60.0", "+Inf")
        ]
        assert None not in buckets
        assert buckets == sorted(buckets, key=lambda count: count or 0.0)
        assert buckets[-1] == tags[tag]


def test_what_nobody_answered_is_counted_and_in_the_end_nothing_waits(told):
    deeds = told.last.label_values("command_timeouts_total", "deed")
    shown = sum(told.last.of("command_timeouts_total", deed=deed) or 0.0 for deed in deeds)
    assert shown == told.timeouts > 0
    assert told.last.of("outbox_commands") == len(told.day.store.outbox()) == 0
    assert told.last.of("outbox_oldest_seconds") is None
    assert not told.last.label_values("commands_unanswered", "deed")


def test_each_new_plan_is_counted_by_its_result_with_the_time_that_it_took(told):
    plans = DayStore(told.day.database, lambda: 1).plans()
    taken = told.last.of("replan_seconds_count", result="taken")
    assert told.last.of("replan_seconds_count", result="died") == 2
    assert taken == len(plans) - 1 > 0
    assert told.last.of("replan_seconds_count", result="refused") is None
    for result, count in (("died", 2), ("taken", taken)):
        took_s = told.last.of("replan_seconds_sum", result=result) or 0.0
        assert 30.0 * count <= took_s <= (30.0 + 2 * TURN_S) * count
        assert told.last.of("replan_seconds_bucket", result=result, le="15.0") == 0
        assert told.last.of("replan_seconds_bucket", result=result, le="60.0") == count
    assert told.replanning >= 3 * 30 // TURN_S


def test_members_fly_while_they_fly_and_are_heard_as_long_ago_as_they_are(told):
    assert told.flying == {row.vehicle for row in told.day.store.assignments()} - {"truck"}
    assert told.day.world.flown
    now_s, vehicles = told.day.world.clock.t_s, told.day.desk.exchange.status.vehicles
    for name, seen in vehicles.items():
        assert seen.heard_s is not None
        shown_s = told.last.of("member_silence_seconds", vehicle=name)
        assert shown_s == pytest.approx(now_s - seen.heard_s)
    assert told.last.of("members", standing="present") == 1  # the truck; drones ride, switched off


# --- a desk by hand ------------------------------------------------------------------------------


class NoDispatcher:
    """Decides nothing."""

    replans = None
    on_state = begin = close = staticmethod(lambda *_: None)

    def turn(self, *_: Any, **__: Any) -> None: ...


@dataclass
class ByHand:
    """A real desk whose network and time are by hand."""

    clock: WorldClock
    network: Inboxed
    desk: Desk
    meter: DeskMeter
    gauges: Network
    said: list[str]

    def turn(self, after_s: float = EVERY_S) -> Scrape:
        """The desk's loop comes round so much later; the page then."""
        self.clock.t_s += after_s
        self.desk.turn(0.0)
        self.meter.turn()
        return page_of(self.meter)


@pytest.fixture
def by_hand(tmp_path: Path) -> Iterator[ByHand]:
    clock, said = WorldClock(100.0), list[str]()
    outage = Outage(clock.monotonic_s)
    database = Database(f"sqlite:///{tmp_path}/desk.db", durable=False, busy_ms=1, outage=outage)
    store = Store(database, clock.epoch_us)
    network, gauges = Inboxed(clock), Network()  # type: ignore[arg-type]
    exchange = Exchange(store, network, said.append, clock=clock)
    desk = Desk(exchange, NoDispatcher())  # type: ignore[arg-type]
    made = ByHand(clock, network, desk, DeskMeter(desk, gauges), gauges, said)
    yield made
    store.close()


def test_a_desk_that_hangs_is_seen_while_it_hangs(by_hand):
    by_hand.turn()
    with closing(MetricsServer("127.0.0.1", port := free_port())) as server:
        server.serve(desk_page(by_hand.meter, by_hand.clock).text)
        assert scrape(port).of("seconds_since_turn") == 0.0
        by_hand.clock.t_s += 40.0  # the desk's thread does not come back
        assert scrape(port).of("seconds_since_turn") == 40.0
        assert scrape(port).of("store_up") == 1.0  # the last that is known


def test_canary_figures_that_are_taken_when_somebody_asks_know_no_hang(by_hand):
    by_hand.turn()

    def taken() -> Any:
        by_hand.meter.turn()
        return by_hand.meter.figures

    page = MetricsPage(DeskCollector(taken, by_hand.clock), by_hand.clock)
    by_hand.clock.t_s += 40.0
    assert Scrape(page.text().decode()).of("seconds_since_turn") == 0.0


def test_before_the_first_turn_nothing_is_claimed(by_hand):
    assert page_of(by_hand.meter).of("seconds_since_turn") is None


def rename(by_hand: ByHand, before: str, after: str) -> None:
    """Take a table away, or put it back: each read of it fails, as from a server that is gone."""
    file = by_hand.desk.store.database.shown.removeprefix("sqlite:///")
    with closing(sqlite3.connect(file)) as other:
        other.execute(f"ALTER TABLE {before} RENAME TO {after}")


def away(by_hand: ByHand, turns: int) -> Scrape:
    """The page after so many turns, a second each, without the store."""
    rename(by_hand, "assignments", "gone")
    for _ in range(turns - 1):
        by_hand.turn()
    return by_hand.turn()


def test_a_store_that_is_away_is_shown_as_away_for_so_long_and_back_when_it_is(by_hand):
    seen = by_hand.turn()
    assert (seen.of("store_up"), seen.of("store_away_seconds")) == (1.0, 0.0)
    seen = away(by_hand, 8)  # tried in the seconds 1, 2, 4 and 8
    assert any(words.startswith("STORE AWAY") for words in by_hand.said)
    assert (seen.of("store_up"), seen.of("store_away_seconds")) == (0.0, 7.0)
    assert seen.of("store_retries_total") == 3
    rename(by_hand, "gone", "assignments")
    seen = by_hand.turn(MOST_S)
    assert "store back" in by_hand.said
    assert (seen.of("store_up"), seen.of("store_away_seconds")) == (1.0, 0.0)
    assert seen.of("store_retries_total") == 4


def test_the_time_of_the_newest_writing_transaction_is_shown(by_hand, monkeypatch):
    times = iter((5.0, 5.25))
    monkeypatch.setattr(database_module, "monotonic_s", lambda: next(times))
    HoldStore(by_hand.desk.store.database, by_hand.clock.epoch_us).set(["d1"], "wind", "anna")
    assert by_hand.turn().of("store_transaction_seconds") == 0.25


def test_who_is_held_is_counted_heard_or_not_and_kept_while_the_store_is_away(by_hand):
    holds = HoldStore(by_hand.desk.store.database, by_hand.clock.epoch_us)
    hear(by_hand, "d1", "d2")
    assert by_hand.turn().of("members_held") == 0
    holds.set(["d1", "d9"], "wind", "anna")
    assert by_hand.turn().of("members_held") == 2
    assert away(by_hand, 3).of("members_held") == 2
    rename(by_hand, "gone", "assignments")
    by_hand.turn(MOST_S)
    holds.set([ALL], "a storm", "anna")
    assert by_hand.turn().of("members_held") == 3


def hear(by_hand: ByHand, *names: str) -> None:
    """These join and tell their state."""
    for name in names:
        by_hand.network.inbox.hear_life(name, "a", up=True)
        by_hand.network.inbox.hear_state(key(name, "state"), state(name, by_hand.clock.t_s))


def test_members_are_present_silent_or_gone_as_the_desk_finds_them(by_hand):
    hear(by_hand, "d1", "d2", "d3")
    seen = by_hand.turn()
    assert standings(seen) == {"present": 3, "silent": 0, "gone": 0}
    by_hand.turn(SILENT_S)
    by_hand.network.inbox.hear_life("d2", "a", up=False)
    by_hand.network.inbox.hear_state(key("d1", "state"), state("d1", 200.0))
    seen = by_hand.turn()
    assert standings(seen) == {"present": 1, "silent": 1, "gone": 1}
    assert seen.of("member_silence_seconds", vehicle="d1") == 0.0
    assert seen.of("member_silence_seconds", vehicle="d3") == SILENT_S + EVERY_S


def standings(seen: Scrape) -> dict[str, float | None]:
    values = seen.label_values("members", "standing")
    return {value: seen.of("members", standing=value) for value in values}


def test_rejected_messages_are_counted_by_the_member_by_whose_key_they_came(by_hand):
    inbox = by_hand.network.inbox
    for _ in range(5):
        inbox.hear_event(key("d1", "event"), b"rubbish")
    inbox.hear_state(key("d2", "state"), state("d7", 1.0))  # speaks for somebody else
    seen = by_hand.turn()
    assert seen.of("messages_rejected_total", vehicle="d1") == 5
    inbox.hear_event(key("d1", "event"), b"rubbish")
    seen = by_hand.turn()
    assert seen.of("messages_rejected_total", vehicle="d1") == 6
    assert seen.of("messages_rejected_total", vehicle="d2") == 1
    assert sum("rejected" in words for words in by_hand.said) == 2  # said once a minute


def test_a_key_that_would_forge_a_line_of_the_page_is_nobodys(by_hand):
    forged = 'x"} 1\nleeway_desk_store_up 0\n'
    by_hand.network.inbox.hear_event(key(forged, "event"), b"rubbish")
    by_hand.network.inbox.hear_life(forged[:5], "a", up=True)
    seen = by_hand.turn()
    assert seen.label_values("messages_rejected_total", "vehicle") == {NOBODY}
    assert seen.text.count("leeway_desk_store_up") == 3  # help, type, and the one sample
    assert seen.of("store_up") == 1.0


def flood_of_names(by_hand: ByHand, count: int) -> Scrape:
    for k in range(count):
        hear(by_hand, f"x{k}")
        by_hand.network.inbox.hear_event(key(f"x{k}", "event"), b"rubbish")
    return by_hand.turn()


def test_a_flood_of_names_makes_no_more_than_so_many_labels(by_hand, monkeypatch):
    monkeypatch.setattr(desk_figures, "MOST_NAMES", 20)
    by_hand.desk.exchange.rejected.most = 20
    seen = flood_of_names(by_hand, 60)
    assert len(seen.label_values("member_silence_seconds", "vehicle")) == 20
    assert (seen.of("members", standing="present"), seen.of("members_unlisted")) == (60, 40)
    assert len(seen.label_values("messages_rejected_total", "vehicle")) == 21
    assert seen.of("messages_rejected_total", vehicle=OTHERS) == 40


def test_canary_without_the_bounds_each_name_is_a_label(by_hand):
    assert MOST_NAMES > 60
    seen = flood_of_names(by_hand, 60)
    assert len(seen.label_values("member_silence_seconds", "vehicle")) == 60
    assert len(seen.label_values("messages_rejected_total", "vehicle")) == 60


def test_a_command_that_nobody_answers_is_seen_with_its_age(by_hand):
    by_hand.desk.store.command("c1", "d1", Recall(), "anna")
    seen = by_hand.turn(10.0)
    assert (seen.of("outbox_commands"), seen.of("outbox_oldest_seconds")) == (1, 10.0)
    assert not seen.label_values("commands_unanswered", "deed")  # d1 is not there: not sent
    hear(by_hand, "d1")
    seen = by_hand.turn()
    assert seen.of("commands_unanswered", deed="recall") == 1
    by_hand.network.inbox.hear_answer("c1", None)
    seen = by_hand.turn(ANSWER_S)
    assert seen.of("command_timeouts_total", deed="recall") == 1
    done = Result(id="c1", vehicle="d1", life="a", answer=Answered.DONE)
    by_hand.network.inbox.hear_answer("c1", done)
    seen = by_hand.turn()
    assert not seen.label_values("commands_unanswered", "deed")
    assert (seen.of("outbox_commands"), seen.of("outbox_oldest_seconds")) == (0, None)
    assert seen.of("command_answer_seconds_sum", deed="recall") == ANSWER_S + EVERY_S


def test_an_answer_that_the_store_could_not_take_counts_when_it_has(by_hand):
    by_hand.desk.store.command("c1", "d1", Recall(), "anna")
    hear(by_hand, "d1")
    by_hand.turn()
    rename(by_hand, "commands", "gone")
    done = Result(id="c1", vehicle="d1", life="a", answer=Answered.DONE)
    by_hand.network.inbox.hear_answer("c1", done)
    seen = by_hand.turn()
    assert seen.of("command_answer_seconds_count", deed="recall") is None
    rename(by_hand, "gone", "commands")
    by_hand.turn(MOST_S)
    by_hand.network.inbox.hear_answer("c1", done)
    assert by_hand.turn().of("command_answer_seconds_count", deed="recall") == 1


def launched(store: Store) -> str:
    """A flight of d1 whose launch was taken; its assignment."""
    store.add_orders(HARBOUR.orders[:1])
    id_ = store.assign(HARBOUR.orders[0].id, "d1", {}, None, "desk")
    assert id_ is not None
    store.answered(f"{id_}:assign", Answered.DONE, "", "a")
    assert store.launch(id_, "desk")
    store.answered(f"{id_}:launch1", Answered.DONE, "", "a")
    return id_


def test_a_drone_flies_from_its_launch_to_its_outcome_also_for_a_desk_that_never_heard_it(by_hand):
    id_ = launched(by_hand.desk.store)
    seen = by_hand.turn()
    assert seen.of("member_flying", vehicle="d1") == 1
    assert seen.of("member_silence_seconds", vehicle="d1") is None
    assert seen.of("members", standing="gone") == 1
    told = {"outcome": "SUC", "delivered": True, "home": True}
    outcome = FleetEvent(
        vehicle="d1", log="l", seq=1, epoch_us=0, kind=EventKind.OUTCOME, text="", assignment=id_,
        **told,
    )  # fmt: skip
    by_hand.desk.store.take_events([outcome])
    assert by_hand.turn().of("member_flying", vehicle="d1") == 0


def test_what_waits_to_be_taken_in_is_shown(by_hand):
    by_hand.gauges.waiting = 7
    assert by_hand.turn().of("waiting_messages") == 7


def test_an_open_network_is_shown(by_hand):
    assert by_hand.turn().of("open_network") == 0
    by_hand.gauges.open_network = True
    assert by_hand.turn().of("open_network") == 1


def test_days_that_certificates_have_left_are_counted_from_now(by_hand):
    assert by_hand.turn().of("own_certificate_days_left") is None  # no identity
    by_hand.gauges.ends = certificates_of(roster(by_hand.clock, desk=40, d1=2, d2=-1), "desk")
    seen = by_hand.turn()
    by_hand.clock.t_s += 86_400.0 - EVERY_S
    later = page_of(by_hand.meter)
    for page, gone in ((seen, 0), (later, 1)):
        left = page.of("own_certificate_days_left"), page.of("certificate_days_left", member="d2")
        assert left == pytest.approx((40 - gone, -1 - gone), abs=1e-4)
    assert seen.label_values("certificate_days_left", "member") == {"d1", "d2"}


def roster(clock: WorldClock, **days: int) -> Roster:
    now = datetime.fromtimestamp(clock.epoch_us() / 1e6, UTC)
    members = [
        RosterMember(
            name=name, role=Role.VEHICLE, key="0" * 64, not_after=now + timedelta(days=left)
        )
        for name, left in days.items()
    ]
    return Roster(fleet="harbour", number=1, members=members)


def test_a_desk_that_is_not_on_the_roster_has_no_day_left(by_hand):
    by_hand.gauges.ends = certificates_of(roster(by_hand.clock, d1=2), "desk")
    assert by_hand.turn().of("own_certificate_days_left") == 0


def test_who_is_on_a_line_and_should_not_be_and_who_was_turned_away_is_counted(by_hand):
    assert by_hand.turn().label_values("calls_turned_away_total", "why") == set()
    by_hand.gauges.door = Door(AT_DOOR)
    seen = by_hand.turn()
    assert seen.label_values("unwelcome_member", "member") == {"d2"}
    assert seen.of("calls_turned_away_total", why="stranger") == 7


def test_figures_are_taken_once_a_second_however_often_the_desk_turns(by_hand):
    by_hand.turn()
    first = by_hand.meter.figures
    by_hand.turn(0.4)
    by_hand.turn(0.4)
    assert by_hand.meter.figures is first
    by_hand.turn(0.2)
    assert by_hand.meter.figures is not first


# --- the page of the documents -------------------------------------------------------------------


AT_DOOR = DoorFigures({"d1": 1, "d2": 1}, {"d2": Unwelcome.REVOKED}, {TurnedAway.STRANGER: 7})
WATCH = Path(__file__).parents[3] / "docs" / "how-to" / "watch-the-desk.md"
NAME = re.compile(r"\b((?:leeway_desk|process)_[a-z_]+)(?:\{([a-z]+)=)?")


@pytest.fixture
def everything(told, by_hand) -> Scrape:
    """A scrape, over HTTP, in which nothing is absent."""
    by_hand.gauges.ends = certificates_of(roster(by_hand.clock, desk=40, d1=2), "desk")
    by_hand.gauges.door = Door(AT_DOOR)
    by_hand.desk.dispatcher.replans = told.day.dispatcher.replans  # type: ignore[misc]
    exchange = by_hand.desk.exchange
    exchange.answer_times = told.day.desk.exchange.answer_times
    exchange.rejected.add("d1", 1)
    hear(by_hand, "d1")
    exchange.store.command("c1", "d1", Recall(), "anna")
    by_hand.turn()
    by_hand.turn()
    with closing(MetricsServer("127.0.0.1", port := free_port())) as server:
        server.serve(desk_page(by_hand.meter, by_hand.clock).text)
        return scrape(port)


def sampled(seen: Scrape) -> dict[str, set[str]]:
    """Names of samples, a histogram's own name too, and the labels of each."""
    found: dict[str, set[str]] = {}
    for name, labels in seen.values:
        base = re.sub(r"_(bucket|count|sum)$", "", name)
        for one in (name, base):
            found.setdefault(one, set()).update(label for label, _ in labels)
    return found


def unknown(text: str, seen: Scrape) -> set[str]:
    """Names and labels in a text that no sample has."""
    there = sampled(seen)
    return {
        name
        for name, label in NAME.findall(text)
        if name not in there or (label and label not in there[name])
    }


def test_each_figure_that_the_documents_name_is_in_a_scrape_and_each_of_ours_is_named(everything):
    text = WATCH.read_text()
    assert unknown(text, everything) == set()
    named = {name for name, _ in NAME.findall(text)}
    ours = {name for name in everything.families if name.startswith("leeway_desk_")}
    assert ours - {name.removesuffix("_total") for name in named} == set()


def test_canary_a_figure_or_a_label_that_is_not_there_is_found(everything):
    wrong = 'leeway_desk_stores_up == 0 or leeway_desk_members{status="gone"} > 0'
    assert unknown(wrong, everything) == {"leeway_desk_stores_up", "leeway_desk_members"}
    assert unknown('leeway_desk_members{standing="gone"} > 0', everything) == set()
