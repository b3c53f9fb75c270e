"""What has come for the desk: a small box for each member, so that none can crowd out another.

zenoh's threads only put bytes in; the desk's one thread takes them out and decodes them. Of a
life's states only its newest counts; who signed them is not known before they are taken out, so a
few are kept, and forged ones that come faster do not hide the true one. Events are held to a rate,
a size and a number in a turn: what is left out is asked for again, since every state tells how many
events there are. Answers to commands have a queue of their own. Who is not a member gets no box. A
turn looks only into the boxes that something has come into.
"""

import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from companion.core.base.rate_limit import RateLimit
from companion.core.base.safe_text import LONGEST_NAME, safe_text
from companion.fleet.envelope import OVERHEAD_BYTES
from companion.fleet.messages import (
    LARGEST_BYTES,
    FleetEvent,
    Refused,
    Result,
    State,
    decode_event,
    decode_state,
)
from companion.fleet.topics import station_of, vehicle_of
from ground_station.adapters.clock import monotonic_s
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    EventsReceived,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
    StationWindReceived,
)
from ground_station.core.fleet.station_message import StationWind, decode_station

EVENTS_HZ = 20.0
"""A flight tells some 50 events in 20 minutes, and a handful at once when it ends."""

EVENTS_BURST = 200
EVENTS_A_TURN = 50
"""Of one member: a transaction of 50 events of each of 100 members takes about a second."""

STATES_A_TURN = 64
"""Of one member. It sends one a second: more are somebody else's, and each costs a look at its
signature (0.1 ms). So many at once are looked at without gathering more, 8 ms of them.
"""

ASKED_A_TURN = 8
"""States of one member that came because this desk asked for them: it answers once, and who sends
without being asked cannot push that out.
"""

GATHER_S = 0.05
"""States and events that come within it are taken together: of a thousand vehicles, 50 at a time.
Answers, and who comes and goes, wait for nothing.
"""

MOST_LIVES = 16
"""Of one name at once. Two are one too many already; a flood of them is not worth more room."""

MOST_MEMBERS = 5000
"""Names that are kept: five times what one desk is meant for."""


MOST_STATIONS = 64
"""Wind stations whose newest words are kept between two turns."""

STATIONS_A_TURN = 8
"""Of one station: it tells once a second at most; more are somebody else's."""

NOT_LISTED = "a name that is not on the roster"

STATION_BYTES = LARGEST_BYTES["station"] + OVERHEAD_BYTES
STATION_BOX = "wind stations"
"""Under this name is told what of them was rejected."""

Opened = Callable[[str, bytes, str], bytes | Refused]
Clock = Callable[[], float]

_Raw = tuple[str, bytes]
"""A member, and the bytes that came by its key."""


_DECODERS: dict[str, Callable[[bytes], State | FleetEvent | Refused]] = {
    "state": decode_state,
    "event": decode_event,
}


@dataclass(slots=True)
class MemberBox:
    """What has come for one member, or in its name."""

    events: deque[bytes] = field(default_factory=lambda: deque(maxlen=EVENTS_BURST))
    limit: RateLimit = field(default_factory=lambda: RateLimit(EVENTS_HZ, EVENTS_BURST))
    states: deque[bytes] = field(default_factory=lambda: deque(maxlen=STATES_A_TURN))
    asked_states: list[bytes] = field(default_factory=list)
    lives: set[str] = field(default_factory=set)
    lives_told: set[str] = field(default_factory=set)
    lives_left: set[str] = field(default_factory=set)
    """Since the roll call began whose answers may still come."""
    rejected: Counter[str] = field(default_factory=Counter)

    def reject(self, why: str) -> None:
        """Count it; of many reasons the first few are kept."""
        self.rejected[why if why in self.rejected or len(self.rejected) < 8 else "other"] += 1

    def take_life(self, life: str, *, up: bool) -> None:
        """It has come or gone; a flood of lives gets no more room than a few."""
        if up and life not in self.lives and len(self.lives) >= MOST_LIVES:
            self.reject(f"more than {MOST_LIVES} lives of one name")
        elif up:
            self.lives.add(life)
        elif life in self.lives:
            self.lives.discard(life)
            if len(self.lives_left) < MOST_LIVES:
                self.lives_left.add(life)

    def take_state(self, raw: bytes, *, asked: bool) -> None:
        """Of states the newest are kept, of those that were asked for the first."""
        if not asked:
            self.states.append(raw)
        elif len(self.asked_states) < ASKED_A_TURN:
            self.asked_states.append(raw)

    def taken_states(self) -> list[bytes]:
        """All that wait."""
        found = [*self.states, *self.asked_states]
        self.states.clear()
        self.asked_states.clear()
        return found


_Boxes = dict[str, MemberBox]
"""By member."""


