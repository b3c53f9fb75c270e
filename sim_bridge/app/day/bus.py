"""The fleet's network in one process: desk and members exchange messages on simulated time.

Semantics follow zenoh. States and events go to every desk. Commands and queries go to every session
of a vehicle; each is answered or visibly times out. Every desk sees a member's liveliness. A
message takes `DELAY_S` and is dropped with probability `loss`. Liveliness is never dropped, because
zenoh maintains it itself. The same generator gives the same losses.
"""

import heapq
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np

from companion.core.mission.flight_file import NeighbourFleet
from companion.core.separation.track_cells import HeardCells, cell_of
from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.messages import (
    Command,
    FleetEvent,
    Refused,
    Result,
    State,
    decode_event,
    decode_result,
    decode_state,
    decode_track,
    encode,
)
from companion.fleet.network import Ask, Asked, Told
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    EventsReceived,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)

DELAY_S = 0.02
"""Message delay: a few hops of a radio network, less than a step of the simulated day."""

LEASE_S = 10.0
"""A session that is not heard is taken for gone: zenoh's lease (transport/link/tx/lease)."""

Answers = Callable[[list[bytes]], None]


@dataclass(slots=True)
class Bus:
    """The network. `t_s` is the day's time, set by the caller that steps it; `deliver` after each
    step.
    """

    rng: np.random.Generator
    loss: float = 0.0
    t_s: float = 0.0
    sent: int = 0
    lost: int = 0
    track_delay_s: float = DELAY_S
    spoil: Callable[[bytes, float], bytes] = lambda raw, t_s: raw
    states: dict[str, State] = field(default_factory=dict)
    """Each vehicle's last published state, delivered or not; for the judge."""
    fleet: str = "fleet"
    beside: list["Bus"] = field(default_factory=list)
    """Networks of other fleets: vehicles there may hear the tracks that are told here."""
    cut_until_s: float = 0.0
    """Until then nothing passes between the desk and the members."""
    _cut_off_until_s: dict[str, float] = field(default_factory=dict)
    """Until then nothing passes to or from this member."""
    _links: list["BusLink"] = field(default_factory=list)
    _desks: list["BusFleet"] = field(default_factory=list)
    _under_way: list[tuple[float, int, Callable[[], None]]] = field(default_factory=list)
    _numbers: "count[int]" = field(default_factory=count)

    def join(self, vehicle: str, life: str) -> "BusLink":
        """Add a member session; every desk sees it come alive."""
        link = BusLink(self, vehicle, life)
        for other in self.links_of(vehicle):
            self._twin(other, link)
            self._twin(link, other)
        self._links.append(link)
        self._all_see(link, up=True)
        return link

    def _twin(self, who: "BusLink", twin: "BusLink") -> None:
        asked = Asked(Ask.TWIN, lambda replies: None, twin.life.encode())
        self.later(DELAY_S, lambda: who.hear(asked))

    def leave(self, link: "BusLink") -> None:
        """Remove a member session, closed or killed; its liveliness token is dropped."""
        if link in self._links:
            self._links.remove(link)
            self._all_see(link, up=False)

    def _all_see(self, link: "BusLink", *, up: bool) -> None:
        for desk in list(self._desks):
            self.tell_alive(desk, link, up=up)

    def tell_alive(self, desk: "BusFleet", link: "BusLink", *, up: bool) -> None:
        """Notify a desk that a member session came or went."""
        alive = LivelinessChanged(link.vehicle, link.life, up=up)
        open_s = self._open_s(link.vehicle)
        self.later(max(DELAY_S, open_s - self.t_s), lambda: desk.hear(alive))

    def cut(self, for_s: float) -> None:
        """Lose every message for so long; past the lease members are gone, and come back."""
        self.cut_until_s = max(self.cut_until_s, self.t_s + for_s)
        self._let_lease_end(self.cut_until_s, None)

    def cut_off(self, vehicle: str, for_s: float) -> None:
        """Lose every message to and from one member for so long, as where its radio is off."""
        until_s = max(self._open_s(vehicle), self.t_s + for_s)
        self._cut_off_until_s[vehicle] = until_s
        self._let_lease_end(until_s, vehicle)

    def _open_s(self, vehicle: str) -> float:
        """From when on messages pass to and from this member."""
        return max(self.cut_until_s, self._cut_off_until_s.get(vehicle, 0.0))

    def _let_lease_end(self, until_s: float, vehicle: str | None) -> None:
        if until_s - self.t_s > LEASE_S:
            self.later(LEASE_S, lambda: self._all_told(vehicle, up=False))
            self.later(until_s - self.t_s, lambda: self._all_told(vehicle, up=True))

    def _all_told(self, vehicle: str | None, *, up: bool) -> None:
        for desk in list(self._desks):
            for link in self.links_of(vehicle):
                desk.hear(LivelinessChanged(link.vehicle, link.life, up=up))

    def desk(self) -> "BusFleet":
        """Add a desk; it is told which members are alive."""
        desk = BusFleet(self)
        self._desks.append(desk)
        for link in self._links:
            self.tell_alive(desk, link, up=True)
        return desk

    def leave_desk(self, desk: "BusFleet") -> None:
        """Remove a desk."""
        if desk in self._desks:
            self._desks.remove(desk)

    @property
    def desks(self) -> list["BusFleet"]:
        """The connected desks."""
        return list(self._desks)

    def links_of(self, vehicle: str | None = None) -> list["BusLink"]:
        """The sessions of one vehicle, or of all."""
        return [link for link in self._links if vehicle in (None, link.vehicle)]

    def post(self, member: str, deliver: Callable[[], None]) -> None:
        """Send a message of or to a member: it arrives after `DELAY_S`, or is lost."""
        if not self._is_lost(member):
            self.later(DELAY_S, deliver)

    def post_track(self, sender: "BusLink", raw: bytes) -> None:
        """Send a track to every other vehicle that listens to the sender's cell, with this
        network's delay and distortion: a place that is wrong is told in the cell where it is.
        """
        raw = self.spoil(raw, self.t_s)
        track = decode_track(raw)
        cell = None if isinstance(track, Refused) else cell_of(track.lat_deg, track.lon_deg)
        if cell is None:
            return
        told = Told(sender.vehicle, cell, raw)
        for link in self.links_of():
            near = link.vehicle != sender.vehicle and link.listens_to(cell)
            if near and not self._is_lost(sender.vehicle, link.vehicle):
                self.later(self.track_delay_s, lambda link=link: link.hear_track(told))
        foreign = Told(sender.vehicle, cell, raw, self.fleet)
        for bus in self.beside:
            for link in bus.links_of():
                near = link.hears(self.fleet) and link.listens_to(cell)
                if near and not self._is_lost(sender.vehicle):
                    self.later(self.track_delay_s, lambda link=link: link.hear_track(foreign))

    def _is_lost(self, *members: str) -> bool:
        self.sent += 1
        if self.t_s < max(map(self._open_s, members)):
            self.lost += 1
            return True
        lost = self.loss > 0.0 and self.rng.random() < self.loss
        self.lost += lost
        return lost

    def later(self, after_s: float, do: Callable[[], None]) -> None:
        """Schedule a call `after_s` from now."""
        heapq.heappush(self._under_way, (self.t_s + after_s, next(self._numbers), do))

    def deliver(self, t_s: float) -> None:
        """Advance time to `t_s` and make the calls that are due."""
        while self._under_way and self._under_way[0][0] <= t_s:
            self.t_s, _, do = heapq.heappop(self._under_way)
            do()
        self.t_s = t_s


