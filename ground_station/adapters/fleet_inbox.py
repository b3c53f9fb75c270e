"""Received fleet messages of the desk: a bounded box per member, so that none displaces another.

zenoh's threads only append bytes; the desk's thread decodes them. Only the latest state of each
instance counts. Its signature is checked when it is decoded, so several are kept and forged
states do not displace the genuine one. Events are limited in rate, size and number per cycle;
dropped events are requested again, since each state contains the event count. Command responses
have their own queue. Senders that are not members get no box. A cycle visits only boxes with new
messages.
"""

import threading
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from companion.core.base.rate_limit import RateLimit
from companion.core.base.safe_text import MAX_NAME_LENGTH, safe_text
from companion.fleet.envelope import MAX_OVERHEAD_BYTES
from companion.fleet.messages import (
    MAX_MESSAGE_BYTES,
    FleetEvent,
    Refused,
    Result,
    State,
    decode_message,
)
from companion.fleet.topics import reporter_from_key, vehicle_from_key
from ground_station.adapters.clock import monotonic_s
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    EventsReceived,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)
from ground_station.core.fleet.reports import newest_valid_report
from ground_station.core.fleet.uptime_watch import UptimeWatch

EVENTS_HZ = 20.0
"""A flight sends about 50 events in 20 minutes, and several at once when it ends."""

EVENTS_BURST = 200
EVENTS_PER_CYCLE = 50
"""Per member. A transaction with 50 events of each of 100 members takes about a second."""

STATES_PER_CYCLE = 64
"""Per member. A member sends one per second; more are forged, and each costs a signature check (0.1
ms). This number is checked without waiting for more: 8 ms of work.
"""

SIGNED_STATES_HZ, SIGNED_STATES_BURST = 20.0, 200.0
"""Limits of verification per member, counted after the check of the signature: a name in a key is a
claim, so a stranger's forgeries never use up a member's budget. Beyond it only the newest state of
a cycle is verified: the member itself has signed the surplus, or a router repeats it, which could
withhold it anyway. Its own later states are the newest, so its news still arrives.
"""

REQUESTED_STATES_PER_CYCLE = 8
"""States of one member that arrived as replies to this desk's query. A member replies once, and
unsolicited states cannot displace the reply.
"""

BATCH_DELAY_S = 0.05
"""States and events within this time are processed together: 50 at a time for a thousand vehicles.
Command responses and liveliness changes are not delayed.
"""

MAX_INSTANCES = 16
"""Maximum concurrent instances per name. Two are already a fault; a flood gets no more room."""

MAX_MEMBERS = 5000
"""Maximum number of member names: five times the design size of one desk."""

MAX_REPORTERS = 64
"""Wind stations and desks whose latest reports are kept between two cycles."""

REPORTS_PER_CYCLE = 8
"""Per station or desk. Each reports at most once per second; more reports are forged."""

NOT_ON_ROSTER = "sender is not on the roster"

MAX_REPORT_BYTES = MAX_MESSAGE_BYTES["station"] + MAX_OVERHEAD_BYTES
REPORT_REJECTIONS = {"station": "wind stations", "desk": "desks"}
"""Names under which rejected reports are reported."""

VerifyMessage = Callable[[str, bytes, str], bytes | Refused]
Clock = Callable[[], float]

_ReceivedPayload = tuple[str, bytes]
"""Member name, and a payload received under its key."""


_MESSAGE_TYPES = {"state": State, "event": FleetEvent}


