"""Who is at the door and should not be: what is said of it, and when."""

from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta

import pytest

from companion.fleet.roles import Role
from companion.fleet.roster import Roster, RosterMember
from ground_station.adapters.zenoh_log import DoorLog, turned_away_by
from ground_station.core.fleet.door import DoorFigures, TurnedAway, Unwelcome, unwelcome_on
from ground_station.core.fleet.door_watch import SAY_AGAIN_S, DoorWatch

NOW = datetime(2026, 5, 1, tzinfo=UTC)
NOW_US = round(NOW.timestamp() * 1e6)


def member(name: str, days: int = 100, *, revoked: bool = False) -> RosterMember:
    end = NOW + timedelta(days=days)
    return RosterMember(name=name, role=Role.VIEWER, key="0" * 64, not_after=end, revoked=revoked)


ROSTER = Roster(
    fleet="harbour",
    number=3,
    members=[member("anna"), member("ben", revoked=True), member("otto", -12), member("pia", -1)],
)


def test_who_is_on_a_line_is_judged_by_the_roster_in_force():
    lines = ["anna", "ben", "otto", "nobody"]
    expected = {
        "ben": Unwelcome.REVOKED,
        "otto": Unwelcome.ENDED,
        "nobody": Unwelcome.UNLISTED,
    }
    assert unwelcome_on(lines, ROSTER, NOW_US) == expected


class AtDoor:
    """A door by hand; `said` at which time."""

    def __init__(self) -> None:
        self.figures = DoorFigures({}, {}, {})
        self.said: list[str] = []
        self.watch = DoorWatch(lambda: self.figures, lambda: ROSTER, self.said.append)

    def turn(
        self,
        t_s: float,
        unwelcome: Mapping[str, Unwelcome] | None = None,
        **turned_away: int,
    ) -> list[str]:
        counts = {TurnedAway(why): count for why, count in turned_away.items()}
        self.figures = DoorFigures({}, unwelcome or {}, counts)
        self.said.clear()
        self.watch.turn(t_s, NOW_US)
        return list(self.said)


def test_who_comes_is_said_at_once_and_who_comes_and_goes_once_a_minute():
    door, ben = AtDoor(), {"ben": Unwelcome.REVOKED}
    assert door.turn(0.0, ben) == ["ON A LINE: ben is revoked"]
    assert door.turn(1.0, ben) == []
    flaps = [door.turn(2.0 + t, None if t % 2 else ben) for t in range(58)]
    assert not any(flaps)
    assert door.turn(SAY_AGAIN_S + 1.0, ben) == ["ON A LINE: ben is revoked"]


def test_calls_that_were_turned_away_are_said_with_their_number_once_a_minute():
    door = AtDoor()
    assert door.turn(0.0) == []
    (first,) = door.turn(1.0, ended=2)
    who = "by the roster ended: otto (2026-04-19), pia (2026-04-30)"
    assert first == f"turned away: 2 with an ended certificate; {who}"
    assert door.turn(30.0, ended=5, stranger=1_000) == []
    later = door.turn(62.0, ended=5, stranger=2_000)
    assert later == [
        f"turned away: 3 with an ended certificate; {who}",
        "turned away: 2000 without a certificate of this fleet",
    ]


LINE = (
    "\x1b[2m2026-11-25T03:40:09.119544Z\x1b[0m \x1b[33m WARN\x1b[0m acc-0 ThreadId(05) "
    "\x1b[2mzenoh_link_tls::unicast\x1b[0m\x1b[2m:\x1b[0m {}. Hint: increase the limit.\n"
)
"""As zenoh 1.10 writes it."""


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("invalid peer certificate: certificate expired: verification", TurnedAway.ENDED),
        ("invalid peer certificate: BadSignature", TurnedAway.STRANGER),
        ("received corrupt message of type MessageTooLarge", TurnedAway.STRANGER),
    ],
)
def test_a_line_of_zenohs_log_tells_why_a_caller_was_turned_away(words, why):
    assert turned_away_by(LINE.format(words).encode()) is why


@pytest.mark.parametrize(
    "line",
    [
        b"03:40:09Z d1: 2 messages rejected: zenoh_link_tls::unicast: no\n",
        b"2026-11-25T03:40:10.117233Z  WARN zenoh::net::runtime: Unable to connect\n",
        b"\xff\x00 zenoh_link_tls::unicast: x\n",
        b"",
    ],
)
def test_what_the_program_says_itself_is_passed_on(line):
    log = DoorLog()
    assert not log.takes(line)
    assert log.turned_away == Counter()
