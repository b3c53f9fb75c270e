"""A companion that stands still while a pilot takes over, at every second of a flight.

One flight is shared: at each instant it is forked, and in the copy the companion's thread stops
where it next asks what time it is, while the world goes on. So a stall may fall between two turns
of its loop, or between a decision and the orders' leaving. The companion is the flight code itself,
in this process, on a clock that the world drives; `companion_stall` in a flight file stops a
companion's process instead.
"""

import math
import os
import pickle
import tempfile
import traceback
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from companion.adapters.autopilots.link import Incoming, Link
from companion.adapters.files.params import read_flight
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions
from companion.app.flight.run import Run
from companion.core.pilot.context import PilotOptions
from sim_bridge.app.faults.authority import TOLD_PILOT_S
from sim_bridge.app.faults.runner import write_flight
from sim_bridge.app.flight.fly import STEP_S, STEPS, FlyOptions, build_craft
from sim_bridge.app.flight.scenario import read_wind
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.app.trials.fuzz import FLIGHT
from sim_bridge.app.trials.trial import TrialRow, case_lost

STALLS_S = (2.0, 6.0, 20.0)
FIRST_S = {"px4": 12.0, "ardupilot": 42.0}
"""Without a position nobody flies, and a pilot's switch changes nothing (measured, seed 1)."""

LAST_S = {"px4": 112.0, "ardupilot": 160.0}
"""Down and disarmed (measured, seed 1); later instants of a longer flight are not looked at."""

LIMIT_S = 300.0
WATCHED_S = 6.0
"""After the stall: every order's retries are due within 3 s, a heartbeat within 1 s."""

LAST_READINGS = 6
"""The stall falls on one of the first readings of the clock after its instant: a turn of the loop
has three to five."""

BUFFERS_BYTES = (425_984, 40_000)
"""What the socket holds while nobody reads: Linux's default limit (net.core.rmem_max 212,992,
doubled), and a small one, of which the newest is lost."""

OVERHEAD_BYTES = 768
"""The kernel's own, of each datagram (sizeof(struct sk_buff) and its shared info, rounded)."""

AT_ONCE = 1_000_000
SWITCHED_WITHIN_S = 0.3
"""ArduCopter waits 0.2 s before it believes a switch."""

SHARED_BY = 40
"""Stalls of one flight: flying up to them takes a fifth of their time, and as many are lost with a
process that is stopped."""


class StallCase(msgspec.Struct, frozen=True, kw_only=True):
    """One stall: from the instant on, at this reading of the clock; the pilot's switch in it."""

    autopilot: str
    seed: int
    at_s: float
    stall_s: float
    reading: int
    takes_over_frac: float
    buffer_bytes: int
    heard_per_step: int
    """Datagrams that the companion can take in each 0.1 s afterwards; a small computer is slow."""

    @property
    def name(self) -> str:
        """Names the case and its file."""
        return f"stall-{self.autopilot}-seed{self.seed}-{self.at_s:g}s-for-{self.stall_s:g}s"


def drawn(seed: int, autopilot: str, at_s: float, stall_s: float) -> StallCase:
    """The stall of this length at this instant, of a trial with this seed."""
    kind = ("px4", "ardupilot").index(autopilot)
    rng = np.random.default_rng([seed, kind, round(10.0 * at_s), round(10.0 * stall_s)])
    return StallCase(
        autopilot=autopilot,
        seed=seed,
        at_s=at_s,
        stall_s=stall_s,
        reading=int(rng.integers(LAST_READINGS)),
        takes_over_frac=round(float(rng.uniform(0.0, 0.85)), 3),
        buffer_bytes=int(rng.choice(BUFFERS_BYTES)),
        heard_per_step=int(rng.choice([AT_ONCE, 40])),
    )


@dataclass(slots=True)
class BufferLink:
    """Datagrams wait for the companion as in a socket; what does not fit is lost, the newest."""

    limit_bytes: int = BUFFERS_BYTES[0]
    datagrams: bool = True
    strangers: int = 0
    heard: deque[bytes] = field(default_factory=deque)
    said: list[bytes] = field(default_factory=list)

    def arrive(self, datagrams: Sequence[bytes]) -> None:
        """Take in what the autopilot sends."""
        held = sum(len(data) + OVERHEAD_BYTES for data in self.heard)
        for data in datagrams:
            held += len(data) + OVERHEAD_BYTES
            if held <= self.limit_bytes:
                self.heard.append(data)

    def receive(self, timeout_s: float) -> Incoming | None:
        """The next datagram or None; never waits."""
        del timeout_s
        return Incoming(self.heard.popleft()) if self.heard else None

    def send(self, data: bytes) -> None:
        """Queue a datagram for the autopilot."""
        self.said.append(data)

    def waiting(self) -> int:
        """What has arrived and was not received."""
        return len(self.heard)

    def settle(self) -> None:
        """No effect: there is no reader beside us."""

    def wake(self) -> None:
        """No effect: nothing blocks here."""

    def answer_to(self, peer: object) -> None:
        """No effect: there is only one peer."""

    def close(self) -> None:
        """No effect."""