@dataclass(slots=True)
class BusLink:
    """A member's end (`companion.fleet.network.MemberLink`); one per session (`life`)."""

    bus: Bus
    vehicle: str
    life: str
    state: bytes = b""
    _waiting: list[Asked] = field(default_factory=list)
    _tracks: list[Told] = field(default_factory=list)
    _winds: list[bytes] = field(default_factory=list)
    _cells: HeardCells = field(default_factory=HeardCells)
    _neighbours: frozenset[str] = frozenset()

    def asked(self) -> list[Asked]:
        """Take all pending commands and queries."""
        waiting, self._waiting = self._waiting, []
        return waiting

    def hear(self, asked: Asked) -> None:
        """Queue an incoming command or query."""
        self._waiting.append(asked)

    def be_woken(self, wake: Callable[[], None]) -> None:
        """No effect: every member is stepped."""

    def publish_state(self, raw: bytes) -> None:
        """Publish the newest state; it also answers later queries."""
        self.state = raw
        state = decode_state(raw)
        if isinstance(state, State):
            self.bus.states[self.vehicle] = state
        for desk in self.bus.desks:
            self.bus.post(self.vehicle, lambda desk=desk: desk.hear_state(self.vehicle, raw))

    def publish_event(self, raw: bytes) -> None:
        """Publish an event to every desk."""
        for desk in self.bus.desks:
            self.bus.post(self.vehicle, lambda desk=desk: desk.hear_event(self.vehicle, raw))

    def publish_track(self, raw: bytes, cell: str) -> None:
        """Send the own position to the neighbours."""
        self.bus.post_track(self, raw)

    def hear_near(self, lat_deg: float, lon_deg: float) -> None:
        """Listen to the cells about this place."""
        self._cells = self._cells.at(lat_deg, lon_deg, self.bus.t_s)

    def hear_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        """Listen to these fleets, too."""
        self._neighbours = frozenset(one.fleet for one in neighbours)

    def hears(self, fleet: str) -> bool:
        """Whether it listens to this neighbouring fleet."""
        return fleet in self._neighbours

    def listens_to(self, cell: str) -> bool:
        """Whether this cell is near, or was of late."""
        return cell in self._cells.near_s

    def tracks(self) -> list[Told]:
        """Neighbours' tracks received since the last call."""
        tracks, self._tracks = self._tracks, []
        return tracks

    def winds(self) -> list[bytes]:
        """What desks told of the winds of others since the last call."""
        winds, self._winds = self._winds, []
        return winds

    def hear_winds(self, raw: bytes) -> None:
        """Queue what a desk told."""
        self._winds.append(raw)

    def wind_cov_is_read(self) -> bool:
        """Every desk here is of this version."""
        return True

    def hear_track(self, told: Told) -> None:
        """Queue a neighbour's track."""
        self._tracks.append(told)

    def close(self) -> None:
        """Leave the network."""
        self.bus.leave(self)


