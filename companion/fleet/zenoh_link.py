"""A fleet member's zenoh link: requests wait in boxes, messages leave by one thread.

The flight never waits for zenoh. The session opens in the background, with retries. What cannot be
sent is dropped, oldest first: states are repeated anyway, and events are kept (`event_log`) until
somebody asks for them.
"""

import math
import os
import queue
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NoReturn, TypeVar

import zenoh
from zenoh.handlers import Callback

from companion.adapters.clock import wall_s
from companion.core.base.rate_limit import RateLimit
from companion.core.mission.flight_file import NeighbourFleet
from companion.core.separation.track_cells import HeardCells
from companion.fleet.network import ASKED_AGAIN_S, WIND_COV, Ask, Asked, Told
from companion.fleet.topics import VehicleKeys, life_of, roster_key, track_of
from companion.fleet.waiting_room import WaitingRoom
from companion.fleet.zenoh_config import mode_of

Heard = TypeVar("Heard", zenoh.Query, zenoh.Sample, zenoh.Reply)

OPEN_AGAIN_S = 5.0
LOOK_S = 5.0
"""Where nothing is to be sent the writer looks so often whether a roster is due, whether it was
asked, and for whom to listen here. A companion's states come each second.
"""
UNASKED_S, MOST_UNASKED_S = 150.0, 2400.0
"""A desk asks all once a minute. Whom nobody asks so long, though he is connected, was missed when
he joined: he joins anew, after ever longer waits, since there may be a router and no desk.
"""

COMMANDS_WAIT = 256
COMMANDS_EACH = 16
"""Of them in one name: a desk sends a vehicle a few at once. What is dropped is sent again a second
later.
"""

ASKS_WAIT, TWINS_WAIT, ROSTERS_WAIT = 8, 1, 4
ASKS_HZ, ASKS_BURST = 10.0, 40.0
"""Of events: each desk, map and watch asks when it begins, and for what it missed."""

WAKES_HZ, WAKES_BURST = 50.0, 50.0
"""A flood wakes the flight's loop no oftener; what comes meanwhile waits for its next turn."""

ROSTER_AGAIN_S = 10.0
"""Where rosters find no room the true one may be among them: it is asked for."""

LEAVING = 4096
TRACKS = 256
"""Neighbours of each fleet whose newest places are kept; a flood by one takes the room of none, nor
does a neighbouring fleet that of our own.
"""

TRACKS_EACH = 8
"""Of one neighbour, who tells five a second: who signed them is seen only later, so a forged one
that comes behind the true one does not hide it. A look at a signature takes 0.1 ms.
"""

WINDS_KEPT = 4
"""Words of the winds of others: one comes every 10 s, and who signed it is seen only later."""

AFTER = "after"
ABOVE = "above"
"""A roster is asked for with the number of one's own: who has none above it does not answer."""
NUMBER_DIGITS = 15
TOLD_ROSTERS = "told rosters"
ROSTER_WAIT_S = 5.0
"""As long as a desk waits for an answer. Who misses it hears the next that the desk tells."""


