"""Status of the companion on the vehicle's network: heartbeats, named values and texts."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from companion.adapters.autopilots.codec import heartbeat_message, mavlink
from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.autopilots.status_text import StatusTexts
from companion.adapters.clock import AutopilotClock, is_due
from companion.core.mission.actions import AlertReport, PublishValues, WindReport
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase

HEARTBEAT_S = WIND_S = 1.0
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
        autopilot: AutopilotPort,
    ) -> None:
        self._queue_message = queue_message
        self._clock = clock
        self._wall_clock_s = wall_clock_s
        self._pilot = pilot
        self._autopilot = autopilot
        self._wind_s: float | None = None
        self._texts = StatusTexts()
        self._waiting_values: dict[str, float] = {}
        self._tick_heartbeat_s: float | None = None
        self._heartbeat_wall_s: float | None = None

    def queue_text(self, report: AlertReport) -> None:
        """Queue the text of an alert."""
        for message in self._texts.split_into_messages(report.severity, report.text):
            self._queue_message(message)

    def add_report(self, report: PublishValues | WindReport) -> None:
        """Add values to send, newer ones replace waiting ones of their name; queue the wind."""
        if isinstance(report, PublishValues):
            self._waiting_values.update(report.values)
        elif self._is_only_wind_source() and is_due(self._wind_s, WIND_S - 1e-6, report.t_s):
            self._wind_s = report.t_s
            self._queue_message(self._wind_cov_message(report))

    def _is_only_wind_source(self) -> bool:
        """Whether this companion flies the vehicle and the autopilot has no wind of its own.

        Ground stations show the last WIND_COV of any component: two senders would alternate.
        """
        telemetry = self._pilot.context.telemetry
        in_flight = self._pilot.phase in FLIGHT_PHASES and telemetry.airborne
        return in_flight and telemetry.wind is None and self._autopilot.estimates_wind is False

    def _wind_cov_message(self, wind: WindReport) -> Any:
        """Return WIND_COV: where the air moves to, as PX4 sends and QGroundControl shows it."""
        covariance = [[wind.nn_m2ps2, wind.ne_m2ps2], [wind.ne_m2ps2, wind.ee_m2ps2]]
        largest_std_mps = math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
        position = self._pilot.context.telemetry.position
        amsl_m = math.nan if position is None else position.alt_amsl_m
        time_us = 1000 * self._clock.autopilot_time_since_boot_ms
        unknown = math.nan
        return mavlink.MAVLink_wind_cov_message(
            time_us, wind.n_mps, wind.e_mps, unknown, unknown, unknown, amsl_m, largest_std_mps, 0.0
        )

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
