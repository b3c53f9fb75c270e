"""Expiry of the certificates of a fleet."""

from dataclasses import dataclass

from companion.fleet.roster import Roster

DAY_US = 86_400_000_000

MAX_MEMBERS = 1000
"""Maximum number of listed members, the intended size of a fleet per desk."""


@dataclass(frozen=True, slots=True)
class CertificateExpiry:
    """Expiry times: of this program's own certificate (None: not on the roster, or revoked) and of
    the members', soonest first.
    """

    own_expiry_us: int | None
    member_expiries_us: tuple[tuple[str, int], ...]


def days_until_expiry(end_us: int, now_us: int) -> float:
    """Return the days until a certificate expires; negative if it has expired."""
    return (end_us - now_us) / DAY_US


def roster_certificate_expiries(
    roster: Roster, own_name: str, own_end_us: int | None = None
) -> CertificateExpiry:
    """Return the expiry times of a roster without revoked members. `own_end_us`: expiry of the
    certificate in use, if known; the roster may list a newer one that is not installed yet.
    """
    expiries = sorted((m.certificate_end_us, m.name) for m in roster.members if not m.revoked)
    own = next((end for end, name in expiries if name == own_name), None)
    if own is not None and own_end_us is not None:
        own = min(own, own_end_us)
    others = [(name, end) for end, name in expiries if name != own_name]
    return CertificateExpiry(own, tuple(others[:MAX_MEMBERS]))
