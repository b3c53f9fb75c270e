"""A vehicle between missions: monitors its autopilot, reports to the dispatcher and waits.

The autopilot receives heartbeats, TIMESYNC responses and telemetry requests: ArduPilot sends no
position unless requested, and a dispatcher assigns no mission to a drone without a known position
on its pad. No other command is sent here.
"""

import contextlib
from collections.abc import Callable

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.autopilots.link import Link
from companion.adapters.clock import is_due, wall_s
from companion.adapters.files.signing_files import SigningStampStore
from companion.app.flight.assignment import write_assignment
from companion.app.flight.autopilot_client import AutopilotClient
from companion.app.flight.fleet_port import STANDBY, FleetPort, StoredAssignment
from companion.app.flight.loaded_flight import RunOptions, Settings
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import RequestTelemetry
from companion.fleet.command_log import CommandReply
from companion.fleet.messages import Assign, Command, CommandStatus, Launch, Recall, Withdraw
from companion.fleet.service_manager import Watchdog

TELEMETRY_TIMEOUT_S = 5.0
"""Age at which telemetry of a silent vehicle is discarded."""

TICK_S = 0.1
POSITION_TIMEOUT_S = 5.0
TELEMETRY_REQUEST_INTERVAL_S = 10.0
"""Autopilot time between requests: a dozen requests with two retries each take less."""


class Standby:
    """Waits on a link; `wait_for_assignment` returns an assignment, or `None` on a stop request."""

    def __init__(
        self,
        port: FleetPort,
        link: Link,
        codec: MavlinkCodec,
        options: RunOptions,
        settings: Settings,
        clock_s: Callable[[], float] = wall_s,
        stamps: SigningStampStore | None = None,
    ) -> None:
        self._port = port
        self._options, self._settings = options, settings
        self._client = AutopilotClient(link, codec, options.system_id, clock_s)
        self._assignment: StoredAssignment | None = None
        self._clock_s = clock_s
        self._ticked_s: float | None = None
        self._requested_s: float | None = None
        self._watchdog = Watchdog()
        self._stamps = stamps

    def wait_for_assignment(self, stop_requested: Callable[[], bool]) -> StoredAssignment | None:
        """Run until an assignment is loaded or `stop_requested()` is true."""
        self._port.member.link.set_request_callback(self._client.link.interrupt_receive)
        while self._assignment is None and not stop_requested():
            self.run_receive_cycle()
        return self._assignment

    def run_receive_cycle(self) -> StoredAssignment | None:
        """Run one cycle: receive and handle bytes, exchange messages with the desk.

        Return the assignment once it is loaded; the cycle must not run again after that.
        """
        now_s = self._clock_s()
        self._watchdog.notify_systemd_if_due(now_s)
        if now_s - self._client.received_s > TELEMETRY_TIMEOUT_S:
            # after power off the vehicle may get another site and another pack
            self._client.telemetry.clear_samples()
        self._client.receive_events()
        self._request_telemetry_if_missing()
        self._write_signing_stamps_if_due(now_s)
        self._port.process_commands(self._execute_command)
        self._port.publish_state_if_due(STANDBY, self._client.telemetry)
        return self._assignment

    def _write_signing_stamps_if_due(self, now_s: float) -> None:
        """Write synchronously and ignore disk errors: on the ground both are harmless."""
        write = self._stamps.take_due_write(now_s) if self._stamps is not None else None
        if write is not None:
            with contextlib.suppress(OSError):
                write()

    def _request_telemetry_if_missing(self) -> None:
        """Request position telemetry, and repeat while none arrives (after a reboot)."""
        autopilot, clock = self._client.port, self._client.clock
        if autopilot.system_id is None or not clock.is_known:
            return
        t_s, position = clock.t_s, self._client.telemetry.position
        if not is_due(self._ticked_s, TICK_S, t_s):
            return
        self._ticked_s = t_s
        silent = position is None or t_s - position.t_s > POSITION_TIMEOUT_S
        if silent and is_due(self._requested_s, TELEMETRY_REQUEST_INTERVAL_S, t_s):
            self._requested_s = t_s
            autopilot.execute(RequestTelemetry(), t_s)
        autopilot.tick(t_s)

    def _execute_command(self, command: Command) -> CommandReply:
        command_content = command.action
        match command_content:
            case Assign():
                return self._write_and_store_assignment(command_content)
            case Withdraw():
                self._port.member.command_log.prevent_relaunch_of_assignment(
                    command_content.assignment
                )  # a delayed Assign may arrive later
                return CommandReply(CommandStatus.DONE, "assignment not loaded")
            case Recall() if not self._client.telemetry.armed:
                return CommandReply(CommandStatus.DONE, "standby on the ground")
            case Launch():
                return CommandReply(CommandStatus.REFUSED, "assignment not loaded")
            case _:
                return CommandReply(CommandStatus.REFUSED, "standby: no mission loaded")

    def _write_and_store_assignment(self, command_content: Assign) -> CommandReply:
        if self._assignment is not None:
            return CommandReply(CommandStatus.LATER, f"loading {self._assignment.assignment}")
        stored_assignment = StoredAssignment(
            assignment=command_content.assignment, order=command_content.order
        )
        try:
            write_assignment(command_content, self._port, self._options, self._settings)
            self._port.store_assignment(stored_assignment)
        except LeewayError as error:
            return CommandReply(CommandStatus.REFUSED, str(error))
        except OSError as error:
            return CommandReply(
                CommandStatus.LATER, f"cannot write the mission file: {error.strerror}"
            )
        self._assignment = stored_assignment
        return CommandReply(CommandStatus.DONE, "loaded, not planned yet")
