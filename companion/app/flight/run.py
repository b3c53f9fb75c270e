"""One companion from its arguments to its exit code."""

import signal
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.autopilots.link import Link, open_link
from companion.adapters.autopilots.operator_port import OperatorTrust
from companion.adapters.clock import wall_s
from companion.adapters.files.folder_lock import FolderLock
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions
from companion.app.flight.loop import Loop
from companion.app.flight.planning import PlanAtOnce
from companion.app.flight.recorder import Recorder
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Action, Say, Severity
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.transitions import Phase

if TYPE_CHECKING:
    from companion.app.flight.fleet_port import FleetPort  # zenoh's: loaded for a fleet only

DONE, BROKEN, USAGE, GROUNDED, NO_LINK, STOPPED, LINK_CLOSED = 0, 1, 2, 3, 4, 5, 6
"""Exit codes: the mission ended; an error inside; a mistake in the input; no take-off was possible
(for `check`: something is missing); no autopilot, or lost for good; stopped by a signal; the link
did not open, and may later."""


def run(
    options: RunOptions,
    *,
    on_action: Callable[[Action], None] | None = None,
    port: "FleetPort | None" = None,
) -> tuple[int, Pilot]:
    """Fly (or check) until the mission, a signal or an error ends it; returns the exit code.

    `port`: a dispatcher's desk that sees it, and may command what an operator may.

    Raises LeewayError for a mistake in the input, before anything is opened.
    """
    loaded = LoadedFlight.read(options)
    flown = Run.begin(loaded, open_link, on_action=on_action, port=port)
    return fly_to_the_end(flown), flown.pilot


NOT_TO_BE_CHECKED = (Phase.RECOGNISE, Phase.SUSPENDED, Phase.PASSIVE)
"""Phases out of which a check never comes by itself: it flies, or another hand has it."""


@dataclass(slots=True)
class Run:
    """One flight: `step` until that returns an exit code, then `end` with it.

    `check_only`: it ends also where there is nothing to be checked.
    """

    loop: Loop
    recorder: Recorder
    pilot: Pilot
    lock: FolderLock
    check_only: bool = False

    @classmethod
    def begin(
        cls,
        loaded: LoadedFlight,
        open_link: Callable[[str], Link],
        *,
        on_action: Callable[[Action], None] | None = None,
        port: "FleetPort | None" = None,
        wall_clock_s: Callable[[], float] = wall_s,
    ) -> "Run":
        """Take up what an earlier run kept, open link and record.

        Raises LeewayError where another companion flies it, or the link stays shut.
        """
        options, settings = loaded.options, loaded.settings
        kept, trouble = loaded.kept()
        monitor = loaded.monitor()
        pilot = loaded.pilot(kept) if monitor is None else loaded.pilot(kept, monitor.doubts)
        lock = FolderLock.take(options.run_dir)
        try:
            link = open_link(options.link)
        except LeewayError:
            lock.release()
            raise
        continues = kept is not None and not kept.finished
        recorder = Recorder(
            options.run_dir,
            continues=continues,
            keep_checkpoints=not options.pilot.check_only,
            at_once=options.record_at_once,
        )
        codec, stamps = settings.codec(datagrams=link.datagrams)
        if options.system_id is not None:
            codec.be_system(options.system_id)
        loop = Loop.wire(
            link,
            codec,
            recorder,
            pilot,
            system_id=options.system_id,
            silence_limit_s=options.silence_limit_s,
            wall_clock_s=wall_clock_s,
            settings_folder=options.settings_folder,
            trust=OperatorTrust(frozenset(options.operators)),
        )
        if options.plan_at_once:
            loop.planning = PlanAtOnce()
        loop.stamps = stamps
        loop.monitor = None if options.pilot.check_only else monitor
        loop.on_action = on_action
        loop.port = port
        if port is not None:
            port.link.be_woken(link.wake)
            port.link.hear_fleets(loaded.flight.neighbours)
            port.doubt = "; ".join(pilot.doubts.words)
        recorder.note(pilot.telemetry.t_s, loaded.names)
        if stamps is not None and stamps.trouble:
            recorder.note(pilot.telemetry.t_s, stamps.trouble)
        if trouble:
            recorder.note(pilot.telemetry.t_s, trouble)
        if monitor is not None and monitor.trouble:
            recorder.note(pilot.telemetry.t_s, monitor.trouble)
        if loop.monitor is not None:
            loop.monitor.begin(recorder.keep_monitor)
        if not options.pilot.gate_on:
            recorder.note(pilot.telemetry.t_s, "GATE OFF: never turns back, for comparison only")
        if kept is not None and continues:
            recorder.note(pilot.telemetry.t_s, f"going on from a checkpoint in phase {kept.phase}")
        return cls(loop, recorder, pilot, lock, options.pilot.check_only)

    def step(self) -> int | None:
        """Handle what one wait brings; the exit code once the mission is over or the link lost."""
        self.loop.step()
        if self.loop.finished is not None:
            return DONE if self.pilot.phase is Phase.DONE else GROUNDED
        if self.loop.lost:
            self.recorder.note(self.loop.clock.t_s, "no autopilot heard: giving up the link")
            return NO_LINK
        if self.check_only and self.pilot.phase in NOT_TO_BE_CHECKED:
            return GROUNDED
        return None

    def end(self, code: int) -> None:
        """Let out what is left to say, write the result, close everything."""
        loop, recorder, pilot = self.loop, self.recorder, self.pilot
        loop.flush()
        recorder.note(loop.clock.t_s, f"exit {code} in phase {pilot.phase.value}")
        recorder.write_result(
            delivered=pilot.delivered,
            flown=pilot.flight_plan,
            phase=pilot.phase.value,
            findings=pilot.findings,
            settings=pilot.setting_changes,
        )
        loop.link.close()
        recorder.close()
        self.lock.release()


def fly_to_the_end(flown: Run) -> int:
    """Run the loop until the flight ends, a signal comes or something breaks; the exit code."""
    stopped: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        stopped.append(number)

    loop, recorder = flown.loop, flown.recorder
    before = {s: signal.signal(s, stop) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        code = _until_the_end(flown, stopped)
    except Exception as error:  # noqa: BLE001 - the one broad except: nothing is commanded after it
        # The safe action is none: the autopilot holds a mission that ends at home.
        recorder.trouble(loop.clock.t_s, error)
        text = b"companion broken: mission aboard goes home"
        loop.send(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, text))
        code = BROKEN
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    flown.end(code)
    return code


def _until_the_end(flown: Run, stopped: list[int]) -> int:
    loop, recorder = flown.loop, flown.recorder
    while True:
        code = flown.step()
        if code is not None:
            return code
        if stopped:
            recorder.note(loop.clock.t_s, f"signal {stopped[0]}: leaving; the mission stays aboard")
            loop.carry_out([Say(Severity.WARNING, "companion stopped: mission goes home")])
            return STOPPED
