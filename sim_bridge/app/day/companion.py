"""A companion inside the simulated day's process: the flight code, stepped.

It stands by and flies assignments, and is restarted after kills. It uses the same parts as
`companion run --fleet` (`companion.app.flight.fleet_run`), with an in-memory link and the day's
clock.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.autopilots.link import Incoming, Link
from companion.app.flight.assignment import take_up
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loaded_flight import RunOptions, Settings
from companion.app.flight.run import DONE, GROUNDED, Run
from companion.app.flight.standby import Standby
from companion.core.pilot.context import PilotOptions


@dataclass(slots=True)
class MemoryLink:
    """Two datagram queues: `heard` for the companion, `said` by it."""

    datagrams: bool = True
    strangers: int = 0
    heard: deque[bytes] = field(default_factory=deque)
    said: list[bytes] = field(default_factory=list)

    def receive(self, timeout_s: float) -> Incoming | None:
        """The next datagram or None; never waits."""
        return Incoming(self.heard.popleft()) if self.heard else None

    def send(self, data: bytes) -> None:
        """Queue a datagram for the autopilot."""
        self.said.append(data)

    def waiting(self) -> int:
        """Always 0: no decision needs to wait for datagrams, since the world waits for the
        companion.
        """
        return 0

    def settle(self) -> None:
        """No effect: there is no reader beside us."""

    def wake(self) -> None:
        """No effect: nothing blocks here."""

    def answer_to(self, peer: object) -> None:
        """No effect: there is only one peer."""

    def close(self) -> None:
        """Drop pending datagrams; the link's next user starts with an empty queue."""
        self.heard.clear()


@dataclass(slots=True)
class SteppedCompanion:
    """One companion process's life. `ended` is its exit code, once it has ended."""

    port: FleetPort
    airframe: str
    link: MemoryLink
    clock_s: Callable[[], float]
    pilot: PilotOptions
    ended: int | None = None
    _standby: Standby | None = None
    _run: Run | None = None
    _options: RunOptions = field(init=False)
    _settings: Settings = field(init=False)

    def __post_init__(self) -> None:
        self._options = RunOptions(
            link="memory",
            airframe=self.airframe,
            mission=self.port.folder,
            run_dir=self.port.folder,
            plan_at_once=True,
            record_at_once=True,
            pilot=self.pilot,
        )
        self._settings = Settings.read(self._options)

    @property
    def running(self) -> bool:
        """False once it has ended."""
        return self.ended is None

    def hear(self, datagrams: list[bytes]) -> list[bytes]:
        """Process all these datagrams and talk to the desk; returns the replies to the
        autopilot.
        """
        self.link.heard.extend(datagrams)
        self._once()
        while self.link.heard and self.ended is None:
            self._once()
        said, self.link.said = self.link.said, []
        return said

    def kill(self) -> None:
        """End as at a power loss: only what is on disk remains."""
        self.ended = 9
        self.port.close()  # its liveliness token ends with the process
        if self._run is not None:
            self._run.recorder.close()
            self._run.lock.release()  # as the system does at the end of a process

    def stop(self) -> None:
        """Orderly shutdown: records are closed."""
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
            options, settings = self._options, self._settings
            self._standby = Standby(
                self.port, self.link, codec, options, settings, clock_s=self.clock_s
            )
        if self._standby.turn() is not None:
            self._standby = None

    def _begin(self) -> None:
        loaded = take_up(self.port, self._options, self._settings)
        if loaded is not None:
            self._run = Run.begin(loaded, self._opened, port=self.port, wall_clock_s=self.clock_s)

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