@dataclass(slots=True)
class MemberBox:
    """Messages received under one member's keys, from the member or in its name."""

    events: deque[bytes] = field(default_factory=lambda: deque(maxlen=EVENTS_BURST))
    event_limit: RateLimit = field(default_factory=lambda: RateLimit(EVENTS_HZ, EVENTS_BURST))
    states: deque[bytes] = field(default_factory=lambda: deque(maxlen=STATES_PER_CYCLE))
    requested_states: list[bytes] = field(default_factory=list)
    signed_limit: RateLimit = field(
        default_factory=lambda: RateLimit(SIGNED_STATES_HZ, SIGNED_STATES_BURST)
    )
    instances: set[str] = field(default_factory=set)
    reported_instances: set[str] = field(default_factory=set)
    departed_instances: set[str] = field(default_factory=set)
    """Instances that left since the last liveliness query; late replies may name them."""
    rejected: Counter[str] = field(default_factory=Counter)
    uptimes: UptimeWatch = field(default_factory=UptimeWatch)

    def count_rejection(self, reason: str) -> None:
        """Count a rejected message; only the first few reasons are counted separately."""
        self.rejected[reason if reason in self.rejected or len(self.rejected) < 8 else "other"] += 1

    def record_instance_presence(self, instance_id: str, *, has_joined: bool) -> None:
        """Record that an instance appeared (`has_joined`) or left, for at most `MAX_INSTANCES`
        instances.
        """
        if (
            has_joined
            and instance_id not in self.instances
            and len(self.instances) >= MAX_INSTANCES
        ):
            self.count_rejection(f"more than {MAX_INSTANCES} instances of one name")
        elif has_joined:
            self.instances.add(instance_id)
        elif instance_id in self.instances:
            self.instances.discard(instance_id)
            if len(self.departed_instances) < MAX_INSTANCES:
                self.departed_instances.add(instance_id)

    def add_state(self, raw: bytes, *, is_query_reply: bool) -> None:
        """Keep the latest unsolicited states, and the first states that were requested."""
        if not is_query_reply:
            self.states.append(raw)
        elif len(self.requested_states) < REQUESTED_STATES_PER_CYCLE:
            self.requested_states.append(raw)

    def pop_states(self) -> list[bytes]:
        """Remove and return all queued states."""
        found = [*self.states, *self.requested_states]
        self.states.clear()
        self.requested_states.clear()
        return found


_Boxes = dict[str, MemberBox]
"""Boxes by member name."""


