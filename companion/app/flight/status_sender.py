"""Status of the companion on the vehicle's network: heartbeats, named values and texts."""

from collections.abc import Callable
from typing import Any

from companion.adapters.autopilots.codec import heartbeat_message, mavlink
from companion.adapters.autopilots.status_text import StatusTexts
from companion.adapters.clock import AutopilotClock, is_due
from companion.core.mission.actions import AlertReport
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase

HEARTBEAT_S = 1.0
STATE_BY_PHASE = {
    Phase.IDENTIFY: mavlink.MAV_STATE_BOOT,
    Phase.FOREIGN_MISSION: mavlink.MAV_STATE_STANDBY,
    Phase.PASSIVE: mavlink.MAV_STATE_STANDBY,
}


class StatusSender:
    """Queues the status messages of one flight. Named values wait until a tick sends them."""

    def __init__(
        self,
        queue_message: Callable[[Any], None],
        clock: AutopilotClock,
        wall_clock_s: Callable[[], float],
        pilot: Pilot,
    ) -> None:
        self._queue_message = queue_message
        self._clock = clock
        self._wall_clock_s = wall_clock_s
        self._pilot = pilot
        self._texts = StatusTexts()
        self._waiting_values: dict[str, float] = {}
        self._tick_heartbeat_s: float | None = None
        self._heartbeat_wall_s: float | None = None

    def queue_text(self, report: AlertReport) -> None:
        """Queue the text of an alert."""
        for message in self._texts.split_into_messages(report.severity, report.text):
            self._queue_message(message)

    def add_values(self, values: dict[str, float]) -> None:
        """Add values to send; newer values replace waiting ones of their name."""
        self._waiting_values.update(values)

    def queue_next_named_value(self) -> None:
        """Queue one named value a tick: of several at once PX4 logs only the last (observed)."""
        if not self._waiting_values:
            return
        name = next(iter(self._waiting_values))
        value = self._waiting_values.pop(name)
        self._queue_message(
            mavlink.MAVLink_named_value_float_message(
                self._clock.autopilot_time_since_boot_ms, name.encode()[:10], value
            )
        )

    def queue_heartbeat(self) -> None:
        """Queue a heartbeat with the phase."""
        self._heartbeat_wall_s = self._wall_clock_s()
        phase = self._pilot.phase
        flags = mavlink.MAV_MODE_FLAG_AUTO_ENABLED if phase in FLIGHT_PHASES else 0
        state = STATE_BY_PHASE.get(phase, mavlink.MAV_STATE_ACTIVE)
        control_since_ms = (self._pilot.control_since_ms or 0) & 0xFFFFFFFF
        self._queue_message(heartbeat_message(state, flags, control_since_ms))

    def queue_heartbeat_if_due_at_tick(self) -> None:
        """Queue a heartbeat once a second of autopilot time."""
        if is_due(self._tick_heartbeat_s, HEARTBEAT_S - 1e-6, self._clock.t_s):
            self._tick_heartbeat_s = self._clock.t_s
            self.queue_heartbeat()

    def queue_heartbeat_if_due_unconnected(self) -> None:
        """Queue a heartbeat once a second of wall time: a TCP or UDP client must send first to be
        detected.
        """
        if is_due(self._heartbeat_wall_s, HEARTBEAT_S, self._wall_clock_s()):
            self.queue_heartbeat()
