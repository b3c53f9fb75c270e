"""Trial of companion stalls during a pilot override, at every second of a flight.

Cases share one flight. At each instant it is forked; in the copy the companion's thread stops at a
reading of the clock while the world continues. A stall can thus fall between two iterations of its
loop, or between a decision and its commands. The companion is the flight code in this process, with
a clock driven by the world. `companion_stall` in a flight file stops a companion process instead.
"""

import math
import os
import pickle
import tempfile
import traceback
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np

from companion.core.pilot.context import PilotOptions
from sim_bridge.app.day.companion import SteppedCompanion
from sim_bridge.app.faults.runner import write_changed_flight_file
from sim_bridge.app.flight.craft_building import FlyOptions, build_single_craft
from sim_bridge.app.trials.fuzz import FLIGHT
from sim_bridge.app.trials.trial import TrialRow, failed_rows_for_lost_worker
from sim_bridge.app.world.memory_link import MemoryLink
from sim_bridge.app.world.safety_rules import TakeOver
from sim_bridge.app.world.vehicle_host import EXCHANGE_S, STEPS_PER_EXCHANGE
from sim_bridge.autopilot.kinds import AUTOPILOTS

STALL_DURATIONS_S = (2.0, 6.0, 20.0)
FIRST_STALL_S = {"px4": 12.0, "ardupilot": 42.0}
"""First stall. Earlier, without a position, a mode switch has no effect (measured, seed 1)."""

LAST_STALL_S = {"px4": 112.0, "ardupilot": 160.0}
"""Last stall: landed and disarmed (measured, seed 1); later instants are not tested."""

LIMIT_S = 300.0
OBSERVATION_S = 6.0
"""Time after the stall: command retries are due within 3 s, a heartbeat within 1 s."""

MAX_CLOCK_READINGS = 6
"""The stall falls on one of the first clock readings after its instant; a loop iteration has three
to five."""

BUFFERS_BYTES = (425_984, 40_000)
"""Socket buffer size during the stall: Linux default (net.core.rmem_max 212,992, doubled), and a
small one that loses the latest datagrams."""

UNLIMITED = 1_000_000
MODE_CHANGE_LIMIT_S = 0.3
"""ArduCopter debounces a switch for 0.2 s."""

STALLS_PER_FLIGHT = 40
"""Stalls per flight: the shared flight takes a fifth of their time, and all of them are lost with
its process."""


class StallCase(msgspec.Struct, frozen=True, kw_only=True):
    """One stall at a clock reading after `stall_start_s`, with the time of the pilot override in
    it.
    """

    autopilot: str
    seed: int
    at_s: float
    stall_s: float
    reading: int
    override_frac: float = msgspec.field(name="takes_over_frac")
    buffer_bytes: int
    datagrams_per_step: int = msgspec.field(name="heard_per_step")
    """Datagrams that the companion processes per 0.1 s afterwards; few on a slow computer."""

    @property
    def name(self) -> str:
        """Name of the case and its file."""
        return f"stall-{self.autopilot}-seed{self.seed}-{self.at_s:g}s-for-{self.stall_s:g}s"


def draw_case(
    seed: int, autopilot: str, stall_start_s: float, stall_duration_s: float
) -> StallCase:
    """Draw the stall of this duration at this instant, of the trial with this seed."""
    kind = AUTOPILOTS.index(autopilot)
    rng = np.random.default_rng(
        [seed, kind, round(10.0 * stall_start_s), round(10.0 * stall_duration_s)]
    )
    return StallCase(
        autopilot=autopilot,
        seed=seed,
        at_s=stall_start_s,
        stall_s=stall_duration_s,
        reading=int(rng.integers(MAX_CLOCK_READINGS)),
        override_frac=round(float(rng.uniform(0.0, 0.85)), 3),
        buffer_bytes=int(rng.choice(BUFFERS_BYTES)),
        datagrams_per_step=int(rng.choice([UNLIMITED, 40])),
    )