class StallWorld:
    """One vehicle and its companion in this process; both see the time only of this world."""

    def __init__(self, autopilot: str, seed: int, folder: Path) -> None:
        path = write_flight(folder / "flight.toml", FLIGHT)
        options = FlyOptions(flight_file=path, autopilot=autopilot, seed=seed, picture=False)
        flight = read_flight(path)
        wind_seed, vehicle_seed = np.random.SeedSequence(seed).spawn(2)
        wind, mean = read_wind(flight, path, np.random.default_rng(wind_seed), None)
        self.craft: Craft = build_craft(
            options, flight, wind, mean, 0, vehicle_seed, "memory", folder
        )
        self.link = BufferLink()
        self.t_s = 0.0
        self.exit_code: int | None = None
        self.took_over_s: float | None = None
        self.had_effect = False
        self.in_flight = False
        self._mode_before = self.craft.autopilot.mode
        self._takes_over_s = math.inf
        self._readings_left: int | None = None
        self._stall_s = 0.0
        self.woke_s: float | None = None
        run_options = RunOptions(
            link="memory",
            airframe=flight.vehicle.airframe,
            mission=path,
            run_dir=folder,
            plan_at_once=True,
            record_at_once=True,
            pilot=PilotOptions(configure=True),
        )
        self.run = Run.begin(
            LoadedFlight.read(run_options), self._opened, wall_clock_s=self.clock_s
        )

    def _opened(self, url: str) -> Link:
        del url
        return self.link

    def clock_s(self) -> float:
        """The companion's wall clock. It may stand still here, and the world goes on."""
        if self._readings_left is not None:
            self._readings_left -= 1
            if self._readings_left < 0:
                self._readings_left = None
                self._stand_still()
        return self.t_s

    def _stand_still(self) -> None:
        until_s = self.t_s + self._stall_s
        while self.t_s < until_s - 1e-6:
            self._world_step()
        self.woke_s = self.t_s

    def stall(self, case: StallCase) -> None:
        """Begin this stall, at a reading of the clock from now on."""
        self.link.limit_bytes = case.buffer_bytes
        self._stall_s, self._readings_left = case.stall_s, case.reading
        self._takes_over_s = self.t_s + case.takes_over_frac * case.stall_s

    def _world_step(self) -> None:
        self.t_s = round(self.t_s + STEP_S, 6)
        if self.t_s >= self._takes_over_s and self.took_over_s is None:
            self._take_over()
        self.craft.advance(STEPS)
        took_over_s = self.took_over_s
        if took_over_s is not None and self.t_s <= took_over_s + SWITCHED_WITHIN_S:
            self.had_effect |= self.craft.autopilot.mode is not self._mode_before
        self.link.arrive(self.craft.ask(round(self.t_s * 1e9)))

    def _take_over(self) -> None:
        self._mode_before = self.craft.autopilot.mode
        self.craft.pilot_takes_over()
        self.took_over_s = self.t_s
        self.in_flight = self.craft.record.landed_s is None

    def step(self, heard_per_step: int = AT_ONCE) -> None:
        """One exchange of 0.1 s."""
        self._world_step()
        for _ in range(heard_per_step):
            if not self.link.heard or self.exit_code is not None:
                break
            self.exit_code = self.run.step()
            said, self.link.said = self.link.said, []
            for datagram in said:
                self.craft.receive(datagram)

    @property
    def over(self) -> bool:
        """Nothing more to see."""
        return self.exit_code is not None or self.craft.record.crashed or self.t_s > LIMIT_S


class StallFlight(msgspec.Struct, frozen=True, kw_only=True):
    """A flight and the stalls that copies of it are to stand."""

    autopilot: str
    seed: int
    cases: tuple[StallCase, ...]


@dataclass(frozen=True, slots=True)
class StallFlyer:
    """Flies such flights, each in a folder of its own under `run_root`."""

    run_root: Path

    def __call__(self, flight: StallFlight) -> list[TrialRow]:
        """Fly one to its last stall; nothing is left of it but its rows."""
        name = f"stall-{flight.autopilot}-seed{flight.seed}"
        self.run_root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=name, dir=self.run_root) as folder:
            return list(sweep(flight, Path(folder)))


