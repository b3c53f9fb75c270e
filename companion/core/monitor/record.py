"""The service of one vehicle as its file keeps it: evidence, alarms, and what persons reset."""

import math
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.monitor.promises import DRAW, PACK, WIND, bets_of

FORMAT = "service-monitor/1"
UNNAMED = "unnamed"
"""The pack, where nobody names one."""

DaySums = tuple[float, float]


class Kept(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One subject's evidence (`Evidence`) as plain numbers; `None` in `log_closed` is -infinity.

    `days` are the newest days' sums (precision and precision times excess, or checks and failed
    ones), for an estimate. `alarm_flight`: the service's flight at which the alarm came; None: none
    stands. `seen_day`: the service's day of its newest flight. `order`: which pack it was, from 1.
    """

    day: int = 0
    log_closed: list[float | None] = []
    information: float = 0.0
    score: float = 0.0
    days: list[DaySums] = []
    flights: int = 0
    seen_day: int = 0
    alarm_flight: int | None = None
    order: int = 1

    def check(self, subject: str) -> None:
        """Raises LeewayError for numbers that no monitor wrote."""
        closed = [log for log in self.log_closed if log is not None]
        numbers = [self.information, self.score, *closed, *(n for day in self.days for n in day)]
        sound = all(math.isfinite(number) for number in numbers) and self.information >= 0.0
        shaped = len(self.log_closed) == bets_of(subject) and len(self.days) > 0
        if not (sound and self.order >= 1 and (shaped if self.day > 0 else self.day == 0)):
            raise LeewayError(f"{subject}: no evidence that a monitor wrote")


class Reset(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A person has begun a subject's evidence anew: who, why, when, after which flight."""

    subject: str
    by: str
    why: str
    epoch_s: float
    flights: int


class Service(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A vehicle's service so far. `airframe` is a digest of what was promised of it.

    `last_flight` names the newest flight that is counted: no flight counts twice. `lost_left`: so
    many flights more are flown carefully, as evidence was lost.
    """

    format: Literal["service-monitor/1"] = FORMAT
    airframe: str
    flights: int = 0
    day: int = 0
    day_began_s: float | None = None
    last_s: float | None = None
    last_flight: str = ""
    lost_left: int = 0
    draw: Kept = Kept()
    wind: Kept = Kept()
    packs: dict[str, Kept] = {}
    resets: list[Reset] = []

    def __post_init__(self) -> None:
        self.draw.check(DRAW)
        self.wind.check(WIND)
        for kept in self.packs.values():
            kept.check(PACK)


def service_from_dict(table: object, where: str) -> Service:
    """Check a record that was read; LeewayError names the file and the key."""
    try:
        return msgspec.convert(table, Service)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{where}: {error}") from error
