"""In-process fleet network: desks and members exchange messages on simulated time.

Semantics follow zenoh. States and events go to every desk. Commands and queries go to every session
of a vehicle; each is answered or times out. Every desk receives a member's liveliness. A message
takes `DELAY_S` and is dropped with probability `loss`. Liveliness is never dropped, because zenoh
maintains it itself. The same generator gives the same losses.
"""

import heapq
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from companion.core.base.desk_heartbeat import DeskHeartbeat
from companion.core.mission.flight_file import NeighbourFleet
from companion.core.separation.track import Track
from companion.core.separation.track_cells import SubscribedCells, cell_name_or_none
from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.messages import (
    Command,
    FleetEvent,
    Refused,
    Result,
    State,
    decode_message,
    encode_message,
)
from companion.fleet.network import MemberRequest, ReceivedTrack, RequestKind
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    EventsReceived,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)

DELAY_S = 0.02
"""Message delay: a few hops in a radio network, shorter than a step of the simulated day."""

LEASE_TIMEOUT_S = 10.0
"""A silent session is dropped after this time: zenoh's lease (transport/link/tx/lease)."""

ReplyCallback = Callable[[list[bytes]], None]


@dataclass(slots=True)
class Bus:
    """The network. `t_s`: time of the day, set by the caller, which calls
    `advance_and_run_due_calls` after each step.
    """

    rng: np.random.Generator
    loss: float = 0.0
    t_s: float = 0.0
    sent: int = 0
    lost: int = 0
    track_delay_s: float = DELAY_S
    distort_track: Callable[[bytes, float], bytes] = lambda raw, t_s: raw
    states: dict[str, State] = field(default_factory=dict)
    """Last published state of each vehicle, delivered or not, for the verdict."""
    fleet: str = "fleet"
    neighbour_buses: list["Bus"] = field(default_factory=list)
    """Networks of other fleets whose vehicles may receive the tracks published here."""
    network_cut_until_s: float = 0.0
    """Until this time no message passes between desks and members."""
    _member_cut_until_s: dict[str, float] = field(default_factory=dict)
    """Until this time no message passes to or from the member."""
    links: list["BusLink"] = field(default_factory=list)
    """Sessions of members."""
    desks: list["BusFleet"] = field(default_factory=list)
    _scheduled_calls: list[tuple[float, int, Callable[[], None]]] = field(default_factory=list)
    _call_numbers: "count[int]" = field(default_factory=count)

    def join(self, vehicle: str, instance_id: str) -> "BusLink":
        """Add a member session and notify every desk of it."""
        link = BusLink(self, vehicle, instance_id)
        for other in self.links_of(vehicle):
            self._notify_duplicate(other, link)
            self._notify_duplicate(link, other)
        self.links.append(link)
        self.publish_liveliness(self.desks, link, up=True)
        return link

    def _notify_duplicate(self, member_link: "BusLink", duplicate: "BusLink") -> None:
        request = MemberRequest(
            RequestKind.DUPLICATE, lambda replies: None, duplicate.instance_id.encode()
        )
        self.schedule_call(DELAY_S, lambda: member_link.requests.append(request))

    def publish_liveliness(self, desks: list["BusFleet"], link: "BusLink", *, up: bool) -> None:
        """Notify desks that a member session has joined or left."""
        liveliness = LivelinessChanged(link.vehicle, link.instance_id, has_joined=up)
        delay_s = max(DELAY_S, self._messages_pass_from_s(link.vehicle) - self.t_s)
        for desk in desks:
            self.schedule_call(delay_s, lambda desk=desk: desk.received.append(liveliness))

    def cut_network(self, duration_s: float) -> None:
        """Drop all messages for `duration_s`. Beyond the lease, members leave and rejoin."""
        self.network_cut_until_s = max(self.network_cut_until_s, self.t_s + duration_s)
        self._schedule_lease_expiry(self.network_cut_until_s, None)

    def cut_member(self, vehicle: str, duration_s: float) -> None:
        """Drop all messages to and from one member for `duration_s`, as if its radio were off."""
        until_s = max(self._messages_pass_from_s(vehicle), self.t_s + duration_s)
        self._member_cut_until_s[vehicle] = until_s
        self._schedule_lease_expiry(until_s, vehicle)

    def _messages_pass_from_s(self, vehicle: str) -> float:
        """Return the time from which messages pass to and from this member."""
        return max(self.network_cut_until_s, self._member_cut_until_s.get(vehicle, 0.0))

    def _schedule_lease_expiry(self, until_s: float, vehicle: str | None) -> None:
        if until_s - self.t_s > LEASE_TIMEOUT_S:
            self.schedule_call(
                LEASE_TIMEOUT_S, lambda: self._queue_liveliness_at_desks(vehicle, up=False)
            )
            self.schedule_call(
                until_s - self.t_s, lambda: self._queue_liveliness_at_desks(vehicle, up=True)
            )

    def _queue_liveliness_at_desks(self, vehicle: str | None, *, up: bool) -> None:
        for desk in self.desks:
            for link in self.links_of(vehicle):
                change = LivelinessChanged(link.vehicle, link.instance_id, has_joined=up)
                desk.received.append(change)

    def add_desk(self) -> "BusFleet":
        """Add a desk and notify it of the members that are alive."""
        desk = BusFleet(self)
        self.desks.append(desk)
        for link in self.links:
            self.publish_liveliness([desk], link, up=True)
        return desk

    def links_of(self, vehicle: str | None = None) -> list["BusLink"]:
        """Return the sessions of one vehicle, or of all vehicles."""
        return [link for link in self.links if vehicle in (None, link.vehicle)]

    def send_with_delay_or_loss(self, member: str, deliver: Callable[[], None]) -> None:
        """Send a message from or to a member; it arrives after `DELAY_S` or is lost."""
        if not self._count_message_and_draw_loss(member):
            self.schedule_call(DELAY_S, deliver)

    def send_track_to_subscribers(self, sender: "BusLink", raw: bytes) -> None:
        """Send a track, with this network's delay and distortion, to every other vehicle that
        subscribes to its cell. The cell is that of the distorted position.
        """
        raw = self.distort_track(raw, self.t_s)
        track = decode_message(Track, raw)
        cell = (
            None if isinstance(track, Refused) else cell_name_or_none(track.lat_deg, track.lon_deg)
        )
        if cell is None:
            return
        for bus in (self, *self.neighbour_buses):
            is_own = bus is self
            received_track = ReceivedTrack(sender.vehicle, cell, raw, "" if is_own else self.fleet)
            for link in bus.links:
                is_other = link.vehicle != sender.vehicle if is_own else self.fleet in link.fleets
                members = (sender.vehicle, link.vehicle) if is_own else (sender.vehicle,)
                if (
                    is_other
                    and cell in link.cells.near_s
                    and not self._count_message_and_draw_loss(*members)
                ):
                    self.schedule_call(
                        self.track_delay_s,
                        lambda link=link, track=received_track: link.tracks.append(track),
                    )

    def _count_message_and_draw_loss(self, *members: str) -> bool:
        self.sent += 1
        if self.t_s < max(map(self._messages_pass_from_s, members)):
            self.lost += 1
            return True
        lost = self.loss > 0.0 and self.rng.random() < self.loss
        self.lost += lost
        return lost

    def schedule_call(self, delay_s: float, callback: Callable[[], None]) -> None:
        """Schedule a call in `delay_s` seconds."""
        heapq.heappush(
            self._scheduled_calls, (self.t_s + delay_s, next(self._call_numbers), callback)
        )

    def advance_and_run_due_calls(self, t_s: float) -> None:
        """Advance time to `t_s` and execute the calls that are due."""
        while self._scheduled_calls and self._scheduled_calls[0][0] <= t_s:
            self.t_s, _, callback = heapq.heappop(self._scheduled_calls)
            callback()
        self.t_s = t_s