class StallWorld:
    """One vehicle and its companion in this process; both use only the time of this world."""

    def __init__(self, autopilot: str, seed: int, folder: Path) -> None:
        path = write_changed_flight_file(folder / "flight.toml", FLIGHT)
        options = FlyOptions(flight_file=path, autopilot=autopilot, seed=seed, picture=False)
        self.craft = build_single_craft(options, "memory", folder)
        self.t_s = 0.0
        self.takeover = self.craft.link.takeover = TakeOver()
        self.is_override_effective = False
        self.in_flight = False
        self._mode_before = self.craft.autopilot.mode
        self._override_due_s = math.inf
        self._readings_left: int | None = None
        self._stall_s = 0.0
        self.stall_end_s: float | None = None
        self.companion = SteppedCompanion(
            None,
            self.craft.flight.vehicle.airframe,
            self.clock_s_with_scheduled_stall,
            PilotOptions(configure=True),
            path,
            MemoryLink(BUFFERS_BYTES[0], reports_queue_length=True),
        )
        assert self.companion.run is not None
        self.pilot = self.companion.run.pilot

    def clock_s_with_scheduled_stall(self) -> float:
        """Return the companion's wall clock. A stall occurs here while the world continues."""
        if self._readings_left is not None:
            self._readings_left -= 1
            if self._readings_left < 0:
                self._readings_left = None
                self._advance_world_during_stall()
        return self.t_s

    def _advance_world_during_stall(self) -> None:
        until_s = self.t_s + self._stall_s
        while self.t_s < until_s - 1e-6:
            self._advance_world_one_exchange()
        self.stall_end_s = self.t_s

    def schedule_stall(self, case: StallCase) -> None:
        """Schedule this stall at a future reading of the clock."""
        self.companion.link.limit_bytes = case.buffer_bytes
        self._stall_s, self._readings_left = case.stall_s, case.reading
        self._override_due_s = self.t_s + case.override_frac * case.stall_s

    def _advance_world_one_exchange(self) -> None:
        self.t_s = round(self.t_s + EXCHANGE_S, 6)
        if self.t_s >= self._override_due_s and self.takeover.start_s is None:
            self._start_and_record_override()
        self.craft.advance_and_deliver_frames(STEPS_PER_EXCHANGE)
        start_s = self.takeover.start_s
        if start_s is not None and self.t_s <= start_s + MODE_CHANGE_LIMIT_S:
            self.is_override_effective |= self.craft.autopilot.mode is not self._mode_before
        self.companion.link.queue_received_within_limit(
            self.craft.link.take_datagrams_for_companion(round(self.t_s * 1e9))
        )

    def _start_and_record_override(self) -> None:
        self._mode_before = self.craft.autopilot.mode
        self.craft.start_pilot_override()
        self.takeover.start_s = self.t_s
        self.takeover.record_known(self.t_s)
        self.in_flight = self.craft.record.landed_s is None

    def advance_world_and_companion(self, datagrams_per_step: int = UNLIMITED) -> None:
        """Run one exchange of 0.1 s."""
        self._advance_world_one_exchange()
        for _ in range(datagrams_per_step):
            if not self.companion.link.received or not self.companion.is_running:
                break
            for datagram in self.companion.run_cycle():
                self.craft.link.pass_datagram_to_autopilot(datagram)

    @property
    def is_over(self) -> bool:
        """True if the flight has ended: companion exit, crash or time limit."""
        has_ended = not self.companion.is_running or self.craft.record.crashed
        return has_ended or self.t_s > LIMIT_S


class StallFlight(msgspec.Struct, frozen=True, kw_only=True):
    """A flight and the stalls that are tested in copies of it."""

    autopilot: str
    seed: int
    cases: tuple[StallCase, ...]


def run_flight(run_root: Path, flight: StallFlight) -> list[TrialRow]:
    """Run one flight to its last stall, in a folder under `run_root`; remove the folder."""
    name = f"stall-{flight.autopilot}-seed{flight.seed}"
    run_root.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=name, dir=run_root) as folder:
        return list(run_stall_cases_in_one_flight(flight, Path(folder)))


def lost_flight_rows(flight: StallFlight, reason: str) -> list[TrialRow]:
    """Return failed rows for all stalls of a flight whose worker was lost."""
    return [row for case in flight.cases for row in failed_rows_for_lost_worker(case, reason)]


