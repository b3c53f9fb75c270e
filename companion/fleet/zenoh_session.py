"""Zenoh sessions on their own thread, reopened after errors, and declarations in them: changing
subscriptions, and the reception of the fleet's rosters.

A new roster is published whole. When a member joins, only the number is published, and a member
with a lower number requests the roster: for a thousand members it has 184 kB.
"""

import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import zenoh
from zenoh.handlers import Callback

from companion.adapters.clock import is_due, wall_s
from companion.core.base.errors import LeewayError
from companion.fleet.topics import roster_key
from companion.fleet.zenoh_config import config_mode

ZenohMessage = TypeVar("ZenohMessage", zenoh.Query, zenoh.Sample, zenoh.Reply)
REOPEN_S = 5.0
RETRY_S, REPORT_INTERVAL_S = 1.0, 30.0
ABOVE_PARAMETER = "above"
"""Parameter of a roster request: the number in force; only members with a newer one reply."""

NUMBER_DIGITS = 15
REQUEST_INTERVAL_S = 10.0
"""Minimum interval between requests."""

ROSTER_TIMEOUT_S = 5.0
"""Same as a desk's response timeout. After a timeout, the next published roster is received."""


class SessionThread:
    """Opens sessions until it is closed. `run_session` runs each on this thread, until `stop` is
    set or the next session shall be opened.
    """

    def __init__(
        self, name: str, config: zenoh.Config, run_session: Callable[[zenoh.Session], None]
    ) -> None:
        self.stop = threading.Event()
        self.error_text = ""
        self._config = config
        self._run_session = run_session
        self._thread = threading.Thread(
            target=self._run_sessions_until_stopped, name=name, daemon=True
        )

    def start(self) -> None:
        """Start the thread. `run_session` may use this object, so its owner stores it first."""
        self._thread.start()

    def close(self) -> None:
        """Stop, and wait until the session is closed."""
        self.stop.set()
        self._thread.join(timeout=5.0)

    def _run_sessions_until_stopped(self) -> None:
        while not self.stop.is_set():
            try:
                with zenoh.open(self._config) as session:
                    self._run_session(session)
            except zenoh.ZError as error:
                self.error_text = str(error)
                self.stop.wait(REOPEN_S)


class KeySubscriptions:
    """Subscriptions of one session to a changing set of keys. Used by the session's thread only."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._subscriptions: dict[str, zenoh.Subscriber[None]] = {}

    def update_keys(
        self, handlers: "Mapping[str, Callback[zenoh.Sample] | Callable[[zenoh.Sample], None]]"
    ) -> None:
        """Subscribe to new keys first, in this order, then unsubscribe from the others."""
        for key, handler in handlers.items():
            if key not in self._subscriptions:
                self._subscriptions[key] = self._session.declare_subscriber(key, handler)
        for removed in self._subscriptions.keys() - handlers.keys():
            self._subscriptions.pop(removed).undeclare()


class RosterReceiver:
    """Receives rosters in one session. `on_roster` takes a roster's bytes and True if they are the
    reply to a request; with `is_direct` it runs on zenoh's threads (`wrap_as_direct_callback`).

    Without a lock: `is_request_needed` is set by any thread, and cleared by the session's thread
    before it sends a request, so that a later announcement causes another one.
    """

    def __init__(
        self,
        session: zenoh.Session,
        fleet: str,
        roster_number: Callable[[], int],
        on_roster: Callable[[bytes, bool], None],
        *,
        is_direct: bool = False,
    ) -> None:
        """`roster_number` returns the number of the roster in force."""
        self.key = roster_key(fleet)
        self.is_request_needed = True
        self._session = session
        self._roster_number = roster_number
        self._on_roster = on_roster
        self._is_indirect = not is_direct
        self._requested_s: float | None = None
        self._subscriber = session.declare_subscriber(
            self.key, Callback(self._handle_published_roster_or_number, indirect=self._is_indirect)
        )

    def request_if_due(self, now_s: float) -> None:
        """Request a newer roster from all members, so that a forged reply displaces no other."""
        if not self.is_request_needed or not is_due(self._requested_s, REQUEST_INTERVAL_S, now_s):
            return
        self._requested_s, self.is_request_needed = now_s, False
        self._session.get(
            f"{self.key}?{ABOVE_PARAMETER}={self._roster_number()}",
            Callback(self._handle_requested_roster, indirect=self._is_indirect),
            timeout=ROSTER_TIMEOUT_S,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )

    def _handle_requested_roster(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._on_roster(reply.ok.payload.to_bytes(), True)

    def _handle_published_roster_or_number(self, sample: zenoh.Sample) -> None:
        raw = sample.payload.to_bytes()
        if (number := roster_number_or_none(raw)) is None:
            self._on_roster(raw, False)
        elif number > self._roster_number():
            self.is_request_needed = True


def roster_number_or_none(raw: bytes) -> int | None:
    """Return a roster's number if the message holds only its digits; None otherwise."""
    return int(raw) if raw.isdigit() and len(raw) <= NUMBER_DIGITS else None


def open_session(config: zenoh.Config, source: Path | None) -> zenoh.Session:
    """Open a session. A client waits for its router, with a message on stderr.

    Raises LeewayError, naming the configuration's file, if a router or peer cannot listen.
    """
    reported_s: float | None = None
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            text = f"{source or 'zenoh'}: {error}"
            if config_mode(config) != "client":
                raise LeewayError(text) from error
        if reported_s is None or wall_s() - reported_s >= REPORT_INTERVAL_S:
            reported_s = wall_s()
            print(f"router not reached, trying again: {text}", file=sys.stderr, flush=True)
        threading.Event().wait(RETRY_S)


def wrap_as_direct_callback(handler: Callable[[ZenohMessage], None]) -> "Callback[ZenohMessage]":
    """Wrap a handler to run directly on zenoh's threads, concurrently: no thread per declaration,
    and unprocessed messages wait at the sender. `handler` only queues and sends nothing: dropping
    the last reference to a query sends a message, which the session's thread must do.
    """
    return Callback(handler, indirect=False)


def is_connected(session: zenoh.Session) -> bool:
    """Return True if the session is connected to any router or peer."""
    return bool(session.info.routers_zid() or session.info.peers_zid())
