"""Service record of one vehicle as stored in its file: evidence, alarms and resets."""

import math
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.monitor.promises import DRAW, PACK, WIND, bet_count_of_promise

FORMAT = "service-monitor/1"
UNNAMED = "unnamed"
"""Name of a pack without a configured name."""

DaySums = tuple[float, float]


class StoredEvidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Evidence of one subject (`Evidence`) as plain numbers; `None` in `log_closed` is -infinity.

    `days` are the latest days' sums (precision and precision times excess, or checks and failed
    checks), for an estimate. `alarm_flight`: flight number of the active alarm; None: no alarm.
    `seen_day`: service day of the latest flight. `order`: number of the pack, from 1.
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

    def check_plausible(self, subject: str) -> None:
        """Raise LeewayError for values that a monitor cannot have written."""
        closed = [log for log in self.log_closed if log is not None]
        numbers = [self.information, self.score, *closed, *(n for day in self.days for n in day)]
        is_finite = all(math.isfinite(number) for number in numbers) and self.information >= 0.0
        has_shape = len(self.log_closed) == bet_count_of_promise(subject) and len(self.days) > 0
        if not (is_finite and self.order >= 1 and (has_shape if self.day > 0 else self.day == 0)):
            raise LeewayError(f"{subject}: invalid evidence, expected values of a monitor")


class Reset(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Reset of a subject's evidence by a person: name, reason, time, number of flights."""

    subject: str
    by: str
    reason: str = msgspec.field(name="why")
    epoch_s: float
    flights: int


class ServiceRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Service of one vehicle. `airframe` is a digest of the monitored airframe model.

    `last_flight` names the latest counted flight, so that no flight counts twice. `lost_left` is
    the number of remaining flights with conservative assumptions after a loss of evidence.
    """

    format: Literal["service-monitor/1"] = FORMAT
    airframe: str
    flights: int = 0
    day: int = 0
    day_start_s: float | None = msgspec.field(default=None, name="day_began_s")
    last_s: float | None = None
    last_flight: str = ""
    lost_left: int = 0
    draw: StoredEvidence = StoredEvidence()
    wind: StoredEvidence = StoredEvidence()
    packs: dict[str, StoredEvidence] = {}
    resets: list[Reset] = []

    def __post_init__(self) -> None:
        self.draw.check_plausible(DRAW)
        self.wind.check_plausible(WIND)
        for kept in self.packs.values():
            kept.check_plausible(PACK)


def service_record_from_dict(table: object, document_name: str) -> ServiceRecord:
    """Convert a parsed record to a `ServiceRecord`. LeewayError states the file and the key."""
    try:
        return msgspec.convert(table, ServiceRecord)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{document_name}: {error}") from error