def group_cases_into_shared_flights(cases: Iterable[StallCase]) -> Iterator[StallFlight]:
    """Group cases with the same vehicle and neighbouring instants into shared flights."""
    groups: dict[tuple[str, int], list[StallCase]] = {}
    for case in cases:
        groups.setdefault((case.autopilot, case.seed), []).append(case)
    for (autopilot, seed), group in groups.items():
        group.sort(key=lambda case: case.at_s)
        for begin in range(0, len(group), STALLS_PER_FLIGHT):
            part = tuple(group[begin : begin + STALLS_PER_FLIGHT])
            yield StallFlight(autopilot=autopilot, seed=seed, cases=part)


def run_stall_cases_in_one_flight(flight: StallFlight, folder: Path) -> Iterator[TrialRow]:
    """Run one flight; run each case, in order of time, in a copy of it."""
    world = StallWorld(flight.autopilot, flight.seed, folder)
    for case in flight.cases:
        while world.t_s < case.at_s - 1e-6 and not world.is_over:
            world.advance_world_and_companion()
        if world.is_over:
            return  # the flight is over: later instants are skipped
        yield _run_in_fork(world, case, folder)
    world.companion.stop()


def _run_in_fork(world: StallWorld, case: StallCase, folder: Path) -> TrialRow:
    """Fork; the copy runs and evaluates the stall, sends its row and exits."""
    read_fd, write_fd = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.close(read_fd)
            _redirect_open_files_to_null(folder)
            with os.fdopen(write_fd, "wb") as pipe:
                pickle.dump(run_and_evaluate_stall(world, case), pipe)
            code = 0
        except Exception:  # noqa: BLE001 - the copy must exit here after any error
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(write_fd)
    with os.fdopen(read_fd, "rb") as pipe:
        result_data = pipe.read()
    _, status = os.waitpid(child, 0)
    if status != 0 or not result_data:
        code = os.waitstatus_to_exitcode(status)
        reason = f"the copy of the flight exited with {code}"  # negative: signal number
        return TrialRow.for_case(case, reason)
    return pickle.loads(result_data)


def _redirect_open_files_to_null(folder: Path) -> None:
    """Redirect the flight's open files to null in the copy, because the original writes them."""
    null_fd = os.open(os.devnull, os.O_RDWR)
    for link in Path("/proc/self/fd").iterdir():
        try:
            inside = Path(os.readlink(link)).is_relative_to(folder.resolve())
        except OSError:
            continue
        if inside:
            os.dup2(null_fd, int(link.name))


def run_and_evaluate_stall(world: StallWorld, case: StallCase) -> TrialRow:
    """Run the stall and evaluate the commands after the pilot override."""
    phase = world.pilot.phase.value
    world.schedule_stall(case)
    until_s = case.at_s + case.stall_s + OBSERVATION_S
    reason = ""
    try:
        while world.t_s < until_s and not world.is_over:
            world.advance_world_and_companion(case.datagrams_per_step)
    except Exception as error:  # noqa: BLE001 - the flight code raised: that is a finding
        reason = f"{type(error).__name__}: {error}"
    if world.is_override_effective and world.in_flight:  # else settings are restored in any mode
        reason = reason or world.craft.link.late_commands_text
    result_data = {
        "phase": phase,
        "took_over_s": world.takeover.start_s,
        "had_effect": world.is_override_effective,
        "woke_s": world.stall_end_s,
        "then": world.pilot.phase.value,
    }
    return TrialRow.for_case(case, reason, result_data)


def draw_cases_for_every_second(seed: int, autopilots: Sequence[str]) -> list[StallCase]:
    """Return cases for every second of the flight and every stall duration."""
    return [
        draw_case(seed, autopilot, at_s, stall_s)
        for autopilot in autopilots
        for at_s in np.arange(FIRST_STALL_S[autopilot], LAST_STALL_S[autopilot], 1.0).tolist()
        for stall_s in STALL_DURATIONS_S
    ]


def draw_random_subset_of_cases(
    seed: int, autopilots: Sequence[str], max_cases: int
) -> list[StallCase]:
    """Draw `max_cases` of all cases."""
    candidates = draw_cases_for_every_second(seed, autopilots)
    selected = np.random.default_rng(seed).choice(
        len(candidates), min(max_cases, len(candidates)), replace=False
    )
    return [candidates[int(k)] for k in sorted(selected)]
