"""Pending requests of a member: a bounded queue per sender; a flood affects only its own.

zenoh's threads add, the member's thread removes. The claimed sender of a command is read from its
envelope, in microseconds; its signature is verified when it is removed. So a flood in one sender's
name displaces that sender's requests only.
"""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.adapters.clock import wall_s
from companion.core.base.rate_limit import RateLimit
from companion.fleet.network import MemberRequest, RequestKind

MAX_REQUESTS = {
    RequestKind.COMMAND: 256,
    RequestKind.EVENTS: 8,
    RequestKind.DUPLICATE: 1,
    RequestKind.ROSTER: 4,
    RequestKind.DESK: 4,
    RequestKind.TEXT: 1,
}
"""Maximum of each kind; commands of a fleet without a roster."""

MAX_COMMANDS_PER_SENDER = 16
"""Maximum per sender: a desk sends a vehicle a few commands at once. A dropped command is sent
again a second later.
"""

PUBLISHED_ROSTERS = "published rosters"
CALLBACKS_HZ, CALLBACKS_BURST = 50.0, 50.0
"""Limits of callbacks to the flight's loop; further requests wait for its next cycle."""


@dataclass(slots=True)
class RequestQueues:
    """Thread-safe by its lock, which `on_request` and `release` are called without.

    `on_request` is called when a request arrives, within a limit. `unverified_sender` returns the
    claimed sender of a command if it may command, else empty. `release` takes each dropped request.
    `put_count`: number of requests added, including dropped ones.
    """

    on_request: Callable[[], None] = lambda: None
    unverified_sender: Callable[[bytes], str] | None = None
    release: Callable[[MemberRequest], None] = lambda request: None
    _lock: threading.Lock = field(default_factory=threading.Lock)
    queues: dict[str, deque[tuple[int, MemberRequest]]] = field(default_factory=dict)
    _dropped_counts: dict[str, int] = field(default_factory=dict)
    put_count: int = 0
    _callback_limit: RateLimit = field(
        default_factory=lambda: RateLimit(CALLBACKS_HZ, CALLBACKS_BURST)
    )

    def add_request_and_call_back(self, request: MemberRequest) -> None:
        """Add a request to the queue of its kind, and of its claimed sender if it is a command."""
        if request.kind is RequestKind.COMMAND and self.unverified_sender is not None:
            queue_name = f"commands {self.unverified_sender(request.payload)}"
            self.add_to_queue_and_call_back(queue_name, request, MAX_COMMANDS_PER_SENDER)
        else:
            self.add_to_queue_and_call_back(request.kind.value, request, MAX_REQUESTS[request.kind])

    def add_roster_and_call_back(self, raw: bytes, *, is_requested: bool) -> None:
        """Add a roster. Published rosters cannot displace a requested one."""
        request = MemberRequest(RequestKind.ROSTER, lambda replies: None, raw)
        self.add_to_queue_and_call_back(
            "requested rosters" if is_requested else PUBLISHED_ROSTERS,
            request,
            MAX_REQUESTS[RequestKind.ROSTER],
            keep_first=is_requested,
        )

    def add_to_queue_and_call_back(
        self, queue_name: str, request: MemberRequest, max_size: int, *, keep_first: bool = False
    ) -> None:
        """Add a request to this queue of limited size, dropping the oldest, or with `keep_first`
        this one. The dropped request gets no reply, so it is sent again.
        """
        dropped_request: MemberRequest | None = None
        with self._lock:
            self.put_count += 1
            queue = self.queues.setdefault(queue_name, deque())
            queue.append((self.put_count, request))
            if len(queue) > max_size:
                _, dropped_request = queue.pop() if keep_first else queue.popleft()
                self._dropped_counts[queue_name] = self._dropped_counts.get(queue_name, 0) + 1
            is_callback_within_limit = self._callback_limit.try_consume_tokens(wall_s())
        if dropped_request is not None:
            self.release(dropped_request)
        if is_callback_within_limit:
            self.on_request()

    def drain_in_arrival_order(self) -> list[MemberRequest]:
        """Return and remove all requests, in order of arrival."""
        with self._lock:
            queues, self.queues = self.queues, {}
        numbered = [one for queue_name in queues.values() for one in queue_name]
        return [request for _, request in sorted(numbered, key=lambda one: one[0])]

    def pop_dropped_count(self, queue_name: str) -> int:
        """Return the number of requests dropped from this queue since the last call."""
        with self._lock:
            return self._dropped_counts.pop(queue_name, 0)