class FleetInbox:
    """Thread-safe. Only `wait_and_pop_inputs` waits, for the first message."""

    def __init__(
        self,
        verify: VerifyMessage = lambda kind, raw, vehicle: raw,
        clock_s: Clock = monotonic_s,
        is_member: Callable[[str], bool] = lambda vehicle: True,
    ) -> None:
        """`verify(kind, raw, vehicle)` returns the message if the vehicle itself has signed it.
        `is_member` decides which senders get a box.
        """
        self._verify = verify
        self._clock_s = clock_s
        self._is_member = is_member
        self._condition = threading.Condition()
        self._boxes: _Boxes = {"": MemberBox()}
        self._pending_boxes: _Boxes = {}
        self._responses: deque[CommandResponse] = deque()
        self._replays: deque[tuple[str, list[bytes]]] = deque()
        self._reports: dict[tuple[str, str], deque[bytes]] = {}
        self._has_input = False
        self._is_urgent = False

    # --- input, from any thread ----------------------------------------------------------------

    def add_state(self, key: str, raw: bytes, *, is_query_reply: bool = False) -> None:
        """Add a state received under this key; `is_query_reply`: as reply to this desk's query."""
        with self._condition:
            box = self._box_for_message_or_reject(key, raw, "state")
            if box is not None:
                box.add_state(raw, is_query_reply=is_query_reply)
            self._mark_input_and_wake_receiver(
                is_urgent=box is not None and len(box.states) == STATES_PER_CYCLE
            )

    def add_report(self, kind: str, key: str, raw: bytes) -> None:
        """Add a wind station's report or a desk's heartbeat (`kind`) received under this key."""
        name = reporter_from_key(kind, key)
        with self._condition:
            is_one = name is not None and self._is_member(name)
            if name is None or not is_one or len(raw) > MAX_REPORT_BYTES:
                self._pending_boxes[""] = self._boxes[""]
                self._boxes[""].count_rejection(f"not a {kind}'s report")
            elif (kind, name) in self._reports or len(self._reports) < MAX_REPORTERS:
                box = self._reports.setdefault((kind, name), deque(maxlen=REPORTS_PER_CYCLE))
                box.append(raw)
            self._mark_input_and_wake_receiver()

    def add_event(self, key: str, raw: bytes) -> None:
        """Add an event received under this key."""
        with self._condition:
            box = self._box_for_message_or_reject(key, raw, "event")
            if box is not None and box.event_limit.try_consume_tokens(self._clock_s()):
                box.events.append(raw)
            elif box is not None:
                box.count_rejection(
                    f"more than {EVENTS_HZ:g} events per second: requested again later"
                )
            self._mark_input_and_wake_receiver()

    def add_events_of_query_reply(self, vehicle: str, event_payloads: list[bytes]) -> None:
        """Add all events that a member sent in reply to an event query."""
        with self._condition:
            self._replays.append((vehicle, event_payloads))
            self._mark_input_and_wake_receiver()

    def add_command_response(self, command_id: str, result: Result | None) -> None:
        """Add the response to a command of this desk, or `None` after a time-out."""
        with self._condition:
            self._responses.append(CommandResponse(command_id, result))
            self._mark_input_and_wake_receiver(is_urgent=True)

    def record_instance_presence(self, vehicle: str, instance_id: str, *, has_joined: bool) -> None:
        """Record that an instance of a member appeared (`has_joined`) or left."""
        with self._condition:
            box = self._get_or_create_pending_member_box(vehicle)
            if box is not None:
                box.record_instance_presence(instance_id, has_joined=has_joined)
                self._mark_input_and_wake_receiver(is_urgent=True)

    def clear_departed_before_liveliness_query(self) -> None:
        """Start a liveliness query; its replies arrive through `add_liveliness_reply`."""
        with self._condition:
            for box in self._boxes.values():
                box.departed_instances.clear()

    def add_liveliness_reply(self, vehicle: str, instance_id: str) -> None:
        """Add a liveliness reply: the instance is present, unless it has left in the meantime."""
        with self._condition:
            box = self._boxes.get(vehicle)
            known = box is not None and (
                instance_id in box.instances or instance_id in box.departed_instances
            )
        if not known:
            self.record_instance_presence(vehicle, instance_id, has_joined=True)

    def count_rejection(self, vehicle: str | None, reason: str) -> None:
        """Count a received message that is not a valid message of a member."""
        with self._condition:
            box = self._get_or_create_pending_member_box(vehicle or "", is_local=True)
            if box is not None:
                box.count_rejection(reason)
            self._mark_input_and_wake_receiver()

    def _box_for_message_or_reject(self, key: str, raw: bytes, kind: str) -> MemberBox | None:
        """Return the box for a message received under this key; `None` if it is rejected."""
        vehicle = vehicle_from_key(key)
        box = self._get_or_create_pending_member_box(vehicle or "")
        if box is None:
            return None
        if vehicle is None:
            box.count_rejection(f"{safe_text(key)[:MAX_NAME_LENGTH]}: key names no member")
            return None
        if len(raw) > MAX_MESSAGE_BYTES[kind] + MAX_OVERHEAD_BYTES:
            box.count_rejection(
                f"{kind}: {len(raw)} bytes, expected at most {MAX_MESSAGE_BYTES[kind]}"
            )
            return None
        return box

    def _get_or_create_pending_member_box(
        self, vehicle: str, *, is_local: bool = False
    ) -> MemberBox | None:
        """Return the box of a member; `None`: there is no room for it. Messages under a key of no
        member are counted in one common box.
        """
        if vehicle not in self._boxes:
            if not (is_local or self._is_member(vehicle)):
                self._pending_boxes[""] = self._boxes[""]
                self._boxes[""].count_rejection(NOT_ON_ROSTER)
                return None
            if len(self._boxes) > MAX_MEMBERS:
                return None
            self._boxes[vehicle] = MemberBox()
        box = self._pending_boxes[vehicle] = self._boxes[vehicle]
        return box

    def _mark_input_and_wake_receiver(self, *, is_urgent: bool = False) -> None:
        wakes = not self._has_input or (is_urgent and not self._is_urgent)
        self._has_input = True
        self._is_urgent = self._is_urgent or is_urgent
        if wakes:
            self._condition.notify()

    # --- output, in the desk's thread ----------------------------------------------------------

    def wait_and_pop_inputs(self, max_wait_s: float) -> list[FleetInput]:
        """Return received inputs, at most one cycle's share per member; waits for the first.

        Order: liveliness, then events, then command responses (a vehicle sends events before it
        responds), then the states that count the events.
        """
        with self._condition:
            if self._condition.wait_for(lambda: self._has_input, timeout=max_wait_s):
                self._condition.wait_for(lambda: self._is_urgent, timeout=BATCH_DELAY_S)
            self._has_input = self._is_urgent = False
            pending, self._pending_boxes = self._pending_boxes, {}
            found = self._pop_liveliness_changes(pending)
            responses, self._responses = self._responses, deque()
            replays, self._replays = self._replays, deque()
            events, states = self._pop_events_and_states(pending)
            reports, self._reports = self._reports, {}
        for vehicle, raws in replays:
            decoded = [self._verify_and_decode_or_reject(vehicle, "event", raw) for raw in raws]
            known = sorted((e for e in decoded if isinstance(e, FleetEvent)), key=lambda e: e.seq)
            found += [EventsReceived(vehicle, known, replayed=True)] if known else []
        for vehicle, raw in events:
            event = self._verify_and_decode_or_reject(vehicle, "event", raw)
            if isinstance(event, FleetEvent):
                found.append(EventsReceived(vehicle, [event]))
        found += responses
        for vehicle, raws in states:
            found += self._decode_newest_state_inputs(vehicle, raws)
        for (kind, name), raws in reports.items():
            reject = partial(self.count_rejection, REPORT_REJECTIONS[kind])
            verified = [self._verify(kind, raw, name) for raw in raws]
            newest = newest_valid_report(kind, name, verified, reject)
            found += [] if newest is None else [newest]
        return found + self._pop_rejection_inputs(pending)

    def _decode_newest_state_inputs(self, vehicle: str, raws: list[bytes]) -> list[FleetInput]:
        """Return the latest state of each instance, by its own clock, if newer than before."""
        newest: dict[str, State] = {}
        limit, now_s = self._boxes[vehicle].signed_limit, self._clock_s()
        is_within_budget = limit.try_consume_tokens(now_s, 0.0)
        for raw in raws if is_within_budget else raws[-1:]:
            state = self._verify_and_decode_or_reject(vehicle, "state", raw)
            if not isinstance(state, State):
                continue
            limit.consume_tokens_beyond_limit(now_s, 1.0 if is_within_budget else 0.0)
            before = newest.pop(state.instance_id, state)
            newest[state.instance_id] = before if before.uptime_s > state.uptime_s else state
        uptimes = self._boxes[vehicle].uptimes
        return [StateReceived(state) for state in newest.values() if uptimes.advances(state)]

    def _pop_liveliness_changes(self, pending_boxes: _Boxes) -> list[FleetInput]:
        """Return the instances that appeared or left since the last call."""
        found: list[FleetInput] = []
        for vehicle, box in pending_boxes.items():
            changed = box.instances ^ box.reported_instances
            found += [
                LivelinessChanged(vehicle, x, has_joined=x in box.instances)
                for x in sorted(changed)
            ]
            box.reported_instances = set(box.instances)
        return found

    def _pop_events_and_states(
        self, pending_boxes: _Boxes
    ) -> tuple[list[_ReceivedPayload], list[tuple[str, list[bytes]]]]:
        """Return (events, states), at most one cycle's share per member; the rest stays queued."""
        events: list[_ReceivedPayload] = []
        states: list[tuple[str, list[bytes]]] = []
        for vehicle, box in pending_boxes.items():
            count = min(len(box.events), EVENTS_PER_CYCLE)
            events += [(vehicle, box.events.popleft()) for _ in range(count)]
            if box.events:
                self._has_input, self._pending_boxes[vehicle] = True, box
            if raws := box.pop_states():
                states.append((vehicle, raws))
        return events, states

    def _pop_rejection_inputs(self, pending_boxes: _Boxes) -> list[FleetInput]:
        """Return rejections, including those of the messages decoded in this cycle."""
        found: list[FleetInput] = []
        with self._condition:
            for vehicle, box in (pending_boxes | self._pending_boxes).items():
                counted, box.rejected = box.rejected, Counter()
                found += [MessageRejected(vehicle, reason, n) for reason, n in counted.items()]
        return found

    def _verify_and_decode_or_reject(
        self, vehicle: str, message_kind: str, raw: bytes
    ) -> State | FleetEvent | None:
        """Decode a message of the vehicle whose key it has; any other message is rejected."""
        verified = self._verify(message_kind, raw, vehicle)
        message = decode_message(_MESSAGE_TYPES[message_kind], verified)
        if isinstance(message, Refused):
            self.count_rejection(vehicle, message.reason)
            return None
        if message.vehicle != vehicle:
            self.count_rejection(vehicle, f"sent a message of {message.vehicle}")
            return None
        return message
