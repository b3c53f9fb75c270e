"""Message authentication of a member: signs its messages, verifies received ones by the roster.

Expiry never interrupts a flight: an expired member may start nothing (only its recall commands are
accepted, and its network certificate is invalid at the next connection), but its reports of a
running flight are accepted. A revoked member's messages are all rejected.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import NeighbourFleet
from companion.fleet.envelope import (
    Envelope,
    decode_envelope,
    encode_envelope,
    is_signature_valid,
    public_key_hex_of,
    sign_message,
)
from companion.fleet.messages import Command, CommandAction, Recall, Refused, decode_message
from companion.fleet.roles import COMMANDERS, SERVERS, STATE_PUBLISHERS, WIND_PUBLISHERS, Role
from companion.fleet.roster import (
    WARN_DAYS,
    Roster,
    RosterDifference,
    RosterMember,
    SignedRoster,
    decode_signed_roster_and_fleet_name,
    parse_verified_roster,
    roster_difference,
    roster_stamp_of,
)

ROSTER_KIND = "roster"
MEMBER_SEPARATOR = " by way of "
"""In `Command.by`: the claimed name, then the member that signed."""

DAY_S = 86_400.0


@dataclass(frozen=True, slots=True)
class SignedCommand:
    """A command's verified bytes, and the member that signed them."""

    raw: bytes
    signer: str


@dataclass(slots=True)
class CertificateValidity:
    """Validity of certificates by the local clock. `read_own_end_us` reads the end of this member's
    certificate on disk (None: no certificate).

    The roster does not suffice for this member: it lists a renewed certificate before that is
    installed. `entry` is this member's roster entry.
    """

    epoch_us: Callable[[], int]
    read_own_end_us: Callable[[], int | None]
    own_end_us: int | None = field(init=False)

    def __post_init__(self) -> None:
        self.own_end_us = self.read_own_end_us()

    def is_expired(self, member: RosterMember) -> bool:
        """Return True if its certificate has expired (False while the clock is unset, in 1970)."""
        return self.epoch_us() > member.certificate_end_us

    def membership_end_us(self, entry: RosterMember) -> int:
        """Return the earlier of the roster's and the certificate's end."""
        return min(entry.certificate_end_us, self.own_end_us or entry.certificate_end_us)

    def remaining_membership_s(self, entry: RosterMember) -> float:
        """Return the time until the membership ends."""
        return (self.membership_end_us(entry) - self.epoch_us()) / 1e6

    def renewal_instruction(self, entry: RosterMember) -> str:
        """Return the operator's remedy for a near end."""
        if self.membership_end_us(entry) < entry.certificate_end_us:
            return f"renewed until {entry.not_after:%Y-%m-%d}: copy tls.pem to {entry.name}"
        return "ground-station pki renew"

    def reload_own_end_if_near(self, entry: RosterMember) -> None:
        """Read the certificate again if its end is near: a renewed one may have been installed."""
        if self.remaining_membership_s(entry) <= WARN_DAYS * DAY_S:
            self.reload_own_end_unless_server(entry)

    def reload_own_end_unless_server(self, entry: RosterMember | None) -> None:
        """Read a newly installed certificate.

        Clients read the certificate at each connection, servers once when the session opens.
        """
        if entry is None or entry.role not in SERVERS or not entry.address:
            self.reload_own_end_if_complete()

    def reload_own_end_if_complete(self) -> None:
        """Use the installed certificate's end, or keep the old end if it is incomplete."""
        with contextlib.suppress(LeewayError):
            self.own_end_us = self.read_own_end_us() or self.own_end_us


