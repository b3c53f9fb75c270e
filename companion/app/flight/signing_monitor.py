"""Signing in flight: stores the time stamps and detects clocks that differ."""

from collections.abc import Callable

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.clock import format_unix_time_us
from companion.adapters.files.signing_files import STAMPS_NAME, SigningStampStore
from companion.core.mission.actions import AlertReport
from companion.core.mission.alerts import Alert

CLOCK_DIFFERENCE_DELAY_S = 3.0
"""Duration of refusing all signed frames (three heartbeats) that indicates a clock difference."""


class SigningMonitor:
    """Observes the codec of one flight. A clock difference is reported once, with both clocks."""

    def __init__(
        self,
        codec: MavlinkCodec,
        submit_write: Callable[[str, Callable[[], None]], None],
        stamps: SigningStampStore,
    ) -> None:
        self._codec = codec
        self._submit_write = submit_write
        self._stamps = stamps
        self._refused_since_s: float | None = None
        self._is_reported = False

    def update(self, now_s: float) -> list[AlertReport]:
        """Store the stamps if due. Return the alerts once all correctly signed frames
        have been refused for `CLOCK_DIFFERENCE_DELAY_S`.
        """
        write = self._stamps.take_due_write(now_s)
        if write is not None:
            self._submit_write(STAMPS_NAME, write)
        times_us = self._codec.refused_and_own_signing_time_us
        if times_us is None:
            self._refused_since_s = None
            return []
        if self._refused_since_s is None:
            self._refused_since_s = now_s
        if self._is_reported or now_s - self._refused_since_s < CLOCK_DIFFERENCE_DELAY_S:
            return []
        self._is_reported = True
        autopilot_us, own_us = times_us
        create = AlertReport.create
        return [
            create(Alert.SIGNING_CLOCKS_DIFFER, behind_s=(own_us - autopilot_us) / 1e6),
            create(Alert.SIGNING_CLOCK_AUTOPILOT, utc=format_unix_time_us(autopilot_us)),
            create(Alert.SIGNING_CLOCK_COMPANION, utc=format_unix_time_us(own_us)),
            create(Alert.SIGNING_CLOCK_REMEDY),
        ]
