"""One instance of a fleet member, drone or truck: receives commands, sends events.

The meaning of a command is member-specific; single execution and the storage of events until they
are requested are common to all members.
"""

import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.clock import is_due, unix_time_us, wall_s
from companion.adapters.files.atomic_file import read_checked_json, write_json_atomically
from companion.adapters.files.disk import ImmediateRecordWriter, RecordWriter
from companion.core.base.desk_heartbeat import DeskHeartbeat, DeskMonitor
from companion.fleet.command_log import (
    NOT_REPEATABLE,
    CommandLog,
    CommandReply,
    command_log_from_dict,
    reply_outside_launch_window,
)
from companion.fleet.event_log import EventLog
from companion.fleet.messages import (
    Command,
    CommandStatus,
    EventKind,
    FleetEvent,
    Refused,
    Result,
    State,
    decode_message,
    encode_message,
)
from companion.fleet.network import Authority, MemberLink, MemberRequest, RequestKind
from companion.fleet.trust import MEMBER_SEPARATOR

DUPLICATE_REPORT_INTERVAL_S = 60.0
"""Minimum interval between reports of another companion with the same name."""

COMMANDS_FILE, EVENTS_FILE = "commands.json", "events.jsonl"

# The JSON records in a member's folder: replaced atomically, with a checksum. `ground_station`'s
# truck stores its tasks in the same format.
read_record, write_record = read_checked_json, write_json_atomically


@dataclass(slots=True)
class _PendingCommand:
    """A command that is executed once its start is stored on disk."""

    request: MemberRequest
    command: Command
    is_stored: bool = False
    error_text: str = ""