@dataclass(slots=True)
class MemberTrust:
    """One member's roster and keys. `authority_keys`: the public keys that may sign rosters.

    `store_roster` stores a newer roster.
    """

    name: str
    private_key: bytes
    authority_keys: frozenset[str]
    signed_roster: SignedRoster
    roster: Roster
    store_roster: Callable[[SignedRoster], None]
    validity: CertificateValidity
    roster_alarm: str = ""
    """A roster of an authority that was refused as a fork or a rollback; empty: none."""
    _stamp: tuple[SignedRoster, str] | None = None

    @property
    def roster_stamp(self) -> str:
        """Number and hash of the roster in force, as in `State.roster`."""
        if self._stamp is None or self._stamp[0] is not self.signed_roster:
            stamp = roster_stamp_of(self.roster.number, self.signed_roster)
            self._stamp = (self.signed_roster, stamp)
        return self._stamp[1]

    @property
    def fleet(self) -> str:
        """The fleet's name."""
        return self.roster.fleet

    @property
    def own_roster_entry(self) -> RosterMember | None:
        """This member's roster entry; None if it is not listed."""
        return self.roster.member_by_name.get(self.name)

    # --- out -----------------------------------------------------------------------------------

    def sign_in_envelope(self, kind: str, message_bytes: bytes) -> bytes:
        """Put an own message in a signed envelope."""
        signature = sign_message(
            self.private_key, kind=kind, fleet=self.fleet, signer=self.name, raw=message_bytes
        )
        return encode_envelope(self.name, signature, message_bytes)

    # --- in ------------------------------------------------------------------------------------

    def verify_message_of_signer(
        self,
        kind: str,
        raw: bytes,
        expected_signer: str | None,
        permitted_roles: frozenset[Role] = STATE_PUBLISHERS,
    ) -> bytes | Refused:
        """Verify a message signed by `expected_signer`, who must have one of `permitted_roles`."""
        result = self._verify_envelope_and_find_member(kind, raw)
        if isinstance(result, Refused):
            return result
        envelope, member = result
        if envelope.signer != expected_signer:
            return Refused(f"{kind}: signed by {envelope.signer}")
        if member.role not in permitted_roles:
            return Refused(f"{kind}: {expected_signer} is a {member.role.value}")
        return envelope.message

    def verify_command(self, raw: bytes) -> SignedCommand | Refused:
        """Verify a command: its signer must have a role with this permission."""
        result = self._verify_envelope_and_find_member("command", raw)
        if isinstance(result, Refused):
            return result
        envelope, member = result
        if error := self._role_error_or_empty(member):
            return Refused(f"command: {error}")
        command = decode_message(Command, envelope.message)
        if isinstance(command, Refused):
            return command
        error = self.authority_error_or_empty(command.action, command.by, member.name)
        return (
            Refused(f"command: {error}") if error else SignedCommand(envelope.message, member.name)
        )

    def authority_error_or_empty(self, action: CommandAction, author: str, signer: str = "") -> str:
        """Return why the roster in force does not permit an action; empty: it does.

        Called when the action is executed: a roster may have arrived since it was requested.
        `author` is `Command.by` (`ben by way of anna`): its members are checked. `signer`: the
        verified sender; empty: the author's last name is the one that an identity proved.
        """
        names = [name.removeprefix("desk/") for name in author.split(MEMBER_SEPARATOR)]
        proven = signer or names[-1]
        for name in (proven, *names):
            member = self.roster.member_by_name.get(name)
            if member is None:
                if name == proven:
                    return f"{name} is not on roster {self.roster.number}"
                continue
            error = member.revocation_text if member.revoked else self._role_error_or_empty(member)
            if error:
                return error
            if self.validity.is_expired(member) and not isinstance(action, Recall):
                return f"{name}'s certificate has expired"
        return ""

    @staticmethod
    def _role_error_or_empty(member: RosterMember) -> str:
        if member.role in COMMANDERS:
            return ""
        return f"a {member.role.value} may not command ({member.name})"

    def verify_message_of_desk(self, kind: str, raw: bytes) -> bytes | Refused:
        """Verify winds or a heartbeat signed by a desk. An expired desk is rejected."""
        result = self._verify_envelope_and_find_member(kind, raw)
        if isinstance(result, Refused):
            return result
        envelope, member = result
        if member.role not in WIND_PUBLISHERS:
            return Refused(f"{kind}: a {member.role.value} may not publish them ({member.name})")
        if self.validity.is_expired(member):
            return Refused(f"{kind}: {member.name}'s certificate has expired")
        return envelope.message

    def _verify_envelope_and_find_member(
        self, kind: str, raw: bytes
    ) -> tuple[Envelope, RosterMember] | Refused:
        envelope = decode_envelope(kind, raw)
        if isinstance(envelope, Refused):
            return envelope
        member = self.roster.member_by_name.get(envelope.signer)
        if member is None:
            return Refused(f"{kind}: signed by {envelope.signer}, not on the roster")
        if member.revoked:
            return Refused(f"{kind}: {member.revocation_text}")
        if not is_signature_valid(
            member.key,
            envelope.signature,
            kind=kind,
            fleet=self.fleet,
            signer=envelope.signer,
            raw=envelope.message,
        ):
            return Refused(f"{kind}: not the signature of {envelope.signer}")
        return envelope, member

    # --- this member ---------------------------------------------------------------------------

    def read_membership_end_us(self) -> int | None:
        """Return the earlier of the roster's and the certificate's end; None: not on the roster."""
        me = self.own_roster_entry
        if me is None:
            return None
        self.validity.reload_own_end_if_near(me)
        return self.validity.membership_end_us(me)

    def _own_entry_accepted_by_others(self) -> RosterMember | Refused:
        """Return this member's roster entry, or the reason why others reject its messages."""
        me = self.own_roster_entry
        if me is None or me.revoked:
            return Refused(me.revocation_text if me else f"{self.name} is not on the roster")
        if me.key != public_key_hex_of(self.private_key):
            return Refused(f"the signing key is not the one of {self.name} on the roster")
        return me

    def certificate_warning_or_empty(self) -> str:
        """Return the operator's warning about this member's certificate; empty: none."""
        me = self._own_entry_accepted_by_others()
        if isinstance(me, Refused):
            return me.reason
        self.validity.reload_own_end_if_near(me)
        days = self.validity.remaining_membership_s(me) / DAY_S
        if days > WARN_DAYS:
            return ""
        remedy = self.validity.renewal_instruction(me)
        return f"certificate of {self.name}: {days:.0f} days left ({remedy})"

    def certificate_error_within(self, duration_s: float) -> str:
        """Return the reason against an action that outlasts the certificate; empty: none."""
        me = self._own_entry_accepted_by_others()
        if isinstance(me, Refused):
            return me.reason
        if self.validity.remaining_membership_s(me) < duration_s:
            self.validity.reload_own_end_unless_server(me)
        remaining_s = self.validity.remaining_membership_s(me)
        if remaining_s >= duration_s:
            return ""
        return (
            f"the certificate of {self.name} ends in {max(remaining_s, 0.0) / 60.0:.0f} min,"
            f" expected at least {duration_s / 60.0:.0f} min more"
            f" ({self.validity.renewal_instruction(me)})"
        )

    def command_permission_error_or_empty(self) -> str:
        """Return why this member's commands would be rejected; empty: they are accepted."""
        me = self._own_entry_accepted_by_others()
        if isinstance(me, Refused):
            return me.reason
        if me.role not in COMMANDERS:
            return f"{self.name} is a {me.role.value}: may not command"
        return f"the certificate of {self.name} has expired" if self.validity.is_expired(me) else ""

    # --- rosters -------------------------------------------------------------------------------

    @property
    def encoded_signed_roster(self) -> bytes:
        """The roster in force, encoded for other members."""
        return msgspec.json.encode(self.signed_roster)

    def store_roster_if_newer(
        self, raw: bytes, *, may_be_older: bool = False
    ) -> Roster | Refused | None:
        """Store a newer roster and put it in force; return None if it is the one in force.

        A roster of an authority with a lower number (rollback), or with this number and another
        content (fork), is refused and sets `roster_alarm`.
        """
        if raw == self.encoded_signed_roster:
            return None
        result = verify_roster(raw, self.authority_keys)
        if isinstance(result, Refused):
            return result
        signed, roster = result
        if roster.fleet != self.fleet:
            return Refused(f"roster: of fleet {roster.fleet}")
        difference = roster_difference(roster_stamp_of(roster.number, signed), self.roster_stamp)
        is_harmless = may_be_older and difference is RosterDifference.ROLLBACK
        if difference is RosterDifference.NONE or is_harmless:
            return None
        if difference is not RosterDifference.NEWER:
            self.roster_alarm = (
                f"roster {roster_stamp_of(roster.number, signed)} refused: {difference.value} of"
                f" {self.roster_stamp} in force; was the PKI restored from a backup?"
            )
            return Refused(self.roster_alarm)
        self.signed_roster, self.roster, self.roster_alarm = signed, roster, ""
        self.validity.reload_own_end_unless_server(self.own_roster_entry)
        self.store_roster(signed)
        return roster


