"""Whom a member believes: it signs what it says, and checks what it hears against the roster.

A member expires so that nothing is cut in flight: who has expired may begin nothing (no command but
a recall is taken of it, and network certificates end by themselves at the next joining), but what
it tells of a flight is heard to the end. Who is revoked is not heard at all.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import NeighbourFleet
from companion.fleet.envelope import Envelope, put_in_envelope, read_envelope
from companion.fleet.messages import Recall, Refused, decode_command
from companion.fleet.roles import COMMANDS, LISTENS, SPEAKS, TELLS_WIND, Role
from companion.fleet.roster import (
    WARN_DAYS,
    Roster,
    RosterMember,
    SignedRoster,
    decode_signed_roster,
    roster_of,
)
from companion.fleet.signature import is_signed, public_key_of, sign

ROSTER_KIND = "roster"
DAY_S = 86_400.0


@dataclass(frozen=True, slots=True)
class SignedCommand:
    """A command's bytes that were checked, and the member who signed them."""

    raw: bytes
    signer: str


@dataclass(slots=True)
class Trust:
    """One member's view of its fleet. `authorities`: the public keys that may sign rosters.

    `keep` puts a newer roster on the disk. `read_end_us` looks at our own certificate as it lies
    on the disk now, and says when that ends (None: there is none). The roster alone does not say:
    it names the end of a renewed certificate before that has been carried to us.
    """

    name: str
    private: bytes
    authorities: frozenset[str]
    signed: SignedRoster
    roster: Roster
    epoch_us: Callable[[], int]
    keep: Callable[[SignedRoster], None]
    read_end_us: Callable[[], int | None] = lambda: None
    own_end_us: int | None = field(init=False)

    def __post_init__(self) -> None:
        self.own_end_us = self.read_end_us()

    @property
    def fleet(self) -> str:
        """The fleet's name."""
        return self.roster.fleet

    @property
    def me(self) -> RosterMember | None:
        """This member as the roster lists it; None: it does not."""
        return self.roster.by_name.get(self.name)

    # --- out -----------------------------------------------------------------------------------

    def seal(self, kind: str, raw: bytes) -> bytes:
        """A message of ours in its envelope."""
        signature = sign(self.private, kind=kind, fleet=self.fleet, signer=self.name, raw=raw)
        return put_in_envelope(self.name, signature, raw)

    # --- in ------------------------------------------------------------------------------------

    def told(
        self, kind: str, raw: bytes, speaker: str | None, roles: frozenset[Role] = SPEAKS
    ) -> bytes | Refused:
        """The message that `speaker` itself signed: a vehicle or truck, or who has `roles`."""
        found = self._checked(kind, raw)
        if isinstance(found, Refused):
            return found
        envelope, member = found
        if envelope.signer != speaker:
            return Refused(f"{kind}: signed by {envelope.signer}")
        if member.role not in roles:
            return Refused(f"{kind}: {speaker} is a {member.role.value}")
        return envelope.message

    def commanded(self, raw: bytes) -> SignedCommand | Refused:
        """The command that somebody signed who may command."""
        found = self._checked("command", raw)
        if isinstance(found, Refused):
            return found
        envelope, member = found
        if member.role not in COMMANDS:
            return Refused(f"command: a {member.role.value} may not command ({member.name})")
        command = decode_command(envelope.message)
        if isinstance(command, Refused):
            return command
        if self.is_over(member) and not isinstance(command.deed, Recall):
            return Refused(f"command: {member.name}'s certificate has expired")
        return SignedCommand(envelope.message, member.name)

    def told_winds(self, raw: bytes) -> bytes | Refused:
        """The winds of others that a desk signed. Who has expired is not asked any more: one's own
        wind is there.
        """
        found = self._checked("winds", raw)
        if isinstance(found, Refused):
            return found
        envelope, member = found
        if member.role not in TELLS_WIND:
            return Refused(f"winds: a {member.role.value} may not tell them ({member.name})")
        if self.is_over(member):
            return Refused(f"winds: {member.name}'s certificate has expired")
        return envelope.message

    def _checked(self, kind: str, raw: bytes) -> tuple[Envelope, RosterMember] | Refused:
        envelope = read_envelope(kind, raw)
        if isinstance(envelope, Refused):
            return envelope
        member = self.roster.by_name.get(envelope.signer)
        if member is None:
            return Refused(f"{kind}: signed by {envelope.signer}, who is not on the roster")
        if member.revoked:
            return Refused(f"{kind}: {envelope.signer} is revoked")
        if not self._is_of(member.key, kind, envelope.signer, envelope.signature, envelope.message):
            return Refused(f"{kind}: not the signature of {envelope.signer}")
        return envelope, member

    def _is_of(self, key: str, kind: str, signer: str, signature: bytes, raw: bytes) -> bool:
        return is_signed(key, signature, kind=kind, fleet=self.fleet, signer=signer, raw=raw)

    # --- time ----------------------------------------------------------------------------------

    def is_over(self, member: RosterMember) -> bool:
        """Its certificate has ended by our clock. A clock that stands at 1970 finds none ended."""
        return self.epoch_us() > member.not_after_us

    @property
    def end_us(self) -> int | None:
        """When we can join no more: the roster's end or our certificate's, which comes first.
        None: the roster does not list us.
        """
        return None if self.me is None else self._end_us(self.me)

    def _end_us(self, me: RosterMember) -> int:
        return min(me.not_after_us, self.own_end_us or me.not_after_us)

    def look_if_near(self) -> None:
        """Look at our certificate where its end is near: a newer one may have been carried here."""
        if self.me is not None and self._left_s(self.me) <= WARN_DAYS * DAY_S:
            self.look_at_certificate()

    def look_at_certificate(self) -> None:
        """Take up a certificate that was carried here; the old one counts while it is not whole.

        It is read at each joining, but by who is called by the others when its session opens.
        """
        if not self._is_called:
            self.show_certificate()

    def show_certificate(self) -> None:
        """From now on the one that lies here is shown to callers; not whole, the one before."""
        with contextlib.suppress(LeewayError):
            self.own_end_us = self.read_end_us() or self.own_end_us

    @property
    def _is_called(self) -> bool:
        return self.me is not None and self.me.role in LISTENS and bool(self.me.address)

    def _left_s(self, me: RosterMember) -> float:
        return (self._end_us(me) - self.epoch_us()) / 1e6

    def _remedy(self, me: RosterMember) -> str:
        """What a person does about an end that is near."""
        if self._end_us(me) < me.not_after_us:
            return f"renewed until {me.not_after:%Y-%m-%d}: carry tls.pem to {self.name}"
        return "ground-station pki renew"

    def _trouble(self, me: RosterMember | None) -> str:
        """Why nobody believes anything of ours; empty: they do."""
        if me is None or me.revoked:
            return f"{self.name} is {'revoked' if me else 'not on the roster'}"
        if me.key != public_key_of(self.private):
            return f"the signing key is not the one of {self.name} on the roster"
        return ""

    def warning(self) -> str:
        """What a person should do about our own certificate, looked at now; empty: nothing."""
        me = self.me
        if me is None or self._trouble(me):
            return self._trouble(me)
        self.look_if_near()
        days = self._left_s(me) / DAY_S
        if days > WARN_DAYS:
            return ""
        return f"certificate of {self.name}: {days:.0f} days left ({self._remedy(me)})"

    def trouble_until(self, seconds: float) -> str:
        """Why nothing may begin that takes so long: our certificate would end meanwhile."""
        me = self.me
        if me is None or self._trouble(me):
            return self._trouble(me)
        if self._left_s(me) < seconds:
            self.look_at_certificate()
        left_s = self._left_s(me)
        if left_s >= seconds:
            return ""
        return (
            f"the certificate of {self.name} ends in {max(left_s, 0.0) / 60.0:.0f} min,"
            f" expected at least {seconds / 60.0:.0f} min more ({self._remedy(me)})"
        )

    def command_trouble(self) -> str:
        """Why nobody would take a command of ours; empty: they would."""
        me = self.me
        if me is None or self._trouble(me):
            return self._trouble(me)
        if me.role not in COMMANDS:
            return f"{self.name} is a {me.role.value}: may not command"
        return f"the certificate of {self.name} has expired" if self.is_over(me) else ""

    # --- rosters -------------------------------------------------------------------------------

    @property
    def roster_bytes(self) -> bytes:
        """The roster in force, as it is passed on."""
        return msgspec.json.encode(self.signed)

    def take_roster(self, raw: bytes) -> Roster | Refused | None:
        """Put a newer roster in force and on the disk; None where it is not newer."""
        if raw == self.roster_bytes:
            return None
        found = checked_roster(raw, self.authorities)
        if isinstance(found, Refused):
            return found
        signed, roster = found
        if roster.fleet != self.fleet:
            return Refused(f"roster: of fleet {roster.fleet}")
        if roster.number <= self.roster.number:
            return None
        self.signed, self.roster = signed, roster
        self.look_at_certificate()
        self.keep(signed)
        return roster