class ZenohLink:
    """One life of one companion. `wake` is called from zenoh's threads: something waits.

    `is_member`: whose tracks get room. `roster_number`: of the roster in force. `claimed_by`: in
    whose name a command comes, of those who may command; empty: in nobody's.
    """

    def __init__(
        self,
        config: zenoh.Config,
        keys: VehicleKeys,
        life: str,
        wake: Callable[[], None],
        is_member: Callable[[str], bool] = lambda name: True,
        claimed_by: Callable[[bytes], str] | None = None,
        roster_number: Callable[[], int] = lambda: 0,
    ) -> None:
        self._config = config
        self._calls_a_desk = mode_of(config) == "client"
        self._keys = keys
        self._life = life
        self._wake = wake
        self._is_member = is_member
        self._claimed_by = claimed_by
        self._roster_number = roster_number
        self.waiting = WaitingRoom()
        self._asks = RateLimit(ASKS_HZ, ASKS_BURST)
        self._wakes = RateLimit(WAKES_HZ, WAKES_BURST)
        self._limits_lock = threading.Lock()
        self._roster_asked_s = 0.0
        self._newer_told = False
        self._tracks: dict[str, dict[str, deque[Told]]] = {}
        self._tracks_lock = threading.Lock()
        self._winds: deque[bytes] = deque(maxlen=WINDS_KEPT)
        self._place: tuple[float, float] | None = None
        self._neighbours: dict[str, NeighbourFleet] = {}
        self._leaving: queue.Queue[Callable[[], Any] | None] = queue.Queue(LEAVING)
        self._stop = threading.Event()
        self._session: zenoh.Session | None = None
        self._held: tuple[Any, ...] = ()
        self._state = b""
        self._reader_s, self._old_reader_s = -math.inf, -math.inf
        self._heard_s = 0.0
        self.trouble = "not open yet"
        self._thread = threading.Thread(target=self._run, name="zenoh-writer", daemon=True)
        self._thread.start()

    # --- in ------------------------------------------------------------------------------------

    def asked(self) -> list[Asked]:
        """Everything that waits."""
        return self.waiting.take()

    def be_woken(self, wake: Callable[[], None]) -> None:
        """Who waits now, and is to be woken."""
        self._wake = wake

    def _hear_command(self, query: zenoh.Query) -> None:
        self._heard_s = wall_s()
        payload = query.payload.to_bytes() if query.payload is not None else b""
        answer = self._answer(query, self._keys.command)
        self.put(Asked(Ask.COMMAND, answer, payload))

    def _hear_events_wanted(self, query: zenoh.Query) -> None:
        self._heard_s = wall_s()
        if not self._is_within(self._asks):
            self._leave(query.drop)
            return
        after = query.parameters.get(AFTER) or "0"
        answer = self._answer(query, self._keys.event)
        self.put(Asked(Ask.EVENTS, answer, after=int(after) if after.isdecimal() else 0))

    def _hear_state_wanted(self, query: zenoh.Query) -> None:
        self._heard_s = wall_s()
        if query.parameters.get(WIND_COV) is None:
            self._old_reader_s = self._heard_s
        else:
            self._reader_s = self._heard_s
        if self._state:
            self._answer(query, self._keys.state)([self._state])
        else:
            self._leave(query.drop)

    def _hear_alive(self, sample: zenoh.Sample) -> None:
        seen = life_of(str(sample.key_expr))
        if sample.kind == zenoh.SampleKind.PUT and seen is not None and seen[1] != self._life:
            self.put(Asked(Ask.TWIN, lambda replies: None, seen[1].encode()))

    def tracks(self) -> list[Told]:
        """The newest few that each neighbour told since the last call, each one's oldest first."""
        with self._tracks_lock:
            told, self._tracks = self._tracks, {}
        return [track for fleet in told.values() for each in fleet.values() for track in each]

    def wind_cov_is_read(self) -> bool:
        """Whether all who asked for states of late read the covariance of the wind."""
        since_s = wall_s() - ASKED_AGAIN_S
        return self._reader_s >= since_s > self._old_reader_s

    def _hear_track(self, fleet: str, sample: zenoh.Sample) -> None:
        key = track_of(str(sample.key_expr))
        if key is None:
            return
        speaker, cell = key
        if not self._gets_room(fleet, speaker):
            return
        told = Told(speaker, cell, sample.payload.to_bytes(), fleet)
        with self._tracks_lock:
            boxes = self._tracks.setdefault(fleet, {})
            box = boxes.get(speaker)
            if box is None:
                if len(boxes) >= TRACKS:
                    return
                box = boxes[speaker] = deque(maxlen=TRACKS_EACH)
            box.append(told)

    def _gets_room(self, fleet: str, speaker: str) -> bool:
        """Whether tracks in this name are kept until somebody looks who signed them."""
        if not fleet:
            return speaker != self._keys.vehicle and self._is_member(speaker)
        neighbour = self._neighbours.get(fleet)
        return neighbour is not None and (not neighbour.keys or speaker in neighbour.keys)

    def winds(self) -> list[bytes]:
        """The newest few words of the winds of others since the last call, oldest first."""
        found: list[bytes] = []
        while self._winds:
            found.append(self._winds.popleft())
        return found

    def _hear_winds(self, sample: zenoh.Sample) -> None:
        self._winds.append(sample.payload.to_bytes())

    def hear_near(self, lat_deg: float, lon_deg: float) -> None:
        """Listen to the cells about this place; the writer thread tells the network."""
        self._place = lat_deg, lon_deg

    def hear_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        """Listen to these fleets, too; nobody is a neighbour of its own fleet."""
        self._neighbours = {one.fleet: one for one in neighbours if one.fleet != self._keys.fleet}

    def _hear_roster(self, sample: zenoh.Sample) -> None:
        raw = sample.payload.to_bytes()
        if (number := told_number(raw)) is not None:
            if number > self._roster_number():
                self._newer_told = True
            return
        self._put(TOLD_ROSTERS, Asked(Ask.ROSTER, lambda replies: None, raw), ROSTERS_WAIT)

    def _hear_roster_reply(self, reply: zenoh.Reply) -> None:
        """What came because we asked cannot be pushed out by what is told."""
        if reply.ok is not None:
            asked = Asked(Ask.ROSTER, lambda replies: None, reply.ok.payload.to_bytes())
            self._put("asked rosters", asked, ROSTERS_WAIT, keep_first=True)

    def _answer(self, query: zenoh.Query, key: str) -> Callable[[list[bytes]], None]:
        def answer(replies: list[bytes]) -> None:
            def send() -> None:
                for raw in replies:
                    query.reply(key, raw)
                query.drop()

            self._leave(send)

        return answer

    def put(self, asked: Asked) -> None:
        """Have it wait in its box, and wake whoever waits for it."""
        match asked.ask:
            case Ask.COMMAND if self._claimed_by is not None:
                self._put(f"commands {self._claimed_by(asked.payload)}", asked, COMMANDS_EACH)
            case Ask.COMMAND:
                self._put("commands", asked, COMMANDS_WAIT)
            case Ask.EVENTS:
                self._put("events", asked, ASKS_WAIT)
            case _:
                self._put(asked.ask.value, asked, TWINS_WAIT)

    def _put(self, box: str, asked: Asked, most: int, *, keep_first: bool = False) -> None:
        left_out = self.waiting.put(box, asked, most, keep_first=keep_first)
        if left_out is not None:
            self._leave(partial(_let_go, left_out))
        if self._is_within(self._wakes):
            self._wake()

    def _is_within(self, limit: RateLimit) -> bool:
        """Whether one more is within a limit; zenoh's threads ask side by side."""
        with self._limits_lock:
            return limit.take(wall_s())

    # --- out -----------------------------------------------------------------------------------

    def publish_state(self, raw: bytes) -> None:
        """Tell the newest state; who asks later gets it too."""
        self._state = raw
        self._leave(lambda: self._publish(self._keys.state, raw))

    def publish_event(self, raw: bytes) -> None:
        """Tell an event, if anybody listens."""
        self._leave(lambda: self._publish(self._keys.event, raw))

    def publish_track(self, raw: bytes, cell: str) -> None:
        """Tell those who listen to this cell where we are; never waits behind anything that is
        worth keeping.
        """
        if self._leaving.qsize() < TRACKS:
            self._leave(lambda: self._publish(self._keys.track(cell), raw))

    def _publish(self, key: str, raw: bytes) -> None:
        if self._session is not None:
            self._session.put(key, raw, express=True)

    def _leave(self, send: Callable[[], Any]) -> None:
        while True:
            try:
                return self._leaving.put_nowait(send)
            except queue.Full:
                try:
                    self._leaving.get_nowait()
                except queue.Empty:
                    continue

    def close(self) -> None:
        """Say what is left to say, and leave; the token goes with the session."""
        self._stop.set()
        self._leave(lambda: None)
        self._thread.join(timeout=5.0)

    # --- the thread ----------------------------------------------------------------------------

    def _run(self) -> None:
        unasked_s = UNASKED_S
        while not self._stop.is_set():
            try:
                session = zenoh.open(self._config)
            except zenoh.ZError as error:
                self.trouble = str(error)
                self._stop.wait(OPEN_AGAIN_S)
                continue
            opened_s = self._heard_s = wall_s()
            with session:
                self._serve(session, unasked_s)
            was_asked = self._heard_s > opened_s
            unasked_s = UNASKED_S if was_asked else min(2.0 * unasked_s, MOST_UNASKED_S)
        self._session = None

    def _serve(self, session: zenoh.Session, unasked_s: float) -> None:
        """Until we stop, or are connected and were asked nothing for so long."""
        keys = self._keys
        liveliness = session.liveliness()
        held = (  # a declaration that nobody holds is undeclared
            session.declare_queryable(keys.command, at_once(self._hear_command)),
            session.declare_queryable(keys.event, at_once(self._hear_events_wanted)),
            session.declare_queryable(keys.state, at_once(self._hear_state_wanted)),
            liveliness.declare_subscriber(keys.alive(), at_once(self._hear_alive), history=True),
            session.declare_subscriber(roster_key(keys.fleet), at_once(self._hear_roster)),
            session.declare_subscriber(keys.wind, at_once(self._hear_winds)),
            liveliness.declare_token(keys.alive(self._life)),
        )
        self._session, self._held, self.trouble = session, held, ""
        self._ask_roster(session)
        ears = _Ears(partial(self._listen, session))
        while not (self._stop.is_set() and self._leaving.empty()):
            if self._calls_a_desk and wall_s() - self._heard_s > unasked_s and has_line(session):
                self.trouble = f"nobody has asked for {unasked_s:.0f} s: joining anew"
                return
            if self._is_roster_due():
                self._ask_roster(session)
            try:
                send = self._leaving.get(timeout=LOOK_S)
            except queue.Empty:
                send = None
            if (place := self._place) is not None:
                self._try(partial(ears.be_at, place, ("", *self._neighbours), wall_s()))
            if send is not None:
                self._try(send)

    def _listen(self, session: zenoh.Session, fleet: str, cell: str) -> "zenoh.Subscriber[None]":
        key = self._keys.tracks(cell, fleet)
        return session.declare_subscriber(key, at_once(partial(self._hear_track, fleet)))

    def _try(self, do: Callable[[], Any]) -> None:
        try:
            do()
        except zenoh.ZError as error:
            self.trouble = str(error)

    def _is_roster_due(self) -> bool:
        rested = wall_s() - self._roster_asked_s >= ROSTER_AGAIN_S
        return rested and (self._newer_told or self.waiting.dropped(TOLD_ROSTERS) > 0)

    def _ask_roster(self, session: zenoh.Session) -> None:
        """Of everybody who has a newer one: an answer that is forged takes the place of none."""
        self._roster_asked_s, self._newer_told = wall_s(), False
        session.get(
            f"{roster_key(self._keys.fleet)}?{ABOVE}={self._roster_number()}",
            at_once(self._hear_roster_reply),
            timeout=ROSTER_WAIT_S,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )


