"""One life of a member of the fleet, drone or truck: commands in, each answered; events out.

What a command means is the member's own; that it is carried out once, and that what happened is
kept until somebody asks, is the same for all.
"""

import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.clock import epoch_us, wall_s
from companion.adapters.files.atomic_file import read_whole, write_whole
from companion.adapters.files.disk import Disk, DiskAtOnce
from companion.fleet.command_log import ONCE, CommandBook, Verdict, book_from_dict
from companion.fleet.event_log import EventLog
from companion.fleet.messages import (
    Answered,
    Command,
    EventKind,
    FleetEvent,
    Refused,
    Result,
    State,
    decode_command,
    encode,
)
from companion.fleet.network import Ask, Asked, MemberLink

TWIN_S = 60.0
"""Another companion of our name is told of so often at most."""

BOOK, EVENTS = "commands.json", "events.jsonl"

# What a member keeps in its folder, as JSON: a record is written whole or not at all, with a
# checksum. `ground_station`'s truck keeps its tasks this way too.
read_record, write_record = read_whole, write_whole


@dataclass(slots=True)
class _Begun:
    """A command that is carried out once it lies on the disk that it has begun."""

    asked: Asked
    command: Command
    written: bool = False
    trouble: str = ""


@dataclass(slots=True)
class FleetMember:
    """`clock_s` counts this life's seconds; `remark` is the newest thing to be said about it.

    In flight nobody waits for the `disk`: what must lie there first is done once it does.
    """

    vehicle: str
    folder: Path
    link: MemberLink
    life: str
    book: CommandBook
    log: EventLog
    clock_s: Callable[[], float]
    born_s: float
    disk: Disk
    epoch_us: Callable[[], int] = epoch_us
    remark: str = ""
    _twin_told_s: float | None = None
    _begun: deque[_Begun] = field(default_factory=deque)
    _book_trouble: str = ""

    @classmethod
    def open(
        cls,
        vehicle: str,
        folder: Path,
        link_of: Callable[[str], MemberLink],
        clock_s: Callable[[], float] = wall_s,
        epoch_us: Callable[[], int] = epoch_us,
        disk: Disk | None = None,
    ) -> "FleetMember":
        """Take up what the folder keeps of earlier lives; `link_of(life)` opens the link. `disk`
        writes in its own time; None: at once.

        Raises LeewayError where a file there is broken: a member that forgot its commands must
        not take new ones.
        """
        folder.mkdir(parents=True, exist_ok=True)
        kept = read_whole(folder / BOOK, "book of commands")
        book = CommandBook() if kept is None else book_from_dict(kept, str(folder / BOOK))
        life = secrets.token_hex(6)
        disk = disk or DiskAtOnce(lambda words: None)
        log = EventLog(folder / EVENTS, disk)
        link = link_of(life)
        return cls(vehicle, folder, link, life, book, log, clock_s, clock_s(), disk, epoch_us)

    @property
    def uptime_s(self) -> float:
        """Seconds of this life."""
        return self.clock_s() - self.born_s

    # --- commands ------------------------------------------------------------------------------

    def turn(self, carry_out: Callable[[Command], Verdict]) -> None:
        """Answer everything that was asked, and tell what has come to lie on the disk."""
        self._carry_out_begun(carry_out)
        for asked in self.link.asked():
            match asked.ask:
                case Ask.COMMAND:
                    self._take(asked, carry_out)
                case Ask.EVENTS:
                    asked.answer([encode(event) for event in self.log.after(asked.after)])
                case Ask.TWIN:
                    self._hear_twin()
                case Ask.NOTICE:
                    self.remark = asked.payload.decode()
                    self.tell(EventKind.SAID, self.remark)
                case Ask.ROSTER:
                    pass  # without a roster of its own this member believes everybody
        self._publish_written()

    def _hear_twin(self) -> None:
        """Say it; a flood of namesakes must not push flights out of the log of events."""
        now_s = self.clock_s()
        if self._twin_told_s is not None and now_s - self._twin_told_s < TWIN_S:
            return
        self._twin_told_s = now_s
        self.remark = f"another life of {self.vehicle} is on the network"
        self.tell(EventKind.SAID, self.remark)

    def _take(self, asked: Asked, carry_out: Callable[[Command], Verdict]) -> None:
        command = decode_command(asked.payload)
        if isinstance(command, Refused):
            return self._answer(asked, "", Verdict(Answered.REFUSED, command.reason))
        if command.vehicle != self.vehicle:
            words = f"meant for {command.vehicle}, this is {self.vehicle}"
            return self._answer(asked, command.id, Verdict(Answered.REFUSED, words))
        command = _named_by_signer(command, asked.signer)
        verdict = self.book.look(command, self.life, self.uptime_s)
        if verdict is not None:
            return self._answer(asked, command.id, verdict)
        if isinstance(command.deed, ONCE):
            self._begin(_Begun(asked, command))
            return self._carry_out_begun(carry_out)
        # The rest, done twice, is the same as done once, and waits for no disk.
        self._give_up_begun(f"overtaken by {_name_of(command)}")
        verdict = self._finish(command, carry_out)
        return self._answer(asked, command.id, verdict)

    def _begin(self, begun: _Begun) -> None:
        """Have it written that this has begun."""
        self.book.begin(begun.command)
        save = self._book_as_it_is(settle=True)

        def write() -> None:
            try:
                save()
            except OSError as error:
                begun.trouble = f"cannot write it down: {error.strerror}"
            begun.written = True

        if not self.disk.do(BOOK, write, whole=True):
            begun.written, begun.trouble = True, "cannot write it down: the disk takes no more"
        self._begun.append(begun)

    def _carry_out_begun(self, carry_out: Callable[[Command], Verdict]) -> None:
        while self._begun and self._begun[0].written:
            begun = self._begun.popleft()
            asked, command = begun.asked, begun.command
            if begun.trouble:
                self._leave_undone(begun, begun.trouble)
            else:
                self._answer(asked, command.id, self._finish(command, carry_out))

    def _give_up_begun(self, why: str) -> None:
        """What still waits for the disk is not done behind a younger order."""
        while self._begun:
            self._leave_undone(self._begun.popleft(), why)

    def _leave_undone(self, begun: _Begun, why: str) -> None:
        verdict = Verdict(Answered.LATER, why)
        self.book.end(begun.command, verdict)
        self._answer(begun.asked, begun.command.id, verdict)

    def _finish(self, command: Command, carry_out: Callable[[Command], Verdict]) -> Verdict:
        verdict = carry_out(command)
        self.book.end(command, verdict)
        self.save_book(settle=isinstance(command.deed, ONCE))
        said = f"{_name_of(command)} by {command.by}: {verdict.answer.value} {verdict.reason}"
        self.tell(EventKind.COMMAND, said.strip())
        return verdict

    def save_book(self, *, settle: bool = True) -> None:
        """Have the book written; a disk that does not take it is said with the next state."""
        save = self._book_as_it_is(settle=settle)

        def write() -> None:
            try:
                save()
                self._book_trouble = ""
            except OSError as error:
                self._book_trouble = f"book of commands not written: {error.strerror}"

        if not self.disk.do(BOOK, write, whole=True, newest_only=not settle):
            self._book_trouble = "book of commands not written: the disk takes no more"

    def _book_as_it_is(self, *, settle: bool) -> Callable[[], None]:
        """What writes the book with what stands in it now."""
        path, content = self.folder / BOOK, msgspec.to_builtins(self.book.kept())
        return lambda: write_whole(path, content, settle=settle)

    def settle(self) -> None:
        """Wait for the disk, on the ground; then tell what lies there."""
        self.disk.settle()
        self._publish_written()

    def _answer(self, asked: Asked, id_: str, verdict: Verdict) -> None:
        asked.answer([encode(self._result(id_, verdict))])

    def _result(self, id_: str, verdict: Verdict) -> Result:
        return Result(
            id=id_,
            vehicle=self.vehicle,
            life=self.life,
            answer=verdict.answer,
            reason=verdict.reason[:500],
        )

    # --- out -----------------------------------------------------------------------------------

    def tell(self, kind: EventKind, text: str, **more: Any) -> None:
        """Have an event written down; it is told once it lies on the disk."""
        event = FleetEvent(
            vehicle=self.vehicle,
            log=self.log.log,
            seq=1,  # the log gives it its number
            epoch_us=self.epoch_us(),
            kind=kind,
            text=text[:500],
            **more,
        )
        self.log.append(event)
        self._publish_written()

    def _publish_written(self) -> None:
        for event in self.log.newly_written():
            self.link.publish_event(encode(event))

    def publish(self, airframe: str, max_payload_kg: float, phase: str, **more: Any) -> None:
        """Tell the state; `more` are the fields that this member knows."""
        state = State(
            vehicle=self.vehicle,
            life=self.life,
            uptime_s=self.uptime_s,
            epoch_us=self.epoch_us(),
            airframe=airframe,
            max_payload_kg=max_payload_kg,
            phase=phase,
            log=self.log.log,
            last_seq=self.log.last_seq,
            text=(self.log.trouble or self._book_trouble or self.remark)[:500],
            **more,
        )
        self.link.publish_state(encode(state))

    def close(self) -> None:
        """Have all written and told, leave the network and end the files."""
        self.disk.close()
        self._publish_written()
        self.link.close()
        self.log.close()


def _named_by_signer(command: Command, signer: str) -> Command:
    """The command by whom it is proven to come from: the desk may send in a person's name, and that
    name is told beside the desk's.
    """
    behind = f" by way of {signer}"
    if not signer or command.by == signer or command.by.endswith(behind):
        return command
    return msgspec.structs.replace(command, by=f"{command.by}{behind}"[:64])


def _name_of(command: Command) -> str:
    return f"{type(command.deed).__name__.lower()} ({command.id})"
