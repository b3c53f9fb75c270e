"""One life of a member of the fleet, drone or truck: commands in, each answered; events out.

What a command means is the member's own; that it is carried out once, and that what happened is
kept until somebody asks, is the same for all.
"""

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.clock import epoch_us, wall_s
from companion.adapters.files.atomic_file import read_whole, write_whole
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
class FleetMember:
    """`clock_s` counts this life's seconds; `remark` is the newest thing to be said about it."""

    vehicle: str
    folder: Path
    link: MemberLink
    life: str
    book: CommandBook
    log: EventLog
    clock_s: Callable[[], float]
    born_s: float
    epoch_us: Callable[[], int] = epoch_us
    remark: str = ""
    _twin_told_s: float | None = None

    @classmethod
    def open(
        cls,
        vehicle: str,
        folder: Path,
        link_of: Callable[[str], MemberLink],
        clock_s: Callable[[], float] = wall_s,
        epoch_us: Callable[[], int] = epoch_us,
    ) -> "FleetMember":
        """Take up what the folder keeps of earlier lives; `link_of(life)` opens the link.

        Raises LeewayError where a file there is broken: a member that forgot its commands must
        not take new ones.
        """
        folder.mkdir(parents=True, exist_ok=True)
        kept = read_whole(folder / BOOK, "book of commands")
        book = CommandBook() if kept is None else book_from_dict(kept, str(folder / BOOK))
        life = secrets.token_hex(6)
        log = EventLog(folder / EVENTS)
        return cls(vehicle, folder, link_of(life), life, book, log, clock_s, clock_s(), epoch_us)

    @property
    def uptime_s(self) -> float:
        """Seconds of this life."""
        return self.clock_s() - self.born_s

    # --- commands ------------------------------------------------------------------------------

    def turn(self, carry_out: Callable[[Command], Verdict]) -> None:
        """Answer everything that was asked."""
        for asked in self.link.asked():
            match asked.ask:
                case Ask.COMMAND:
                    asked.answer([encode(self._answered(asked, carry_out))])
                case Ask.EVENTS:
                    asked.answer([encode(event) for event in self.log.after(asked.after)])
                case Ask.TWIN:
                    self._hear_twin()
                case Ask.NOTICE:
                    self.remark = asked.payload.decode()
                    self.tell(EventKind.SAID, self.remark)
                case Ask.ROSTER:
                    pass  # without a roster of its own this member believes everybody

    def _hear_twin(self) -> None:
        """Say it; a flood of namesakes must not push flights out of the log of events."""
        now_s = self.clock_s()
        if self._twin_told_s is not None and now_s - self._twin_told_s < TWIN_S:
            return
        self._twin_told_s = now_s
        self.remark = f"another life of {self.vehicle} is on the network"
        self.tell(EventKind.SAID, self.remark)

    def _answered(self, asked: Asked, carry_out: Callable[[Command], Verdict]) -> Result:
        command = decode_command(asked.payload)
        if isinstance(command, Refused):
            return self._result("", Verdict(Answered.REFUSED, command.reason))
        if command.vehicle != self.vehicle:
            words = f"meant for {command.vehicle}, this is {self.vehicle}"
            return self._result(command.id, Verdict(Answered.REFUSED, words))
        command = _named_by_signer(command, asked.signer)
        verdict = self.book.look(command, self.life, self.uptime_s)
        if verdict is None:
            verdict = self._carry_out(command, carry_out)
        return self._result(command.id, verdict)

    def _carry_out(self, command: Command, carry_out: Callable[[Command], Verdict]) -> Verdict:
        once = isinstance(command.deed, ONCE)
        if once:  # the rest, done twice, is the same as done once
            self.book.begin(command)
            try:
                self._save_book()
            except OSError as error:
                self.book.end(command, Verdict(Answered.LATER))
                return Verdict(Answered.LATER, f"cannot write it down: {error.strerror}")
        verdict = carry_out(command)
        self.book.end(command, verdict)
        self.try_to_save_book(settle=once)
        said = f"{_name_of(command)} by {command.by}: {verdict.answer.value} {verdict.reason}"
        self.tell(EventKind.COMMAND, said.strip())
        return verdict

    def try_to_save_book(self, *, settle: bool = True) -> None:
        """Write the book; a disk that does not take it is said."""
        try:
            self._save_book(settle=settle)
        except OSError as error:
            self.remark = f"book of commands not written: {error.strerror}"

    def _save_book(self, *, settle: bool = True) -> None:
        write_whole(self.folder / BOOK, msgspec.to_builtins(self.book.kept()), settle=settle)

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
        """Write an event down, then tell it."""
        event = FleetEvent(
            vehicle=self.vehicle,
            log=self.log.log,
            seq=1,  # the log gives it its number
            epoch_us=self.epoch_us(),
            kind=kind,
            text=text[:500],
            **more,
        )
        self.link.publish_event(encode(self.log.append(event)))

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
            text=(self.log.trouble or self.remark)[:500],
            **more,
        )
        self.link.publish_state(encode(state))

    def close(self) -> None:
        """Leave the network and end the files."""
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