def told_by_neighbour(neighbour: NeighbourFleet, raw: bytes, speaker: str) -> bytes | Refused:
    """The track that this vehicle of a neighbouring fleet signed itself, as one of that fleet.

    The key is the one that the desk named with the flight. Nothing else of theirs is believed: no
    other kind of message comes here, and a signature is of one kind and one fleet.
    """
    envelope = read_envelope("track", raw)
    if isinstance(envelope, Refused):
        return envelope
    if envelope.signer != speaker:
        return Refused(f"track: signed by {envelope.signer}")
    key = neighbour.keys.get(speaker)
    if key is None:
        return Refused(f"track: no vehicle of {neighbour.fleet} that the desk named")
    signed = is_signed(
        key,
        envelope.signature,
        kind="track",
        fleet=neighbour.fleet,
        signer=speaker,
        raw=envelope.message,
    )
    return envelope.message if signed else Refused(f"track: not the signature of {speaker}")


def checked_roster(
    raw: bytes, authorities: frozenset[str]
) -> tuple[SignedRoster, Roster] | Refused:
    """A roster that at least one of these authorities signed."""
    found = decode_signed_roster(raw)
    if isinstance(found, Refused):
        return found
    signed, fleet = found
    if not any(is_roster_signed(signed, fleet, key) for key in authorities):
        return Refused("roster: not signed by an authority of this fleet")
    roster = roster_of(signed, fleet)
    return roster if isinstance(roster, Refused) else (signed, roster)


def is_roster_signed(signed: SignedRoster, fleet: str, authority: str) -> bool:
    """Tell whether this authority signed it."""
    signature = signed.signatures.get(authority)
    if signature is None:
        return False
    raw = signed.roster.encode()
    return is_signed(
        authority,
        bytes.fromhex(signature),
        kind=ROSTER_KIND,
        fleet=fleet,
        signer=ROSTER_KIND,
        raw=raw,
    )