@dataclass(slots=True)
class FleetMember:
    """`clock_s` counts the instance's seconds; `status_text` is the newest status text. In flight
    the loop never waits for the `disk`: it acts after the required record is stored.
    """

    vehicle: str
    folder: Path
    link: MemberLink
    instance_id: str
    command_log: CommandLog
    log: EventLog
    clock_s: Callable[[], float]
    start_s: float
    disk: RecordWriter
    epoch_us: Callable[[], int] = unix_time_us
    status_text: str = ""
    desks: DeskMonitor = field(default_factory=DeskMonitor)
    _duplicate_reported_s: float | None = None
    _pending: deque[_PendingCommand] = field(default_factory=deque)
    _command_log_error: str = ""

    @classmethod
    def restore_and_open_link(
        cls,
        vehicle: str,
        folder: Path,
        open_link: Callable[[str], MemberLink],
        clock_s: Callable[[], float] = wall_s,
        epoch_us: Callable[[], int] = epoch_us,
        disk: RecordWriter | None = None,
    ) -> "FleetMember":
        """Restore the state of earlier instances; `open_link(instance_id)` opens the link. `disk`
        writes asynchronously; None: synchronously.

        Raises LeewayError if a stored file is damaged: a member that lost its command log must not
        accept new commands.
        """
        folder.mkdir(parents=True, exist_ok=True)
        stored = read_checked_json(folder / COMMANDS_FILE, "command log")
        command_log = (
            CommandLog()
            if stored is None
            else command_log_from_dict(stored, str(folder / COMMANDS_FILE))
        )
        instance_id = secrets.token_hex(6)
        disk = disk or ImmediateRecordWriter(lambda rejection_text: None)
        log = EventLog(folder / EVENTS_FILE, disk)
        link = open_link(instance_id)
        return cls(
            vehicle, folder, link, instance_id, command_log, log, clock_s, clock_s(), disk, epoch_us
        )

    @property
    def uptime_s(self) -> float:
        """Seconds since this instance started."""
        return self.clock_s() - self.start_s

    # --- commands ------------------------------------------------------------------------------

    def process_requests_and_publish_events(
        self, execute: Callable[[Command], CommandReply]
    ) -> None:
        """Answer all pending requests, and publish newly stored events."""
        self._execute_commands_with_stored_start(execute)
        for request in self.link.drain_requests():
            match request.kind:
                case RequestKind.COMMAND:
                    self._execute_or_answer_command(request, execute)
                case RequestKind.EVENTS:
                    events = self.log.next_stored_events_after(request.after_seq)
                    request.reply([encode_message(event) for event in events])
                case RequestKind.DUPLICATE:
                    self._report_duplicate_instance()
                case RequestKind.TEXT:
                    self.status_text = request.payload.decode()
                    self.record_event(EventKind.TEXT, self.status_text)
                case RequestKind.DESK:
                    _record_heartbeat(self.desks, request.payload, self.clock_s())
        self._publish_newly_stored_events()

    def _report_duplicate_instance(self) -> None:
        """Report a duplicate at a limited rate, so that a flood keeps flights in the log."""
        now_s = self.clock_s()
        if not is_due(self._duplicate_reported_s, DUPLICATE_REPORT_INTERVAL_S, now_s):
            return
        self._duplicate_reported_s = now_s
        self.status_text = f"another instance of {self.vehicle} is on the network"
        self.record_event(EventKind.TEXT, self.status_text)

    def _execute_or_answer_command(
        self, request: MemberRequest, execute: Callable[[Command], CommandReply]
    ) -> None:
        command = decode_message(Command, request.payload)
        if isinstance(command, Refused):
            return self._send_reply(request, "", _refused(command.reason))
        if command.vehicle != self.vehicle:
            text = f"addressed to {command.vehicle}, this is {self.vehicle}"
            return self._send_reply(request, command.id, _refused(text))
        command = _add_signer_to_author(command, request.signer)
        verdict = self.command_log.reply_without_execution_or_none(
            command, self.instance_id, self.uptime_s
        )
        if verdict is not None:
            return self._send_reply(request, command.id, verdict)
        if isinstance(command.action, NOT_REPEATABLE):
            self._store_start_and_queue(_PendingCommand(request, command))
            return self._execute_commands_with_stored_start(execute)
        # The other commands have the same effect if repeated, and need no stored record.
        self._reject_all_pending_commands(f"superseded by {_command_label(command)}")
        verdict = self._execute_record_and_log_command(request, command, execute)
        return self._send_reply(request, command.id, verdict)

    def _store_start_and_queue(self, pending: _PendingCommand) -> None:
        """Store the start of a command."""
        self.command_log.record_start(pending.command)

        def mark_stored(error_text: str) -> None:
            if error_text:
                pending.error_text = f"cannot store the command: {error_text}"
            pending.is_stored = True

        self._submit_command_log_write(mark_stored, sync_folder=True)
        self._pending.append(pending)

    def _execute_commands_with_stored_start(
        self, execute: Callable[[Command], CommandReply]
    ) -> None:
        while self._pending and self._pending[0].is_stored:
            pending = self._pending.popleft()
            request, command = pending.request, pending.command
            if pending.error_text:
                self._reject_pending_command(pending, pending.error_text)
            else:
                verdict = self._execute_record_and_log_command(request, command, execute)
                self._send_reply(request, command.id, verdict)

    def _reject_all_pending_commands(self, reason: str) -> None:
        """Reject commands that still wait for the disk: a newer command supersedes them."""
        while self._pending:
            self._reject_pending_command(self._pending.popleft(), reason)

    def _reject_pending_command(self, pending: _PendingCommand, reason: str) -> None:
        verdict = CommandReply(CommandStatus.LATER, reason)
        self.command_log.record_final_reply_or_remove_command(pending.command, verdict)
        self._send_reply(pending.request, pending.command.id, verdict)

    def _execute_record_and_log_command(
        self, request: MemberRequest, command: Command, execute: Callable[[Command], CommandReply]
    ) -> CommandReply:
        refused = _authority_error_or_empty(self.link.trust, request, command)
        outside = reply_outside_launch_window(command, self.instance_id, self.uptime_s)
        verdict = _refused(refused) if refused else outside or execute(command)
        self.command_log.record_final_reply_or_remove_command(command, verdict)
        self.save_command_log(sync_folder=isinstance(command.action, NOT_REPEATABLE))
        text = f"{_command_label(command)} by {command.by}: {verdict.status.value} {verdict.reason}"
        self.record_event(EventKind.COMMAND, text.strip())
        return verdict

    def save_command_log(self, *, sync_folder: bool = True) -> None:
        """Store the command log; a disk error is reported with the next state."""

        def record_error(error_text: str) -> None:
            self._command_log_error = f"command log not stored: {error_text}" if error_text else ""

        self._submit_command_log_write(record_error, sync_folder=sync_folder)

    def _submit_command_log_write(
        self, on_end: Callable[[str], None], *, sync_folder: bool
    ) -> None:
        """Write the present content of the command log; `on_end` receives an error text or ""."""
        path = self.folder / COMMANDS_FILE
        content = msgspec.to_builtins(self.command_log.to_storage_format())

        def write() -> None:
            try:
                write_json_atomically(path, content, sync_folder=sync_folder)
            except OSError as error:
                on_end(str(error.strerror))
            else:
                on_end("")

        if not self.disk.submit_write_job(
            COMMANDS_FILE,
            write,
            is_replaced_at_each_write=True,
            replace_queued_job=not sync_folder,
        ):
            on_end("the disk queue is full")

    def wait_for_disk_and_publish_events(self) -> None:
        """Wait for the disk (on the ground only), then publish newly stored events."""
        self.disk.wait_until_done()
        self._publish_newly_stored_events()

    def _send_reply(self, request: MemberRequest, id_: str, verdict: CommandReply) -> None:
        result = Result(
            id=id_,
            vehicle=self.vehicle,
            instance_id=self.instance_id,
            status=verdict.status,
            reason=verdict.reason[:500],
        )
        request.reply([encode_message(result)])

    # --- out -----------------------------------------------------------------------------------

    def record_event(self, kind: EventKind, text: str, **optional_fields: Any) -> None:
        """Store an event; it is published once it is on the disk."""
        event = FleetEvent(
            vehicle=self.vehicle,
            log=self.log.log,
            seq=1,  # replaced by the log
            epoch_us=self.epoch_us(),
            kind=kind,
            text=text[:500],
            **optional_fields,
        )
        self.log.number_and_store_event(event)
        self._publish_newly_stored_events()

    def _publish_newly_stored_events(self) -> None:
        for event in self.log.drain_newly_stored_events():
            self.link.publish_event(encode_message(event))

    def publish_state(
        self, airframe: str, max_payload_kg: float, phase: str, **optional_fields: Any
    ) -> None:
        """Publish the state; `optional_fields` are the optional fields of this member."""
        state = State(
            vehicle=self.vehicle,
            instance_id=self.instance_id,
            uptime_s=self.uptime_s,
            epoch_us=self.epoch_us(),
            airframe=airframe,
            max_payload_kg=max_payload_kg,
            phase=phase,
            log=self.log.log,
            last_seq=self.log.last_stored_seq,
            roster=self.link.trust.roster_stamp if self.link.trust else msgspec.UNSET,
            text=(self.log.error_text or self._command_log_error or self.status_text)[:500],
            **optional_fields,
        )
        self.link.publish_state(encode_message(state))

    def close(self) -> None:
        """Store and publish everything, leave the network and close the files."""
        self.disk.close()
        self._publish_newly_stored_events()
        self.link.close()
        self.log.close()


def _record_heartbeat(desks: DeskMonitor, raw: bytes, now_s: float) -> None:
    heartbeat = decode_message(DeskHeartbeat, raw)
    if not isinstance(heartbeat, Refused):
        desks.record_heartbeat(heartbeat, now_s)


def _refused(reason: str) -> CommandReply:
    return CommandReply(CommandStatus.REFUSED, reason)


def _authority_error_or_empty(
    trust: Authority | None, request: MemberRequest, command: Command
) -> str:
    """Return why the roster in force, perhaps a newer one than at arrival, forbids a command."""
    if trust is None:
        return ""
    return trust.authority_error_or_empty(command.action, command.by, request.signer)


def _add_signer_to_author(command: Command, signer: str) -> Command:
    """Add the verified signer to the command's author: a desk may send in a person's name, and then
    both names are reported.
    """
    suffix = f"{MEMBER_SEPARATOR}{signer}"
    if not signer or command.by == signer or command.by.endswith(suffix):
        return command
    return msgspec.structs.replace(command, by=f"{command.by}{suffix}"[:64])


def _command_label(command: Command) -> str:
    return f"{type(command.action).__name__.lower()} ({command.id})"