class _Ears:
    """Subscriptions of one session to tracks, one a fleet and cell; `listen` declares one."""

    def __init__(self, listen: Callable[[str, str], "zenoh.Subscriber[None]"]) -> None:
        self._listen = listen
        self._cells = HeardCells()
        self._fleets: Sequence[str] = ()
        self._held: dict[tuple[str, str], zenoh.Subscriber[None]] = {}

    def be_at(self, place: tuple[float, float], fleets: Sequence[str], now_s: float) -> None:
        """Listen about this place: to the new cells first, then no more to those long left."""
        cells = self._cells.at(*place, now_s)
        if cells is self._cells and fleets == self._fleets:
            return
        self._cells, self._fleets = cells, fleets
        wanted = [(fleet, cell) for fleet in fleets for cell in cells.near_s]
        for new in wanted:  # our own fleet first
            if new not in self._held:
                self._held[new] = self._listen(*new)
        for left in self._held.keys() - set(wanted):
            self._held.pop(left).undeclare()


def at_once(hear: Callable[[Heard], None]) -> "Callback[Heard]":
    """In zenoh's own threads, side by side: a declaration has none of its own, and what it has not
    looked at yet waits with the sender. `hear` puts things in boxes and sends nothing: the last one
    to let go of a query ends it, which is a message, and so is the writer.
    """
    return Callback(hear, indirect=False)


def _let_go(asked: Asked) -> None:
    """Of a query that found no room, in the writer's thread."""


def told_number(raw: bytes) -> int | None:
    """The number of a roster, where somebody tells only that: digits. None: anything else."""
    return int(raw) if raw.isdigit() and len(raw) <= NUMBER_DIGITS else None


def has_line(session: zenoh.Session) -> bool:
    """Whether it is joined to anybody."""
    return bool(session.info.routers_zid() or session.info.peers_zid())


def leave_process(code: int) -> NoReturn:
    """End a process that was on zenoh, once everything of ours is closed.

    Threads of zenoh's runtime may still want Python's lock to drop a callback; one that gets there
    while the interpreter shuts down aborts the process ("FATAL: exception not rethrown", seen once
    in twenty exits), and a clean stop would look like a crash to systemd.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
