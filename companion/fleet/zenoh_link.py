"""A fleet member's zenoh link: requests are queued per sender, messages are sent by one thread.

The flight never waits for zenoh. The session opens in the background, with retries. If messages
cannot be sent, the oldest are dropped: states are repeated, and events are stored (`event_log`)
until they are requested.
"""

import contextlib
import math
import os
import queue
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NoReturn

import zenoh

from companion.adapters.clock import wall_s
from companion.core.base.rate_limit import RateLimit
from companion.core.mission.flight_file import NeighbourFleet
from companion.fleet.neighbour_tracks import MAX_TRACKED_NEIGHBOURS, TrackReceiver
from companion.fleet.network import (
    STATE_REQUEST_MAX_INTERVAL_S,
    WIND_COV,
    MemberRequest,
    ReceivedTrack,
    RequestKind,
)
from companion.fleet.request_queue import PUBLISHED_ROSTERS, RequestQueues
from companion.fleet.topics import VehicleKeys, desk_key, vehicle_and_instance_from_key
from companion.fleet.zenoh_config import config_mode
from companion.fleet.zenoh_session import (
    RosterReceiver,
    SessionThread,
    is_connected,
    wrap_as_direct_callback,
)

WRITER_POLL_S = 5.0
"""Interval at which an idle writer thread checks for a due roster request, missing requests and
changed subscriptions. A companion's states are sent each second.
"""
REJOIN_WITHOUT_REQUEST_S, MAX_REJOIN_WITHOUT_REQUEST_S = 150.0, 2400.0
"""A desk sends requests once a minute. A connected member without one for so long was missed: it
joins again, with increasing intervals, since there may be a router and no desk.
"""

EVENT_REQUESTS_HZ, EVENT_REQUESTS_BURST = 10.0, 40.0
"""Limits of event requests: desks, maps and monitors send them at start and after gaps."""

MAX_OUTGOING = 4096
MAX_WINDS = 4
"""Maximum stored wind messages: one arrives every 10 s, and signatures are verified later."""

AFTER_PARAMETER = "after"
Send = Callable[[zenoh.Session], Any]
"""Action of the writer thread, in its session."""


class MemberQueries:
    """Queries to a member: commands and event requests are queued for it, state requests get the
    newest state from here.

    zenoh's threads call the handlers concurrently. `_limit_lock` guards the rate limit; the other
    attributes are replaced in one assignment each. Replies are sent by the writer thread.
    """

    def __init__(
        self, keys: VehicleKeys, requests: RequestQueues, enqueue_send: Callable[[Send], None]
    ) -> None:
        self._keys = keys
        self._requests = requests
        self._enqueue_send = enqueue_send
        self._event_request_limit = RateLimit(EVENT_REQUESTS_HZ, EVENT_REQUESTS_BURST)
        self._limit_lock = threading.Lock()
        self._cov_reader_request_s, self._non_cov_reader_request_s = -math.inf, -math.inf
        self.state_bytes = b""
        self.last_request_s = 0.0

    def declare_in(self, session: zenoh.Session) -> list[Any]:
        """Declare the queryables; they end when the returned declarations are dropped."""
        return [
            session.declare_queryable(key, wrap_as_direct_callback(handler))
            for key, handler in (
                (self._keys.command_key, self._queue_command_request),
                (self._keys.event_key, self._queue_events_request_within_limit),
                (self._keys.state_key, self._reply_with_newest_state),
            )
        ]

    def do_all_clients_read_wind_cov(self) -> bool:
        """Return True if all recent state requests read the wind covariance."""
        since_s = wall_s() - STATE_REQUEST_MAX_INTERVAL_S
        return self._cov_reader_request_s >= since_s > self._non_cov_reader_request_s

    def _queue_command_request(self, query: zenoh.Query) -> None:
        self.last_request_s = wall_s()
        payload = query.payload.to_bytes() if query.payload is not None else b""
        reply = partial(self._queue_replies, query, self._keys.command_key)
        self._requests.add_request_and_call_back(MemberRequest(RequestKind.COMMAND, reply, payload))

    def _queue_events_request_within_limit(self, query: zenoh.Query) -> None:
        self.last_request_s = wall_s()
        with self._limit_lock:
            is_within_limit = self._event_request_limit.try_consume_tokens(self.last_request_s)
        reply = partial(self._queue_replies, query, self._keys.event_key)
        if not is_within_limit:
            reply([])
            return
        after = query.parameters.get(AFTER_PARAMETER) or "0"
        after_seq = int(after) if after.isdecimal() else 0
        self._requests.add_request_and_call_back(
            MemberRequest(RequestKind.EVENTS, reply, after_seq=after_seq)
        )

    def _reply_with_newest_state(self, query: zenoh.Query) -> None:
        self.last_request_s = wall_s()
        if query.parameters.get(WIND_COV) is None:
            self._non_cov_reader_request_s = self.last_request_s
        else:
            self._cov_reader_request_s = self.last_request_s
        replies = [self.state_bytes] if self.state_bytes else []
        self._queue_replies(query, self._keys.state_key, replies)

    def _queue_replies(self, query: zenoh.Query, key: str, replies: list[bytes]) -> None:
        def send(session: zenoh.Session) -> None:
            for raw in replies:
                query.reply(key, raw)
            query.drop()

        self._enqueue_send(send)