@dataclass(slots=True)
class BusFleet:
    """A desk's end (`ground_station.core.fleet.fleet_link.Fleet`)."""

    bus: Bus
    _heard: list[FleetInput] = field(default_factory=list)

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Take what has arrived; never waits."""
        heard, self._heard = self._heard, []
        return heard

    def hear(self, heard: FleetInput) -> None:
        """Queue an input for the desk."""
        self._heard.append(heard)

    def hear_state(self, vehicle: str, raw: bytes) -> None:
        """Decode and queue a vehicle's state."""
        state = self._decoded(vehicle, raw, decode_state)
        if isinstance(state, State):
            self.hear(StateReceived(state))

    def hear_event(self, vehicle: str, raw: bytes) -> None:
        """Decode and queue a vehicle's event."""
        event = self._decoded(vehicle, raw, decode_event)
        if isinstance(event, FleetEvent):
            self.hear(EventsReceived(vehicle, [event]))

    def ask_states(self, wait_s: float) -> None:
        """Query every vehicle for its newest state."""
        for link in self.bus.links_of():
            self.bus.post(link.vehicle, lambda link=link: self._reply_state(link))

    def _reply_state(self, link: BusLink) -> None:
        if link.state:
            self.bus.post(link.vehicle, lambda: self.hear_state(link.vehicle, link.state))

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Query a vehicle for its stored events after this number."""
        for link in self.bus.links_of(vehicle):
            asked = Asked(
                Ask.EVENTS, self._once(vehicle, lambda raw: self._replay(vehicle, raw)), b"", after
            )
            self.bus.post(link.vehicle, lambda link=link, asked=asked: link.hear(asked))

    def _once(self, vehicle: str, take: Answers) -> Answers:
        """Callback that sends all replies as one message; further calls do nothing."""
        gone: list[bool] = []

        def answer(replies: list[bytes]) -> None:
            if not gone:
                gone.append(True)
                self.bus.post(vehicle, lambda: take(replies))

        return answer

    def _replay(self, vehicle: str, replies: list[bytes]) -> None:
        events = [self._decoded(vehicle, raw, decode_event) for raw in replies]
        found = sorted((e for e in events if isinstance(e, FleetEvent)), key=lambda e: e.seq)
        if found:
            self.hear(EventsReceived(vehicle, found, replayed=True))

    def send(self, command: Command, wait_s: float) -> None:
        """Send a command; queues its answer, or None if there is no answer within `wait_s`."""
        done: list[bool] = []

        def conclude(result: Result | None) -> None:
            if not done:
                done.append(True)
                self.hear(CommandAnswered(command.id, result))

        def take(replies: list[bytes]) -> None:
            for raw in replies:
                result = self._decoded(command.vehicle, raw, decode_result)
                if isinstance(result, Result) and result.id == command.id:
                    conclude(result)

        payload = encode(command)
        for link in self.bus.links_of(command.vehicle):
            asked = Asked(Ask.COMMAND, self._once(command.vehicle, take), payload)
            self.bus.post(link.vehicle, lambda link=link, asked=asked: link.hear(asked))
        self.bus.later(wait_s, lambda: conclude(None))

    def tell_winds(self, winds: SharedWinds) -> None:
        """Tell a vehicle the winds that others feel."""
        raw = encode(winds)
        for link in self.bus.links_of(winds.vehicle):
            self.bus.post(winds.vehicle, lambda link=link: link.hear_winds(raw))

    def neighbour_keys(self, fleet: str) -> Mapping[str, str]:
        """No identities here."""
        return {}

    def _decoded(self, vehicle: str, raw: bytes, decode: Callable[[bytes], Any]) -> Any:
        message = decode(raw)
        if isinstance(message, Refused):
            self.hear(MessageRejected(vehicle, message.reason))
            return None
        if message.vehicle != vehicle:
            self.hear(MessageRejected(vehicle, f"speaks for {message.vehicle}"))
            return None
        return message

    def close(self) -> None:
        """Leave the network."""
        self.bus.leave_desk(self)
