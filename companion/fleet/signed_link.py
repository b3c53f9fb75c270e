"""A member's link with signatures: messages are sent in signed envelopes, and only messages that
the roster permits are received. Transparent to the member.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from companion.adapters.clock import is_due
from companion.core.base.rate_limit import RateLimit
from companion.core.mission.flight_file import NeighbourFleet
from companion.core.separation.track import Track
from companion.core.separation.track_cells import cell_name_or_none
from companion.fleet.envelope import decode_envelope
from companion.fleet.messages import (
    CommandStatus,
    Refused,
    Result,
    decode_message,
    encode_message,
)
from companion.fleet.network import MemberLink, MemberRequest, ReceivedTrack, RequestKind
from companion.fleet.roles import COMMANDERS
from companion.fleet.trust import DAY_S, MemberTrust, verify_neighbour_track

REJECTED_HZ, REJECTED_BURST = 250.0, 500.0
"""Limits of verification of rejected messages, per claimed sender: a check costs 0.1 ms, a reply as
much. Beyond them all messages of that sender are dropped; the limit for unknown senders leaves the
flight's loop time for the others.
"""

ROSTER_LIMIT_KEY = "an authority"
"""Limit key for rosters; no member has this name."""

EVENT_REPLY_HZ, EVENT_REPLY_BURST = 400.0, 4000.0
"""Limits of repeated events: signing one takes 0.1 ms, and any client may request all. Twice what a
member stores, for clients that connect at the same time.
"""

REPORT_INTERVAL_S = 60.0
MAX_COUNTERS = 50
"""Maximum number of distinct reasons: a forger can create any number of them."""


@dataclass(slots=True)
class RejectionCounter:
    """Counts rejections by reason; `pop_report_if_due` returns and clears them as one line."""

    total: int = 0
    _counts: Counter[str] = field(default_factory=Counter)
    _last_report_s: float | None = None

    def count_rejection(self, reason: str) -> None:
        """Count one rejection."""
        self.total += 1
        known = reason in self._counts or len(self._counts) < MAX_COUNTERS
        self._counts[reason if known else "other reasons"] += 1

    def pop_report_if_due(self, now_s: float) -> str | None:
        """Return the line to report now; None: nothing, or reported less than a minute ago."""
        recent = self._last_report_s is not None and now_s - self._last_report_s < REPORT_INTERVAL_S
        if recent or not self._counts:
            return None
        summary = "; ".join(f"{reason} ({n})" for reason, n in self._counts.most_common(3))
        others = len(self._counts) - 3
        more = f"; {others} other reasons" if others > 0 else ""
        self._counts, self._last_report_s = Counter(), now_s
        return f"rejected: {summary}{more}"[:500]


@dataclass(slots=True)
class SignedLink:
    """The signed link of one member instance. It accepts newer rosters as they arrive."""

    link: MemberLink
    trust: MemberTrust
    instance_id: str
    clock_s: Callable[[], float]
    rejections: RejectionCounter = field(default_factory=RejectionCounter)
    _notices: list[str] = field(default_factory=list)
    _warned_s: float | None = None
    _rejected_limits: dict[str, RateLimit] = field(default_factory=dict)
    _event_reply_limit: RateLimit = field(
        default_factory=lambda: RateLimit(EVENT_REPLY_HZ, EVENT_REPLY_BURST)
    )
    _neighbours: dict[str, NeighbourFleet] = field(default_factory=dict)

    # --- in ------------------------------------------------------------------------------------

    def drain_requests(self) -> list[MemberRequest]:
        """Return all pending permitted requests, and texts about the rejected ones."""
        found = [
            permitted
            for item in self.link.drain_requests()
            if (permitted := self._verify_or_wrap_request(item)) is not None
        ]
        now_s = self.clock_s()
        if is_due(self._warned_s, DAY_S, now_s):
            self._add_certificate_warning_notice(now_s)
        report = self.rejections.pop_report_if_due(now_s)
        for text in (*self._notices, *([report] if report is not None else [])):
            found.append(MemberRequest(RequestKind.TEXT, lambda replies: None, text.encode()))
        self._notices.clear()
        return found

    def _verify_or_wrap_request(self, request: MemberRequest) -> MemberRequest | None:
        match request.kind:
            case RequestKind.COMMAND:
                return self._verify_command_or_refuse(request)
            case RequestKind.EVENTS:
                return MemberRequest(
                    request.kind,
                    self._wrap_event_reply_with_signing(request.reply),
                    after_seq=request.after_seq,
                )
            case RequestKind.ROSTER:
                if self._is_verification_within_limit(ROSTER_LIMIT_KEY):
                    self._accept_roster_and_add_notice(request.payload)
                return None
            case RequestKind.DESK:
                verified = self.trust.verify_message_of_desk("desk", request.payload)
                if isinstance(verified, Refused):
                    self.rejections.count_rejection(verified.reason)
                    return None
                return replace(request, payload=verified)
            case _:
                return request

    def _verify_command_or_refuse(self, request: MemberRequest) -> MemberRequest | None:
        name = unverified_commander_name_or_empty(self.trust, request.payload)
        if not self._is_verification_within_limit(name):
            return None

        def reply(replies: list[bytes]) -> None:
            request.reply([self.trust.sign_in_envelope("result", raw) for raw in replies])

        found = self.trust.verify_command(request.payload)
        if isinstance(found, Refused):
            self._count_rejected_message_of_sender(name, found.reason)
            # Without the command's id: with it, an attacker that knows only the id could obtain a
            # signed refusal of a command that the desk really sent.
            refusal = Result(
                id="",
                vehicle=self.trust.name,
                instance_id=self.instance_id,
                status=CommandStatus.REFUSED,
                reason=found.reason,
            )
            reply([encode_message(refusal)])
            return None
        return MemberRequest(RequestKind.COMMAND, reply, found.raw, signer=found.signer)

    def _is_verification_within_limit(self, sender_name: str) -> bool:
        """Return True to verify a message of this sender; False after too many invalid ones."""
        limit = self._rejected_limits.get(sender_name)
        if limit is None or limit.try_consume_tokens(self.clock_s(), 0.0):
            return True
        self.rejections.count_rejection(
            f"too many invalid messages in the name of {sender_name or 'no member'}"
        )
        return False

    def _count_rejected_message_of_sender(self, sender_name: str, reason: str) -> None:
        self.rejections.count_rejection(reason)
        limit = self._rejected_limits.setdefault(
            sender_name, RateLimit(REJECTED_HZ, REJECTED_BURST)
        )
        limit.consume_tokens_beyond_limit(self.clock_s(), 1.0)

    def _accept_roster_and_add_notice(self, raw: bytes) -> None:
        try:
            result = self.trust.store_roster_if_newer(raw)
        except OSError as error:
            self._notices.append(f"roster not stored: {error.strerror}")
            return
        if isinstance(result, Refused):
            self._count_rejected_message_of_sender(ROSTER_LIMIT_KEY, result.reason)
        elif result is not None:
            self._notices.append(f"roster {result.number} is in force")
            self._add_certificate_warning_notice(self.clock_s())

    def _add_certificate_warning_notice(self, now_s: float) -> None:
        """Report a certificate warning: at the start, with each roster, and daily in long runs."""
        self._warned_s = now_s
        warning = self.trust.certificate_warning_or_empty()
        if warning:
            self._notices.append(warning)

    def drain_tracks(self) -> list[ReceivedTrack]:
        """Return the newest validly signed track of each neighbour."""
        found: dict[tuple[str, str], ReceivedTrack] = {}
        for received in reversed(self.link.drain_tracks()):
            sender_key = (received.fleet, received.sender)
            if sender_key in found:
                continue
            verified = self._verify_track(received)
            if isinstance(verified, Refused):
                self.rejections.count_rejection(verified.reason)
            else:
                found[sender_key] = verified
        return list(found.values())

    def _verify_track(self, received: ReceivedTrack) -> ReceivedTrack | Refused:
        """Verify a track. The cell is checked here: a valid track replayed in another cell must not
        hide the one before it.
        """
        neighbour = self._neighbours.get(received.fleet)
        if not received.fleet:
            raw = self.trust.verify_message_of_signer("track", received.raw, received.sender)
        elif neighbour is not None:
            raw = verify_neighbour_track(neighbour, received.raw, received.sender)
        else:
            raw = Refused("track: fleet is no longer a neighbour")
        if isinstance(raw, Refused):
            return Refused(f"{received.sender_display_name}: {raw.reason}")
        decoded = replace(received, raw=raw)
        track = decode_and_match_received_track(decoded)
        return track if isinstance(track, Refused) else decoded

    def subscribe_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        """Subscribe to these fleets' tracks. Fleets without vehicle keys cannot be verified and are
        skipped.
        """
        known = [item for item in neighbours if item.keys]
        if without := [item.fleet for item in neighbours if not item.keys]:
            text = f"no vehicle keys: no separation from {', '.join(without)}"
            self._notices.append(text)
        self._neighbours = {item.fleet: item for item in known}
        self.link.subscribe_fleets(known)

    def subscribe_near(self, lat_deg: float, lon_deg: float) -> None:
        """Subscribe to the cells around this position."""
        self.link.subscribe_near(lat_deg, lon_deg)

    def drain_wind_messages(self) -> list[bytes]:
        """Return the winds of others with a desk's valid signature."""
        found: list[bytes] = []
        for raw in self.link.drain_wind_messages():
            received = self.trust.verify_message_of_desk("winds", raw)
            if isinstance(received, Refused):
                self.rejections.count_rejection(received.reason)
            else:
                found.append(received)
        return found

    def do_all_clients_read_wind_cov(self) -> bool:
        """Return True if all recent state requests read the wind covariance."""
        return self.link.do_all_clients_read_wind_cov()

    def set_request_callback(self, on_request: Callable[[], None]) -> None:
        """Set the function that is called when a request arrives."""
        self.link.set_request_callback(on_request)

    # --- out -----------------------------------------------------------------------------------

    def publish_state(self, state_bytes: bytes) -> None:
        """Publish the newest state."""
        self.link.publish_state(self.trust.sign_in_envelope("state", state_bytes))

    def publish_event(self, event_bytes: bytes) -> None:
        """Publish an event."""
        self.link.publish_event(self.trust.sign_in_envelope("event", event_bytes))

    def publish_track(self, track_bytes: bytes, cell: str) -> None:
        """Publish the position to subscribers of this cell."""
        self.link.publish_track(self.trust.sign_in_envelope("track", track_bytes), cell)

    def _wrap_event_reply_with_signing(
        self, reply: Callable[[list[bytes]], None]
    ) -> Callable[[list[bytes]], None]:
        """Seal the events of a reply; above the limit it has none, and they are requested again."""

        def send_events(replies: list[bytes]) -> None:
            free = self._event_reply_limit.try_consume_tokens(self.clock_s(), len(replies))
            reply([self.trust.sign_in_envelope("event", raw) for raw in replies] if free else [])

        return send_events

    def close(self) -> None:
        """Send what is queued, then leave the network."""
        self.link.close()


def unverified_commander_name_or_empty(trust: MemberTrust, raw: bytes) -> str:
    """Return the claimed sender of a command if it may command; empty otherwise. The signature is
    not verified.
    """
    envelope = decode_envelope("command", raw)
    if isinstance(envelope, Refused):
        return ""
    member = trust.roster.member_by_name.get(envelope.signer)
    is_commander = member is not None and not member.revoked and member.role in COMMANDERS
    return envelope.signer if is_commander else ""


def decode_and_match_received_track(received: ReceivedTrack) -> Track | Refused:
    """Decode a neighbour's track; its vehicle and cell must match the key it was received on."""
    track = decode_message(Track, received.raw)
    if isinstance(track, Refused):
        return track
    if track.vehicle != received.sender:
        return Refused(f"{received.sender_display_name} sent a position of {track.vehicle}")
    if cell_name_or_none(track.lat_deg, track.lon_deg) != received.cell:
        return Refused(f"{received.sender_display_name} sent its position in another cell")
    return track