@dataclass(slots=True)
class BusLink:
    """Member side (`companion.fleet.network.MemberLink`) of one session (`instance_id`)."""

    bus: Bus
    vehicle: str
    instance_id: str
    state: bytes = b""
    requests: list[MemberRequest] = field(default_factory=list)
    """Received commands and queries; likewise `tracks` and `winds`, until they are drained."""
    tracks: list[ReceivedTrack] = field(default_factory=list)
    winds: list[bytes] = field(default_factory=list)
    cells: SubscribedCells = field(default_factory=SubscribedCells)
    trust: None = None
    fleets: frozenset[str] = frozenset()
    """Neighbouring fleets whose tracks it subscribes to."""

    def drain_requests(self) -> list[MemberRequest]:
        """Return and remove all pending commands and queries."""
        requests, self.requests = self.requests, []
        return requests

    def set_request_callback(self, on_request: Callable[[], None]) -> None:
        """Do nothing: every member is stepped."""

    def publish_state(self, state_bytes: bytes) -> None:
        """Publish the latest state, which also serves later queries."""
        self.state = state_bytes
        state = decode_message(State, state_bytes)
        if isinstance(state, State):
            self.bus.states[self.vehicle] = state
        for desk in self.bus.desks:
            self.bus.send_with_delay_or_loss(
                self.vehicle,
                lambda desk=desk: desk.decode_and_queue_state(self.vehicle, state_bytes),
            )

    def publish_event(self, event_bytes: bytes) -> None:
        """Publish an event to every desk."""
        for desk in self.bus.desks:
            self.bus.send_with_delay_or_loss(
                self.vehicle, lambda desk=desk: desk.on_event(self.vehicle, event_bytes)
            )

    def publish_track(self, track_bytes: bytes, cell: str) -> None:
        """Send this member's track to its neighbours."""
        self.bus.send_track_to_subscribers(self, track_bytes)

    def subscribe_near(self, lat_deg: float, lon_deg: float) -> None:
        """Subscribe to the track cells about this position."""
        self.cells = self.cells.updated_for_position(lat_deg, lon_deg, self.bus.t_s)

    def subscribe_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        """Subscribe to the tracks of these neighbouring fleets."""
        self.fleets = frozenset(one.fleet for one in neighbours)

    def drain_tracks(self) -> list[ReceivedTrack]:
        """Return and remove the tracks received since the last call."""
        tracks, self.tracks = self.tracks, []
        return tracks

    def drain_wind_messages(self) -> list[bytes]:
        """Return and remove the wind reports received from desks since the last call."""
        winds, self.winds = self.winds, []
        return winds

    def do_all_clients_read_wind_cov(self) -> bool:
        """Return True: all desks of a simulated day decode wind covariances."""
        return True

    def close(self) -> None:
        """Leave the network, closed or killed; the liveliness token is dropped."""
        if self in self.bus.links:
            self.bus.links.remove(self)
            self.bus.publish_liveliness(self.bus.desks, self, up=False)


