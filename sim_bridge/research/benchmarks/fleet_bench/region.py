"""A desk with its store and its members, as the benchmark sees them."""

from dataclasses import dataclass

import msgspec

from companion.adapters.clock import wall_s
from companion.core.base.errors import LeewayError
from sim_bridge.research.benchmarks.fleet_bench.processes import BenchProcess, cpu_s, rss_mb


class DeskLine(msgspec.Struct):
    """A line of a desk: `whole` (all members' states come), or `ended`."""

    what: str
    wall_s: float
    here: int
    gone: int
    landed: bool = True


@dataclass(slots=True)
class Region:
    """`cpu_s`, `rss_mb` (the most that was seen): of the desk's processes by the last look.
    `back_s`: from a desk's death until its successor hears every member; None: it did not die, or
    it never did.
    """

    fleet: str
    vehicles: int
    command: tuple[str, ...]
    desk: BenchProcess
    members: list[BenchProcess]
    cpu_s: float = 0.0
    rss_mb: float = 0.0
    back_s: float | None = None
    gone: int = 0
    here: int = 0
    _before_s: float = 0.0

    def look(self) -> None:
        """How much the desk has taken by now."""
        if self.desk.process.poll() is not None:
            raise LeewayError(f"the desk of {self.fleet} has ended by itself")
        self.cpu_s = self._before_s + cpu_s(self.desk)
        self.rss_mb = max(self.rss_mb, rss_mb(self.desk))

    def wait(self, what: str, until_s: float) -> DeskLine | None:
        """The desk's line of this kind; None where it does not come by then."""
        while (line := self.desk.hear(until_s - wall_s())) is not None:
            told = msgspec.json.decode(line, type=DeskLine)
            if told.what == what:
                return told
        if self.desk.process.poll() is not None:
            raise LeewayError(f"the desk of {self.fleet} has ended by itself")
        return None

    def kill(self, since_s: float) -> None:
        """The desk dies as by a power cut; another begins on its store."""
        self.look()
        self._before_s = self.cpu_s
        self.desk.kill()
        self.desk = BenchProcess.start(*self.command)
        self.desk.say(f"fly {since_s}")

    def wait_back(self, killed_s: float, until_s: float) -> None:
        """Until the desk hears every member again."""
        whole = self.wait("whole", until_s)
        self.back_s = None if whole is None else whole.wall_s - killed_s

    def assign_no_more(self) -> None:
        """What flies lands."""
        self.desk.say("stop")
        self.look()

    def settle(self, until_s: float) -> None:
        """Until all have landed."""
        ended = self.wait("ended", until_s)
        if ended is not None:
            self.here, self.gone = ended.here, self.gone + ended.gone

    def flown(self) -> list[str]:
        """Assignments that the members say they have flown; ends them."""
        return [x for one in self.members for x in _flown(one)]


def _flown(member: BenchProcess) -> list[str]:
    words = member.last_words()
    if not words.startswith("["):
        raise LeewayError("a process of members has ended by itself, or does not end")
    return msgspec.json.decode(words, type=list[str])
