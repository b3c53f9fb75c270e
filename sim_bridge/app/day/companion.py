"""Companion inside the simulated day's process: the flight code, run in steps.

It waits in standby, flies assignments and can be restarted after a kill. It uses the components
of `companion run --fleet` (`companion.app.flight.fleet_run`) with an in-memory link and the day's
clock.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.app.flight.assignment import load_current_assignment
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions, Settings
from companion.app.flight.run import DONE, GROUNDED, Run
from companion.app.flight.standby import Standby
from companion.core.pilot.context import PilotOptions
from sim_bridge.app.world.memory_link import MemoryLink


@dataclass(slots=True)
class SteppedCompanion:
    """One companion process. `exit_code`: exit code, or None while it runs.

    With a `mission` (a flight file in its run folder) it flies that flight and ends. Otherwise it
    waits in standby for assignments.
    """

    port: FleetPort | None
    """None: no fleet, which needs a mission."""
    airframe: str
    clock_s: Callable[[], float]
    pilot: PilotOptions
    mission: Path | None = None
    link: MemoryLink = field(default_factory=MemoryLink)
    exit_code: int | None = None
    run: Run | None = None
    """The current flight."""
    _standby: Standby | None = None
    _options: RunOptions = field(init=False)
    _settings: Settings = field(init=False)

    def __post_init__(self) -> None:
        if self.port is not None:
            folder = self.port.member.folder
        else:
            assert self.mission is not None
            folder = self.mission.parent
        self._options = RunOptions(
            link="memory",
            airframe=self.airframe,
            mission=self.mission or folder,
            run_dir=folder,
            plan_synchronously=True,
            record_synchronously=True,
            pilot=self.pilot,
        )
        self._settings = Settings.read_settings_files(self._options)
        if self.mission is not None:
            self._begin_flight_if_loaded(LoadedFlight.read_and_validate(self._options))

    @property
    def is_running(self) -> bool:
        """Whether the process has not ended."""
        return self.exit_code is None

    def process_datagrams(self, datagrams: list[bytes]) -> list[bytes]:
        """Process all these datagrams, exchange messages with the desk and return the replies
        to the autopilot.
        """
        self.link.queue_received_within_limit(datagrams)
        sent = self.run_cycle()
        while self.link.received and self.exit_code is None:
            sent += self.run_cycle()
        return sent

    def run_cycle(self) -> list[bytes]:
        """Process one queued datagram and return the replies to the autopilot."""
        if self.run is not None:
            self._run_flight_cycle(self.run)
        elif self.port is not None:
            self._load_assignment_or_run_standby_cycle(self.port)
        return self.link.take_sent_datagrams()

    def kill(self) -> None:
        """End as after a power loss: only data on disk remains."""
        self._end(9)
        if self.run is not None:
            self.run.recorder.close()
            self.run.lock.release()  # the operating system does so when a process ends

    def stop(self) -> None:
        """Shut down in an orderly way and close the records."""
        if self.run is not None:
            self.run.write_result_and_close(self.exit_code or 0)
            self.run = None
        if self.exit_code is None:
            self._end(0)

    def _end(self, exit_code: int) -> None:
        self.exit_code = exit_code
        if self.port is not None:
            self.port.close()  # the liveliness token ends with the process

    def _load_assignment_or_run_standby_cycle(self, port: FleetPort) -> None:
        options, settings = self._options, self._settings
        if port.current is not None:
            self._begin_flight_if_loaded(load_current_assignment(port, options, settings))
            return
        if self._standby is None:
            codec = MavlinkCodec(datagrams=True)
            self._standby = Standby(port, self.link, codec, options, settings, clock_s=self.clock_s)
        if self._standby.run_receive_cycle() is not None:
            self._standby = None

    def _begin_flight_if_loaded(self, loaded: LoadedFlight | None) -> None:
        if loaded is not None:
            self.run = Run.begin(
                loaded, lambda url: self.link, port=self.port, wall_clock_s=self.clock_s
            )

    def _run_flight_cycle(self, run: Run) -> None:
        code = run.run_cycle_and_get_exit_code()
        if code is None:
            return
        run.write_result_and_close(code)
        self.run = None
        if code in (DONE, GROUNDED) and self.mission is None and self.port is not None:
            self.port.unload_assignment()
        else:
            self._end(code)