class ZenohLink:
    """The link of one companion instance. zenoh's threads call `on_request` when a request arrives.

    `is_member`: True for senders whose tracks are stored. `roster_number`: of the roster in force.
    `unverified_sender`: returns the claimed sender of a command if it may command, else empty.
    The writer thread runs the session, and sends everything.
    """

    trust = None

    def __init__(
        self,
        config: zenoh.Config,
        keys: VehicleKeys,
        instance_id: str,
        on_request: Callable[[], None],
        is_member: Callable[[str], bool] = lambda name: True,
        unverified_sender: Callable[[bytes], str] | None = None,
        roster_number: Callable[[], int] = lambda: 0,
    ) -> None:
        self._is_client = config_mode(config) == "client"
        self._keys = keys
        self._instance_id = instance_id
        self._roster_number = roster_number
        self._outgoing: queue.Queue[Send] = queue.Queue(MAX_OUTGOING)
        # the writer thread drops the last reference to a dropped request
        self.request_queues = RequestQueues(
            on_request,
            unverified_sender,
            lambda request: self._enqueue_send_dropping_oldest(lambda session, held=request: None),
        )
        self._queries = MemberQueries(keys, self.request_queues, self._enqueue_send_dropping_oldest)
        self._tracks = TrackReceiver(keys, is_member)
        self._winds: deque[bytes] = deque(maxlen=MAX_WINDS)  # its methods are thread-safe
        self._declarations: list[Any] = []
        self._rejoin_s = REJOIN_WITHOUT_REQUEST_S
        self.session_thread = SessionThread(
            "zenoh-writer", config, self._run_session_until_stop_or_rejoin
        )
        self.session_thread.error_text = "not open yet"
        self.session_thread.start()

    # --- in ------------------------------------------------------------------------------------

    def drain_requests(self) -> list[MemberRequest]:
        """Return and remove all pending requests."""
        return self.request_queues.drain_in_arrival_order()

    def set_request_callback(self, on_request: Callable[[], None]) -> None:
        """Set the function that is called when a request arrives."""
        self.request_queues.on_request = on_request

    def _queue_duplicate_instance_notice(self, sample: zenoh.Sample) -> None:
        seen = vehicle_and_instance_from_key(str(sample.key_expr))
        if (
            sample.kind == zenoh.SampleKind.PUT
            and seen is not None
            and seen[1] != self._instance_id
        ):
            self.request_queues.add_request_and_call_back(
                MemberRequest(RequestKind.DUPLICATE, lambda replies: None, seen[1].encode())
            )

    def drain_tracks(self) -> list[ReceivedTrack]:
        """Return the newest tracks of each neighbour since the last call; oldest first for each."""
        return self._tracks.drain_tracks()

    def do_all_clients_read_wind_cov(self) -> bool:
        """Return True if all recent state requests read the wind covariance."""
        return self._queries.do_all_clients_read_wind_cov()

    def drain_wind_messages(self) -> list[bytes]:
        """Return the newest wind messages since the last call, oldest first."""
        return [self._winds.popleft() for _ in range(len(self._winds))]

    def _store_wind_message(self, sample: zenoh.Sample) -> None:
        self._winds.append(sample.payload.to_bytes())

    def _queue_desk_heartbeat(self, sample: zenoh.Sample) -> None:
        self.request_queues.add_request_and_call_back(
            MemberRequest(RequestKind.DESK, lambda replies: None, sample.payload.to_bytes())
        )

    def subscribe_near(self, lat_deg: float, lon_deg: float) -> None:
        """Subscribe to the cells around this position; the writer thread applies it."""
        self._tracks.set_position(lat_deg, lon_deg)

    def subscribe_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        """Subscribe to these fleets' tracks; the own fleet is ignored."""
        self._tracks.set_neighbour_fleets(neighbours)

    # --- out -----------------------------------------------------------------------------------

    def publish_state(self, state_bytes: bytes) -> None:
        """Publish the newest state, which later state requests also receive."""
        self._queries.state_bytes = state_bytes
        self._enqueue_put(self._keys.state_key, state_bytes)

    def publish_event(self, event_bytes: bytes) -> None:
        """Publish an event to its subscribers."""
        self._enqueue_put(self._keys.event_key, event_bytes)

    def publish_track(self, track_bytes: bytes, cell: str) -> None:
        """Publish the position to subscribers of this cell; dropped if the queue is long, so that
        it never delays more important messages.
        """
        if self._outgoing.qsize() < MAX_TRACKED_NEIGHBOURS:
            self._enqueue_put(self._keys.track_key(cell), track_bytes)

    def _enqueue_put(self, key: str, raw: bytes) -> None:
        self._enqueue_send_dropping_oldest(lambda session: session.put(key, raw, express=True))

    def _enqueue_send_dropping_oldest(self, send: Send) -> None:
        while True:
            try:
                return self._outgoing.put_nowait(send)
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self._outgoing.get_nowait()

    def close(self) -> None:
        """Send what is queued, then leave; the token ends with the session."""
        self.session_thread.stop.set()
        self._enqueue_send_dropping_oldest(lambda session: None)  # ends the writer thread's wait
        self.session_thread.close()

    # --- the thread ----------------------------------------------------------------------------

    def _run_session_until_stop_or_rejoin(self, session: zenoh.Session) -> None:
        """Run until stopped, or until a connected session gets no request for too long."""
        start_s = self._queries.last_request_s = wall_s()
        rosters = self._declare_in(session)
        self._tracks.begin_session(session)
        self.session_thread.error_text = ""
        while not (self.session_thread.stop.is_set() and self._outgoing.empty()):
            if (
                self._is_client
                and wall_s() - self._queries.last_request_s > self._rejoin_s
                and is_connected(session)
            ):
                self.session_thread.error_text = (
                    f"no request for {self._rejoin_s:.0f} s: joining again"
                )
                break
            if self.request_queues.pop_dropped_count(PUBLISHED_ROSTERS) > 0:
                rosters.is_request_needed = True  # one of them may be valid
            rosters.request_if_due(wall_s())
            try:
                send = self._outgoing.get(timeout=WRITER_POLL_S)
            except queue.Empty:
                send = None
            self._send_or_record_error(
                lambda session: self._tracks.update_subscriptions(wall_s()), session
            )
            if send is not None:
                self._send_or_record_error(send, session)
        has_requests = self._queries.last_request_s > start_s
        self._rejoin_s = (
            REJOIN_WITHOUT_REQUEST_S
            if has_requests
            else min(2.0 * self._rejoin_s, MAX_REJOIN_WITHOUT_REQUEST_S)
        )

    def _declare_in(self, session: zenoh.Session) -> RosterReceiver:
        """Declare everything, the token last: who sees it may send requests."""
        keys, liveliness = self._keys, session.liveliness()
        rosters = RosterReceiver(
            session,
            keys.fleet,
            self._roster_number,
            lambda raw, is_requested: self.request_queues.add_roster_and_call_back(
                raw, is_requested=is_requested
            ),
            is_direct=True,
        )
        self._declarations = [  # zenoh undeclares a declaration that is not referenced
            *self._queries.declare_in(session),
            liveliness.declare_subscriber(
                keys.alive_key(),
                wrap_as_direct_callback(self._queue_duplicate_instance_notice),
                history=True,
            ),
            session.declare_subscriber(
                keys.wind_key, wrap_as_direct_callback(self._store_wind_message)
            ),
            session.declare_subscriber(
                desk_key(keys.fleet, "*"), wrap_as_direct_callback(self._queue_desk_heartbeat)
            ),
            liveliness.declare_token(keys.alive_key(self._instance_id)),
        ]
        return rosters

    def _send_or_record_error(self, send: Send, session: zenoh.Session) -> None:
        try:
            send(session)
        except zenoh.ZError as error:
            self.session_thread.error_text = str(error)


def flush_and_exit_process_immediately(exit_status: int) -> NoReturn:
    """End a process that used zenoh, after all resources are closed.

    Threads of zenoh's runtime may still acquire Python's lock to drop a callback; during
    interpreter shutdown this aborts the process ("FATAL: exception not rethrown", in one of twenty
    exits), and systemd would treat a clean stop as a crash.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(exit_status)
