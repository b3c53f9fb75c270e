"""A fleet's companion inside the simulated day's process: the flight code, stepped.

Standby, flight after flight, through kills: the same parts as `companion run --fleet`
(`companion.app.flight.fleet_run`), with a link in memory and the day's time.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.autopilots.link import Incoming, Link
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.run import DONE, GROUNDED, Run, RunOptions
from companion.app.flight.standby import MISSION, Standby
from companion.core.pilot.context import PilotOptions


@dataclass(slots=True)
class MemoryLink:
    """Two queues of datagrams: `heard` for the companion, `said` by it."""

    datagrams: bool = True
    heard: deque[bytes] = field(default_factory=deque)
    said: list[bytes] = field(default_factory=list)

    def receive(self, timeout_s: float) -> Incoming | None:
        """The next datagram, if there is one: time stands still here."""
        return Incoming(self.heard.popleft()) if self.heard else None

    def send(self, data: bytes) -> None:
        """Put a datagram out."""
        self.said.append(data)

    def waiting(self) -> int:
        """How many have not been received. None that a decision should wait for: the world does."""
        return 0

    def wake(self) -> None:
        """Nobody sleeps."""

    def answer_to(self, peer: object) -> None:
        """There is one other end."""

    def close(self) -> None:
        """The next user of the line starts without what is still in it."""
        self.heard.clear()


@dataclass(slots=True)
class SteppedCompanion:
    """One life of a companion. `ended` is its exit code, once a run of it broke off."""

    port: FleetPort
    airframe: str
    link: MemoryLink
    clock_s: Callable[[], float]
    ended: int | None = None
    _standby: Standby | None = None
    _run: Run | None = None

    @property
    def running(self) -> bool:
        """False once it has ended."""
        return self.ended is None

    def hear(self, datagrams: list[bytes]) -> list[bytes]:
        """Hear all of these, talk to the desk; what is said to the autopilot in answer."""
        self.link.heard.extend(datagrams)
        self._once()
        while self.link.heard and self.ended is None:
            self._once()
        said, self.link.said = self.link.said, []
        return said

    def kill(self) -> None:
        """As a computer that loses its power: what is on the disk stays, nothing else."""
        self.ended = 9
        self.port.close()  # its session's token goes when the process does
        if self._run is not None:
            self._run.recorder.close()

    def stop(self) -> None:
        """In order: records are closed."""
        if self._run is not None:
            self._run.end(self.ended or 0)
            self._run = None
        if self.ended is None:
            self.ended = 0
            self.port.close()

    def _once(self) -> None:
        if self._run is not None:
            self._fly(self._run)
        elif self.port.current is not None:
            self._begin()
        else:
            self._stand_by()

    def _stand_by(self) -> None:
        if self._standby is None:
            codec = MavlinkCodec(datagrams=True)
            self._standby = Standby(self.port, self.link, codec, clock_s=self.clock_s)
        if self._standby.turn() is not None:
            self._standby = None

    def _begin(self) -> None:
        assert self.port.current is not None
        assignment = self.port.current.assignment
        if self.port.log.has_outcome(assignment):
            self.port.put_ashore()
            return
        folder = self.port.folder_of(assignment)
        options = RunOptions(
            link="memory",
            airframe=self.airframe,
            mission=folder / MISSION,
            run_dir=folder,
            pilot=PilotOptions(configure=True),
        )
        self._run = Run.begin(
            options,
            self._opened,
            port=self.port,
            wall_clock_s=self.clock_s,
        )

    def _opened(self, url: str) -> Link:
        return self.link

    def _fly(self, run: Run) -> None:
        code = run.step()
        if code is None:
            return
        run.end(code)
        self._run = None
        if code in (DONE, GROUNDED):
            self.port.put_ashore()
        else:
            self.ended = code
            self.port.close()