def verify_neighbour_track(
    neighbour: NeighbourFleet, raw: bytes, expected_signer: str
) -> bytes | Refused:
    """Verify a track signed by a vehicle of a neighbouring fleet.

    The key is the one that the desk sent with the flight. Other message kinds of neighbours are
    never accepted, since a signature is valid for one kind and one fleet.
    """
    envelope = decode_envelope("track", raw)
    if isinstance(envelope, Refused):
        return envelope
    if envelope.signer != expected_signer:
        return Refused(f"track: signed by {envelope.signer}")
    key = neighbour.keys.get(expected_signer)
    if key is None:
        return Refused(f"track: no key from the desk for this vehicle of {neighbour.fleet}")
    signed = is_signature_valid(
        key,
        envelope.signature,
        kind="track",
        fleet=neighbour.fleet,
        signer=expected_signer,
        raw=envelope.message,
    )
    return envelope.message if signed else Refused(f"track: not the signature of {expected_signer}")


def verify_roster(
    raw: bytes, authority_keys: frozenset[str]
) -> tuple[SignedRoster, Roster] | Refused:
    """Decode and verify a roster signed by at least one of these authorities."""
    result = decode_signed_roster_and_fleet_name(raw)
    if isinstance(result, Refused):
        return result
    signed, fleet = result
    if not any(is_roster_signed_by_authority(signed, fleet, key) for key in authority_keys):
        return Refused("roster: not signed by an authority of this fleet")
    roster = parse_verified_roster(signed, fleet)
    return roster if isinstance(roster, Refused) else (signed, roster)


def is_roster_signed_by_authority(signed: SignedRoster, fleet: str, authority_key: str) -> bool:
    """Return True if this authority signed the roster."""
    signature = signed.signatures.get(authority_key)
    if signature is None:
        return False
    raw = signed.roster.encode()
    return is_signature_valid(
        authority_key,
        bytes.fromhex(signature),
        kind=ROSTER_KIND,
        fleet=fleet,
        signer=ROSTER_KIND,
        raw=raw,
    )