@dataclass(slots=True)
class BusFleet:
    """Desk side (`ground_station.core.fleet.fleet_link.FleetLink`)."""

    bus: Bus
    received: list[FleetInput] = field(default_factory=list)

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Return and remove the inputs received; never waits."""
        received, self.received = self.received, []
        return received

    def decode_and_queue_state(self, vehicle: str, raw: bytes) -> None:
        """Decode and queue a vehicle's state."""
        state = self._decode_or_queue_rejection(vehicle, raw, State)
        if isinstance(state, State):
            self.received.append(StateReceived(state))

    def on_event(self, vehicle: str, raw: bytes) -> None:
        """Decode and queue a vehicle's event."""
        event = self._decode_or_queue_rejection(vehicle, raw, FleetEvent)
        if isinstance(event, FleetEvent):
            self.received.append(EventsReceived(vehicle, [event]))

    def request_states(self, wait_s: float) -> None:
        """Request the latest state of every vehicle."""
        for link in self.bus.links_of():
            self.bus.send_with_delay_or_loss(
                link.vehicle, lambda link=link: self._post_state_reply(link)
            )

    def _post_state_reply(self, link: BusLink) -> None:
        if link.state:
            self.bus.send_with_delay_or_loss(
                link.vehicle, lambda: self.decode_and_queue_state(link.vehicle, link.state)
            )

    def request_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Request a vehicle's stored events after this sequence number."""
        self._request_from_sessions(
            vehicle,
            RequestKind.EVENTS,
            lambda raw: self._queue_replayed_events(vehicle, raw),
            after=after,
        )

    def _request_from_sessions(
        self,
        vehicle: str,
        kind: RequestKind,
        on_replies: ReplyCallback,
        payload: bytes = b"",
        after: int = 0,
    ) -> None:
        """Send a request to every session of a vehicle."""
        for link in self.bus.links_of(vehicle):
            reply = self._single_reply_callback(vehicle, on_replies)
            request = MemberRequest(kind, reply, payload, after)
            self.bus.send_with_delay_or_loss(
                vehicle, lambda link=link, request=request: link.requests.append(request)
            )

    def _single_reply_callback(self, vehicle: str, on_replies: ReplyCallback) -> ReplyCallback:
        """Return a callback that posts its first replies as one message and ignores later calls."""
        replied: list[bool] = []

        def post_reply(replies: list[bytes]) -> None:
            if not replied:
                replied.append(True)
                self.bus.send_with_delay_or_loss(vehicle, lambda: on_replies(replies))

        return post_reply

    def _queue_replayed_events(self, vehicle: str, replies: list[bytes]) -> None:
        events = [self._decode_or_queue_rejection(vehicle, raw, FleetEvent) for raw in replies]
        found = sorted((e for e in events if isinstance(e, FleetEvent)), key=lambda e: e.seq)
        if found:
            self.received.append(EventsReceived(vehicle, found, replayed=True))

    def send(self, command: Command, wait_s: float) -> None:
        """Send a command; queue its result, or None if there is no reply within `wait_s`."""
        done: list[bool] = []

        def queue_response(result: Result | None) -> None:
            if not done:
                done.append(True)
                self.received.append(CommandResponse(command.id, result))

        def on_replies(replies: list[bytes]) -> None:
            for raw in replies:
                result = self._decode_or_queue_rejection(command.vehicle, raw, Result)
                if isinstance(result, Result) and result.id == command.id:
                    queue_response(result)

        self._request_from_sessions(
            command.vehicle, RequestKind.COMMAND, on_replies, encode_message(command)
        )
        self.bus.schedule_call(wait_s, lambda: queue_response(None))

    def publish(self, message: SharedWinds | DeskHeartbeat) -> None:
        """Send a vehicle the winds measured by others; heartbeats are not simulated."""
        if isinstance(message, SharedWinds):
            name, raw = message.vehicle, encode_message(message)
            for link in self.bus.links_of(name):
                self.bus.send_with_delay_or_loss(name, lambda link=link: link.winds.append(raw))

    def neighbour_keys(self, fleet: str) -> Mapping[str, str]:
        """Return no keys: this network has no identities."""
        return {}

    def _decode_or_queue_rejection(
        self, vehicle: str, raw: bytes, message_type: type[State | FleetEvent | Result]
    ) -> State | FleetEvent | Result | None:
        message = decode_message(message_type, raw)
        if isinstance(message, Refused):
            self.received.append(MessageRejected(vehicle, message.reason))
            return None
        if message.vehicle != vehicle:
            self.received.append(
                MessageRejected(vehicle, f"message names vehicle {message.vehicle}")
            )
            return None
        return message

    def close(self) -> None:
        """Leave the network."""
        if self in self.bus.desks:
            self.bus.desks.remove(self)
