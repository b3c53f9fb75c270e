"""Expiry times of a fleet's certificates."""

from datetime import UTC, datetime

from companion.fleet.roles import Role
from companion.fleet.roster import Roster, RosterMember
from ground_station.core.fleet.certificate_ends import roster_certificate_expiries

END = datetime(2027, 3, 1, tzinfo=UTC)


def test_certificates_end_soonest_first_and_the_revoked_have_none():
    def of(name: str, day: int, *, revoked: bool = False) -> RosterMember:
        return RosterMember(
            name=name, role=Role.VEHICLE, key="0" * 64, not_after=END.replace(day=day),
            revoked=revoked,
        )  # fmt: skip

    members = [of("d1", 20), of("desk", 7), of("d2", 3), of("d3", 1, revoked=True)]
    figures = roster_certificate_expiries(
        Roster(fleet="harbour", number=1, members=members), "desk"
    )
    day_us = 86_400_000_000
    first_us = round(END.timestamp() * 1e6)
    assert figures.own_expiry_us == first_us + 6 * day_us
    assert figures.member_expiries_us == (
        ("d2", first_us + 2 * day_us),
        ("d1", first_us + 19 * day_us),
    )
    roster = Roster(fleet="harbour", number=1, members=members)
    assert roster_certificate_expiries(roster, "d3").own_expiry_us is None
    assert (
        roster_certificate_expiries(roster, "desk", first_us).own_expiry_us == first_us
    )  # renewed, not installed
    assert roster_certificate_expiries(roster, "desk", first_us + 30 * day_us) == figures