class FleetInbox:
    """Thread-safe. `hear_*` return at once; `receive` waits for the first."""

    def __init__(
        self,
        opened: Opened = lambda kind, raw, vehicle: raw,
        clock_s: Clock = monotonic_s,
        is_member: Callable[[str], bool] = lambda vehicle: True,
    ) -> None:
        """`opened(kind, raw, vehicle)`: the message that the vehicle itself has signed.
        `is_member`: whose messages get room.
        """
        self._opened = opened
        self._clock_s = clock_s
        self._is_member = is_member
        self._news = threading.Condition()
        self._boxes: _Boxes = {"": MemberBox()}
        self._fresh: _Boxes = {}
        self._answers: deque[CommandAnswered] = deque()
        self._replays: deque[tuple[str, list[bytes]]] = deque()
        self._stations: dict[str, deque[bytes]] = {}
        self._has_news = False
        self._is_urgent = False

    # --- in, from any thread -------------------------------------------------------------------

    def hear_state(self, key: str, raw: bytes, *, asked: bool = False) -> None:
        """A state came by this key; `asked`: as the answer to a question of ours."""
        with self._news:
            box = self._box_of(key, raw, "state")
            if box is not None:
                box.take_state(raw, asked=asked)
            self._wake(urgent=box is not None and len(box.states) == STATES_A_TURN)

    def hear_station(self, key: str, raw: bytes) -> None:
        """A wind station told something by this key."""
        station = station_of(key)
        with self._news:
            is_one = station is not None and self._is_member(station)
            if station is None or not is_one or len(raw) > STATION_BYTES:
                self._fresh[""] = self._boxes[""]
                self._boxes[""].reject("no word of a wind station")
            elif station in self._stations or len(self._stations) < MOST_STATIONS:
                box = self._stations.setdefault(station, deque(maxlen=STATIONS_A_TURN))
                box.append(raw)
            self._wake()

    def hear_event(self, key: str, raw: bytes) -> None:
        """An event came by this key."""
        with self._news:
            box = self._box_of(key, raw, "event")
            if box is not None and box.limit.take(self._clock_s()):
                box.events.append(raw)
            elif box is not None:
                box.reject(f"more than {EVENTS_HZ:g} events a second: asked for again later")
            self._wake()

    def hear_replay(self, vehicle: str, raws: list[bytes]) -> None:
        """All events that a member was asked for."""
        with self._news:
            self._replays.append((vehicle, raws))
            self._wake()

    def hear_answer(self, command_id: str, result: Result | None) -> None:
        """The answer to a command of this desk, or `None` for none."""
        with self._news:
            self._answers.append(CommandAnswered(command_id, result))
            self._wake(urgent=True)

    def hear_life(self, vehicle: str, life: str, *, up: bool) -> None:
        """A life of a member has come or gone."""
        with self._news:
            box = self._of(vehicle)
            if box is not None:
                box.take_life(life, up=up)
                self._wake(urgent=True)

    def begin_roll_call(self) -> None:
        """From here on who is there is told by `hear_present`."""
        with self._news:
            for box in self._boxes.values():
                box.lives_left.clear()

    def hear_present(self, vehicle: str, life: str) -> None:
        """Answer to a roll call: a life is there, unless it has left meanwhile."""
        with self._news:
            box = self._boxes.get(vehicle)
            known = box is not None and (life in box.lives or life in box.lives_left)
        if not known:
            self.hear_life(vehicle, life, up=True)

    def reject(self, vehicle: str | None, why: str) -> None:
        """Something came that is no message of a member."""
        with self._news:
            box = self._of(vehicle or "", said_by_us=True)
            if box is not None:
                box.reject(why)
            self._wake()

    def _box_of(self, key: str, raw: bytes, kind: str) -> MemberBox | None:
        """Where a message goes that came by this key; `None`: nowhere."""
        vehicle = vehicle_of(key)
        box = self._of(vehicle or "")
        if box is None:
            return None
        if vehicle is None:
            box.reject(f"{safe_text(key)[:LONGEST_NAME]}: no key of a member")
            return None
        if len(raw) > LARGEST_BYTES[kind] + OVERHEAD_BYTES:
            box.reject(f"{kind}: {len(raw)} bytes, expected at most {LARGEST_BYTES[kind]}")
            return None
        return box

    def _of(self, vehicle: str, *, said_by_us: bool = False) -> MemberBox | None:
        """The box that something comes into; `None`: there is no room for it. What comes by no
        member's key is counted in one box.
        """
        if vehicle not in self._boxes:
            if not (said_by_us or self._is_member(vehicle)):
                self._fresh[""] = self._boxes[""]
                self._boxes[""].reject(NOT_LISTED)
                return None
            if len(self._boxes) > MOST_MEMBERS:
                return None
            self._boxes[vehicle] = MemberBox()
        box = self._fresh[vehicle] = self._boxes[vehicle]
        return box

    def _wake(self, *, urgent: bool = False) -> None:
        wakes = not self._has_news or (urgent and not self._is_urgent)
        self._has_news = True
        self._is_urgent = self._is_urgent or urgent
        if wakes:
            self._news.notify()

    # --- out, by the desk's thread -------------------------------------------------------------

    @property
    def waiting(self) -> int:
        """Answers, replays and events that have not been received."""
        with self._news:
            events = sum(len(box.events) for box in self._fresh.values())
            return len(self._answers) + len(self._replays) + events

    def receive(self, wait_s: float) -> list[FleetInput]:
        """What has come, of each member a turn's worth; waits this long for the first.

        Who is there comes first, then events, then answers (a vehicle tells what happened before it
        answers), then the states that count the events.
        """
        with self._news:
            if self._news.wait_for(lambda: self._has_news, timeout=wait_s):
                self._news.wait_for(lambda: self._is_urgent, timeout=GATHER_S)
            self._has_news = self._is_urgent = False
            fresh, self._fresh = self._fresh, {}
            found = self._taken_lives(fresh)
            answers, self._answers = self._answers, deque()
            replays, self._replays = self._replays, deque()
            events, states = self._taken_messages(fresh)
            stations, self._stations = self._stations, {}
        for vehicle, raws in replays:
            found += self._replayed(vehicle, raws)
        for vehicle, raw in events:
            event = self._decoded(vehicle, "event", raw)
            if isinstance(event, FleetEvent):
                found.append(EventsReceived(vehicle, [event]))
        found += answers
        for vehicle, raws in states:
            found += self._newest_states(vehicle, raws)
        for station, words in stations.items():
            found += self._station_winds(station, words)
        return found + self._taken_rejections(fresh)

    def _newest_states(self, vehicle: str, raws: list[bytes]) -> list[FleetInput]:
        """Of each life that speaks as this member its newest, by the life's own clock."""
        newest: dict[str, State] = {}
        for raw in raws:
            state = self._decoded(vehicle, "state", raw)
            if not isinstance(state, State):
                continue
            before = newest.pop(state.life, state)
            newest[state.life] = before if before.uptime_s > state.uptime_s else state
        return [StateReceived(state) for state in newest.values()]

    def _station_winds(self, station: str, raws: Iterable[bytes]) -> list[FleetInput]:
        """What a wind station said and signed itself; of all that came the newest."""
        newest: StationWind | None = None
        for raw in raws:
            told = self._opened("station", raw, station)
            wind = told if isinstance(told, Refused) else decode_station(told)
            if isinstance(wind, Refused):
                self.reject(STATION_BOX, f"{station}: {wind.reason}")
            elif wind.station != station:
                self.reject(STATION_BOX, f"{station} speaks for {wind.station}")
            elif newest is None or wind.epoch_us > newest.epoch_us:
                newest = wind
        return [] if newest is None else [StationWindReceived(newest)]

    def _taken_lives(self, fresh: _Boxes) -> list[FleetInput]:
        """Who is there now and was not at the last call, and the other way round."""
        found: list[FleetInput] = []
        for vehicle, box in fresh.items():
            changed = box.lives ^ box.lives_told
            found += [LivelinessChanged(vehicle, x, up=x in box.lives) for x in sorted(changed)]
            box.lives_told = set(box.lives)
        return found

    def _taken_messages(self, fresh: _Boxes) -> tuple[list[_Raw], list[tuple[str, list[bytes]]]]:
        """(events, states), of each member at most a turn's worth; the rest is news again."""
        events: list[_Raw] = []
        states: list[tuple[str, list[bytes]]] = []
        for vehicle, box in fresh.items():
            count = min(len(box.events), EVENTS_A_TURN)
            events += [(vehicle, box.events.popleft()) for _ in range(count)]
            if box.events:
                self._has_news, self._fresh[vehicle] = True, box
            if raws := box.taken_states():
                states.append((vehicle, raws))
        return events, states

    def _taken_rejections(self, fresh: _Boxes) -> list[FleetInput]:
        """With those of what was decoded just now."""
        found: list[FleetInput] = []
        with self._news:
            for vehicle, box in (fresh | self._fresh).items():
                counted, box.rejected = box.rejected, Counter()
                found += [MessageRejected(vehicle, why, n) for why, n in counted.items()]
        return found

    def _replayed(self, vehicle: str, raws: list[bytes]) -> list[FleetInput]:
        decoded = [self._decoded(vehicle, "event", raw) for raw in raws]
        events = [event for event in decoded if isinstance(event, FleetEvent)]
        events.sort(key=lambda event: event.seq)
        return [EventsReceived(vehicle, events, replayed=True)] if events else []

    def _decoded(self, vehicle: str, kind: str, raw: bytes) -> State | FleetEvent | None:
        """A message of the vehicle whose key it came by; anything else is rejected."""
        told = self._opened(kind, raw, vehicle)
        message = told if isinstance(told, Refused) else _DECODERS[kind](told)
        if isinstance(message, Refused):
            self.reject(vehicle, message.reason)
            return None
        if message.vehicle != vehicle:
            self.reject(vehicle, f"speaks for {message.vehicle}")
            return None
        return message
