"""Heartbeat of a desk, and its monitor in vehicles, `watch` and map.

A desk that is killed cannot announce its end: the age of its newest heartbeat shows it.
"""

from dataclasses import dataclass, field
from typing import Annotated

import msgspec
from msgspec import Meta

from companion.core.base.wire_message import Name, RosterStamp, WireMessage

HEARTBEAT_INTERVAL_S = 2.0
SILENT_AFTER_S = 8.0
"""Three heartbeats may be lost."""

MAX_DELAY_S = 30.0
MAX_INSTANCES = 16


class DeskHeartbeat(WireMessage, frozen=True, kw_only=True):
    """A running desk, every two seconds."""

    desk: Name
    """Its name."""
    instance_id: Annotated[str, Meta(pattern=r"^[0-9a-f]{1,64}\Z")] = msgspec.field(name="life")
    """Identifier of its process: new after each start."""
    uptime_s: Annotated[float, Meta(ge=0.0)]
    """Seconds since this process started."""
    epoch_us: Annotated[int, Meta(ge=-(2**53), le=2**53)]
    """The sender's wall clock, for people."""
    roster: RosterStamp | msgspec.UnsetType = msgspec.UNSET
    """Its roster; omitted: none."""


@dataclass(slots=True)
class DeskMonitor:
    """Age of the newest heartbeat of any desk, by the receiver's clock.

    A heartbeat counts if its uptime has advanced: a router may repeat one of a dead desk.
    """

    desk: str = "desk"
    received_s: float | None = None
    delay_s: float = 0.0
    """Receiver's wall clock less the sender's; 0 where the receiver's is not known to be right."""
    _start_s: float | None = None
    _is_silent: bool = False
    _newest_s: dict[tuple[str, str], float] = field(default_factory=dict)

    def record_heartbeat(
        self, heartbeat: DeskHeartbeat, now_s: float, epoch_us: int | None = None
    ) -> None:
        """Record a verified heartbeat."""
        key = (heartbeat.desk, heartbeat.instance_id)
        newest_s = self._newest_s.pop(key, -1.0)
        self._newest_s[key] = max(newest_s, heartbeat.uptime_s)
        if len(self._newest_s) > MAX_INSTANCES:
            del self._newest_s[next(iter(self._newest_s))]
        if heartbeat.uptime_s > newest_s:
            self.desk, self.received_s = heartbeat.desk, now_s
            self.delay_s = 0.0 if epoch_us is None else (epoch_us - heartbeat.epoch_us) / 1e6

    def pop_change_text(self, now_s: float) -> str:
        """Return once that a received desk is silent, and once that it is back; else empty."""
        alarm = self.alarm_text(now_s) if self.received_s is not None else ""
        if bool(alarm) == self._is_silent:
            return ""
        self._is_silent = bool(alarm)
        return alarm or f"{self.desk} is received again"

    def age_s(self, now_s: float) -> float | None:
        """Return the age of the newest heartbeat; None: none received yet."""
        return None if self.received_s is None else now_s - self.received_s

    def silence_s(self, now_s: float) -> float | None:
        """Return for how long a desk is silent; None: it is not silent."""
        if self._start_s is None:
            self._start_s = now_s
        age_s = now_s - (self._start_s if self.received_s is None else self.received_s)
        return age_s if age_s > SILENT_AFTER_S else None

    def alarm_text(self, now_s: float) -> str:
        """Return the alarm for people; empty: a desk runs."""
        if (silence_s := self.silence_s(now_s)) is not None:
            return f"no heartbeat of {self.desk} for {silence_s:.0f} s"
        if abs(self.delay_s) > MAX_DELAY_S:
            return f"heartbeat of {self.desk} is {self.delay_s:.0f} s late, or a clock is wrong"
        return ""
