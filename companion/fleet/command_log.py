"""Received commands: each is executed once, and always gets the same reply.

A command is stored before it is executed and again with its reply, so that a companion killed in
between does not launch a second time: it replies `interrupted`.
"""

import hashlib
from dataclasses import dataclass, field
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError
from companion.fleet.messages import (
    FINAL_STATUSES,
    Command,
    CommandStatus,
    Launch,
    LaunchWindow,
    Recall,
    ReturnControl,
)

MAX_STATE_AGE_S = 15.0
"""Maximum age of a command's state, by the vehicle's clock; states are sent every second."""

MAX_LAUNCH_VALIDITY_S = 15.0
"""Maximum length of a launch window."""

MAX_ENTRIES = 2000
"""Maximum number of stored commands: many days of one vehicle, in about 200 kB."""


class CommandEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A received command; without an answer it is being executed (or was, at a kill)."""

    id: str
    digest: str
    status: CommandStatus | None = msgspec.field(default=None, name="answer")
    reason: str = ""


class StoredCommandLog(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The command log as stored on disk."""

    format: Literal["command-book/1"] = "command-book/1"
    entries: list[CommandEntry] = []
    ended: list[str] = []


NOT_REPEATABLE = (Launch, ReturnControl)
"""Commands that must not be repeated after a kill during execution; all others may be executed
twice with the same effect.
"""


@dataclass(frozen=True, slots=True)
class CommandReply:
    """A reply that requires no execution."""

    status: CommandStatus
    reason: str = ""


@dataclass(slots=True)
class CommandLog:
    """`reply_without_execution_or_none`; if `None`: `record_start`, execute, record the reply.

    `ended` are closed assignments, which cannot be launched again.
    """

    entries: dict[str, CommandEntry] = field(default_factory=dict)
    ended: list[str] = field(default_factory=list)

    def reply_without_execution_or_none(
        self, command: Command, instance_id: str, uptime_s: float
    ) -> CommandReply | None:
        """Return the reply to a known, stale or invalid command; `None`: execute it."""
        known = self.entries.get(command.id)
        if known is not None:
            verdict = _reply_to_repeated_command(known, command_digest(command))
            is_not_final = verdict.status in (CommandStatus.INTERRUPTED, CommandStatus.LATER)
            if not is_not_final or isinstance(command.action, NOT_REPEATABLE):
                return verdict
        if isinstance(command.action, Recall):
            return None
        is_launch = isinstance(command.action, Launch)
        reply_if_outdated = reply_outside_launch_window if is_launch else _reply_to_outdated_command
        outdated = reply_if_outdated(command, instance_id, uptime_s)
        if outdated is not None:
            return outdated
        assignment = getattr(command.action, "assignment", None)
        if assignment in self.ended:
            return CommandReply(CommandStatus.REFUSED, f"assignment {assignment} is closed")
        return None

    def record_start(self, command: Command) -> None:
        """Record that a command is about to be executed."""
        self._store_entry(CommandEntry(id=command.id, digest=command_digest(command)))

    def record_final_reply_or_remove_command(self, command: Command, reply: CommandReply) -> None:
        """Record a final reply; any other reply removes the command, which may be sent again."""
        if reply.status in FINAL_STATUSES:
            entry = CommandEntry(
                id=command.id,
                digest=command_digest(command),
                status=reply.status,
                reason=reply.reason,
            )
            self._store_entry(entry)
        else:
            self.entries.pop(command.id, None)

    def prevent_relaunch_of_assignment(self, assignment: str) -> None:
        """Close an assignment."""
        if assignment not in self.ended:
            self.ended = [*self.ended, assignment][-MAX_ENTRIES:]

    def _store_entry(self, entry: CommandEntry) -> None:
        self.entries.pop(entry.id, None)
        self.entries[entry.id] = entry
        while len(self.entries) > MAX_ENTRIES:
            self.entries.pop(next(iter(self.entries)))

    def to_storage_format(self) -> StoredCommandLog:
        """Return the content to store for a restart."""
        return StoredCommandLog(entries=list(self.entries.values()), ended=list(self.ended))

    @classmethod
    def from_storage_format(cls, stored_log: StoredCommandLog) -> "CommandLog":
        """Restore a stored log; commands in execution become `interrupted`."""
        entries = {
            e.id: e
            if e.status is not None
            else msgspec.structs.replace(e, status=_INTERRUPTED, reason=_INTERRUPTED_REASON)
            for e in stored_log.entries
        }
        return cls(entries, list(stored_log.ended))


_INTERRUPTED = CommandStatus.INTERRUPTED
_INTERRUPTED_REASON = "the companion restarted during execution; its state shows the result"


def command_log_from_dict(table: object, error_location: str) -> CommandLog:
    """Validate a stored command log; LeewayError names the file."""
    try:
        return CommandLog.from_storage_format(msgspec.convert(table, StoredCommandLog))
    except msgspec.ValidationError as error:
        raise LeewayError(f"{error_location}: {error}") from error


def command_digest(command: Command) -> str:
    """Return a digest of a command's content, independent of its time."""
    content = msgspec.json.encode((command.vehicle, command.action), order="deterministic")
    return hashlib.sha256(content).hexdigest()[:16]


def _reply_to_repeated_command(logged_entry: CommandEntry, digest: str) -> CommandReply:
    if logged_entry.digest != digest:
        return CommandReply(CommandStatus.REFUSED, "this id was used for another command")
    if logged_entry.status is None:
        return CommandReply(CommandStatus.LATER, "in progress")
    return CommandReply(logged_entry.status, logged_entry.reason)


def _reply_to_outdated_command(
    command: Command, instance_id: str, uptime_s: float
) -> CommandReply | None:
    if command.instance_id != instance_id:
        return CommandReply(CommandStatus.STALE, "addressed to another instance of this companion")
    age_s = uptime_s - command.as_of_s
    if age_s < 0.0:  # the desk copies a state's uptime, so a valid one is never in the future
        rejection_text = f"refers to a state {-age_s:.0f} s in the future"
        return CommandReply(CommandStatus.REFUSED, rejection_text)
    if age_s > MAX_STATE_AGE_S:
        rejection_text = (
            f"refers to a state {age_s:.0f} s old, expected at most {MAX_STATE_AGE_S:.0f} s"
        )
        return CommandReply(CommandStatus.STALE, rejection_text)
    return None


def reply_outside_launch_window(
    command: Command, instance_id: str, uptime_s: float
) -> CommandReply | None:
    """Return the reply to a launch that must not start a flight now; None: it may, or is none."""
    if not isinstance(command.action, Launch):
        return None
    window = command.action.window
    if not isinstance(window, LaunchWindow):
        return CommandReply(CommandStatus.REFUSED, "launch without a validity")
    if window.expires_s - window.not_before_s > MAX_LAUNCH_VALIDITY_S + 0.001:
        expected = f"expected at most {MAX_LAUNCH_VALIDITY_S:.0f} s"
        valid_s = window.expires_s - window.not_before_s
        return CommandReply(CommandStatus.REFUSED, f"launch valid for {valid_s:.0f} s, {expected}")
    if window.instance_id != instance_id:
        return CommandReply(CommandStatus.EXPIRED, "launch for an earlier instance")
    if uptime_s > window.expires_s:
        return CommandReply(
            CommandStatus.EXPIRED, f"launch expired {uptime_s - window.expires_s:.0f} s ago"
        )
    wait_s = window.not_before_s - uptime_s
    return (
        CommandReply(CommandStatus.LATER, f"launch gap: {wait_s:.0f} s") if wait_s > 0.0 else None
    )