def flight_lost(flight: StallFlight, why: str) -> list[TrialRow]:
    """The rows of a flight that no worker came back with: none of its stalls has held."""
    return [row for case in flight.cases for row in case_lost(case, why)]


def flights(cases: Iterable[StallCase]) -> Iterator[StallFlight]:
    """Cases of one vehicle and of neighbouring instants share a flight."""
    groups: dict[tuple[str, int], list[StallCase]] = {}
    for case in cases:
        groups.setdefault((case.autopilot, case.seed), []).append(case)
    for (autopilot, seed), group in groups.items():
        group.sort(key=lambda case: case.at_s)
        for begin in range(0, len(group), SHARED_BY):
            part = tuple(group[begin : begin + SHARED_BY])
            yield StallFlight(autopilot=autopilot, seed=seed, cases=part)


def sweep(flight: StallFlight, folder: Path) -> Iterator[TrialRow]:
    """Fly once; each case, in the order of its instants, in a copy of the flight."""
    world = StallWorld(flight.autopilot, flight.seed, folder)
    for case in flight.cases:
        while world.t_s < case.at_s - 1e-6 and not world.over:
            world.step()
        if world.over:
            return  # landed: instants after that are none
        yield _in_a_copy(world, case, folder)
    world.run.end(0)


def _in_a_copy(world: StallWorld, case: StallCase, folder: Path) -> TrialRow:
    """Fork; the copy stalls, is judged, tells and ends."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.close(reading)
            _forget_files(folder)
            _tell(writing, attempt(world, case))
            code = 0
        except Exception:  # noqa: BLE001 - the copy must end here, whatever befell it
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        told = pipe.read()
    _, status = os.waitpid(child, 0)
    if status != 0 or not told:
        code = os.waitstatus_to_exitcode(status)
        why = f"its copy of the flight ended with {code}"  # below zero: by that signal
        return TrialRow(name=case.name, held=False, why=why, told={}, case=case)
    return pickle.loads(told)


def _tell(writing: int, row: TrialRow) -> None:
    with os.fdopen(writing, "wb") as pipe:
        pipe.write(pickle.dumps(row))


def _forget_files(folder: Path) -> None:
    """In the copy nothing is recorded: the files are the flight's, which goes on."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for link in Path("/proc/self/fd").iterdir():
        try:
            inside = Path(os.readlink(link)).is_relative_to(folder.resolve())
        except OSError:
            continue
        if inside:
            os.dup2(nowhere, int(link.name))


def attempt(world: StallWorld, case: StallCase) -> TrialRow:
    """Stall now, watch, judge."""
    phase = world.run.pilot.phase.value
    world.stall(case)
    why = ""
    try:
        _watch(world, case)
    except Exception as error:  # noqa: BLE001 - the flight code raised: that is a finding
        why = f"{type(error).__name__}: {error}"
    late = _late_commands(world)
    if late and not why:
        t_s, name, number = late[0]
        why = f"{len(late)} commands after the take-over, {name} {number} at {t_s:.1f} s"
    told = {
        "phase": phase,
        "took_over_s": world.took_over_s,
        "had_effect": world.had_effect,
        "woke_s": world.woke_s,
        "then": world.run.pilot.phase.value,
    }
    return TrialRow(name=case.name, held=not why, why=why, told=told, case=case)


def _watch(world: StallWorld, case: StallCase) -> None:
    until_s = case.at_s + case.stall_s + WATCHED_S
    while world.t_s < until_s and not world.over:
        world.step(case.heard_per_step)


def _late_commands(world: StallWorld) -> list[tuple[float, str, int]]:
    """What was commanded once the companion could know. Nothing where the switch changed nothing,
    or after landing: then settings are put back, whatever mode it stands in."""
    if world.took_over_s is None or not (world.had_effect and world.in_flight):
        return []
    known_s = world.took_over_s + TOLD_PILOT_S
    return [command for command in world.craft.commands if command[0] > known_s]


def every_case(seed: int, autopilots: Sequence[str]) -> list[StallCase]:
    """Every second of the flight, with every length of stall."""
    return [
        drawn(seed, autopilot, at_s, stall_s)
        for autopilot in autopilots
        for at_s in np.arange(FIRST_S[autopilot], LAST_S[autopilot], 1.0).tolist()
        for stall_s in STALLS_S
    ]


def some_cases(seed: int, autopilots: Sequence[str], count: int) -> list[StallCase]:
    """So many of them, drawn."""
    every = every_case(seed, autopilots)
    chosen = np.random.default_rng(seed).choice(len(every), min(count, len(every)), replace=False)
    return [every[int(k)] for k in sorted(chosen)]
