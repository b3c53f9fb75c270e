"""Half a day of standby and flights by one companion process: memory, files and disk over time.

The process is `companion run --fleet`, as on a vehicle; this one is the world, its pack, and a desk
that assigns and launches over zenoh. Simulated time runs as fast as both can; what the companion
does by the wall clock (its states, once a second) is so much rarer in each simulated hour.
"""

import itertools
import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import read_flight
from companion.core.base.errors import LeewayError
from companion.fleet.messages import Assign, Command, Deed, Launch, State
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import CommandAnswered, StateReceived
from sim_bridge.adapters.endpoint import EndpointSet
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.app.day.processes import MEMBER, ROUTER, write_network
from sim_bridge.app.faults.runner import write_flight
from sim_bridge.app.faults.verdict import TRACEBACK
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.fly import STEP_S, STEPS, FlyOptions, build_craft
from sim_bridge.app.flight.scenario import read_wind
from sim_bridge.app.flight.stopping import LEAVES_AT_ONCE
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.app.trials.fuzz import FLIGHT
from sim_bridge.app.trials.trial import TrialRow

FLEET, VEHICLE, AIRFRAME = "soak", "d1", "m100"
AUTOPILOTS = ("px4", "ardupilot")
BOOT_LIMIT_S = 60.0
ANSWERS_S = 1.0
"""Between standby and a flight the companion opens its link anew: a request that the old one had is
lost, and the world waits and asks again."""

ASK_AGAIN_S = 1.0
FLIGHT_LIMIT_S = 300.0
"""From assignment to standing by again; untroubled 110 to 170 s."""

SAMPLE_S = 60.0
WARM_FLIGHTS = 2
"""Both autopilots' code is loaded, buffers have their size."""

MOST_MB = 250.0
"""Of memory, as docs/results/speed-and-size.md asks of a flight."""

MOST_SLOPE_MB_PER_H = 2.0
"""Of memory at standby, after the warm-up: a week of it fits into the smallest Raspberry Pi."""

MOST_GROWTH_MB = 10.0
"""The same where the trial is too short for a slope: a flight's telemetry, kept, takes as much."""

SLOPE_FROM_H = 2.0
MOST_DISK_MB_PER_FLIGHT_H = 100.0
MOST_DISK_MB_PER_H = 1.0
"""Beside the flights: events and commands."""

MORE_FILES = 2
"""Open at standby, more than after the warm-up: none is expected; zenoh opens one to reconnect."""


class SoakCase(msgspec.Struct, frozen=True, kw_only=True):
    """How long, and how often a flight is assigned."""

    seed: int
    hours: float
    every_minutes: float

    @property
    def name(self) -> str:
        """Names folder and case file."""
        return f"soak-seed{self.seed}-{self.hours:g}h"


@dataclass(frozen=True, slots=True)
class SoakSample:
    """What the process holds at a simulated time; `flights` are over, `stands_by` between them."""

    t_s: float
    memory_mb: float
    files: int
    threads: int
    disk_mb: float
    flights: int
    stands_by: bool


@dataclass(slots=True)
class SoakDesk:
    """Assigns one flight after the other and launches each."""

    ears: ZenohFleet
    flight: dict[str, Any]
    state: State | None = None
    _wanted: tuple[str, Deed] | None = None
    _asked_s: float | None = None

    def assign(self, number: int) -> None:
        """Have this flight flown."""
        deed = Assign(assignment=f"a{number}", order=f"o{number}", flight=self.flight)
        self._wanted = (f"assign-{number}", deed)

    def turn(self) -> None:
        """Hear, and ask for what is wanted until that is answered."""
        for heard in self.ears.receive(0.0):
            if isinstance(heard, StateReceived):
                self.state = heard.state
            elif isinstance(heard, CommandAnswered):
                self._answered(heard)
        if self._wanted is None or self.state is None:
            return
        if isinstance(self._wanted[1], Launch) and self.state.phase != "ready":
            return
        if self._asked_s is None or wall_s() - self._asked_s >= ASK_AGAIN_S:
            self._asked_s = wall_s()
            self._send(*self._wanted, self.state)

    def _answered(self, heard: CommandAnswered) -> None:
        if self._wanted is None or heard.command_id != self._wanted[0] or heard.result is None:
            return
        deed, taken = self._wanted[1], heard.result.answer.value
        if taken == "done":
            launch = Launch(assignment=deed.assignment) if isinstance(deed, Assign) else None
            self._wanted = launch and (f"launch-{launch.assignment}", launch)
        elif taken == "refused":
            raise LeewayError(f"soak: {heard.command_id} was refused: {heard.result.reason}")

    def _send(self, name: str, deed: Deed, state: State) -> None:
        command = Command(
            id=name,
            vehicle=VEHICLE,
            life=state.life,
            as_of_s=state.uptime_s,
            by="soak",
            deed=deed,
        )
        self.ears.send(command, ASK_AGAIN_S)

    def stands_by(self) -> bool:
        """Nothing is wanted of it, and it says that it stands by."""
        known = self.state is not None and self.state.phase == "standby"
        return known and self._wanted is None


@dataclass(slots=True)
class Soak:
    """The world about one companion process."""

    case: SoakCase
    folder: Path
    endpoints: EndpointSet
    companion: CompanionProcess
    desk: SoakDesk
    flight_file: Path
    samples: list[SoakSample] = field(default_factory=list)
    ends: list[str] = field(default_factory=list)
    t_s: float = 0.0
    _craft: Craft | None = None
    _lockstep: Lockstep | None = None

    def go(self) -> str:
        """Until the time is up; what is wrong, empty where nothing is."""
        end_s = 3600.0 * self.case.hours
        for number in itertools.count(1):
            begun_s = self.t_s
            self._power_up(number)
            self.desk.assign(number)
            while not self._is_flown():
                if not self.companion.running:
                    return f"the companion ended with {self.companion.exit_code}"
                if self.t_s - begun_s > FLIGHT_LIMIT_S:
                    return f"flight {number} is not over after {FLIGHT_LIMIT_S:g} s"
                self._step()
            self.ends.append("down")
            until_s = min(begun_s + 60.0 * self.case.every_minutes, end_s)
            while self.t_s < until_s - 1e-6:
                self._step()
            self._sample()
            if self.t_s >= end_s - 1e-6:
                return ""
        return ""

    def _power_up(self, number: int) -> None:
        """A fresh pack: the autopilot boots, the companion is on a supply of its own."""
        options = FlyOptions(
            flight_file=self.flight_file,
            autopilot=AUTOPILOTS[number % 2],
            seed=self.case.seed + number,
            picture=False,
        )
        flight = read_flight(self.flight_file)
        wind_seed, vehicle_seed = np.random.SeedSequence(options.seed).spawn(2)
        wind, mean = read_wind(flight, self.flight_file, np.random.default_rng(wind_seed), None)
        folder = self.folder / "world"
        folder.mkdir(exist_ok=True)
        craft = build_craft(options, flight, wind, mean, 0, vehicle_seed, "fleet", folder)
        craft.operator.authorises = False
        craft.companion = self.companion
        first = self._lockstep is None
        self._lockstep = Lockstep(
            self.endpoints,
            [0],
            lambda _, t_ns: craft.ask(t_ns),
            limit_s=ANSWERS_S,
            is_alive=lambda _: self.companion.running,
        )
        self._craft = craft
        if self._lockstep.await_clients(1, BOOT_LIMIT_S).died:
            when = "come up" if first else "answer at standby"
            raise LeewayError(f"soak: the companion did not {when}: {self.companion.last_words()}")

    def _is_flown(self) -> bool:
        assert self._craft is not None
        down = self._craft.record.landed_s is not None
        return down and self.desk.stands_by()

    def _step(self) -> None:
        craft, lockstep = self._craft, self._lockstep
        assert craft is not None
        assert lockstep is not None
        self.t_s += STEP_S
        craft.advance(STEPS)
        t_ns = round(craft.t_s * 1e9)
        gathered = lockstep.exchange(t_ns)
        received = gathered.received
        if gathered.died and self.companion.running:
            received = received + lockstep.await_clients(t_ns, BOOT_LIMIT_S).received
        for _, datagram in received:
            craft.receive(datagram)
        self.desk.turn()
        if not self.samples or self.t_s - self.samples[-1].t_s >= SAMPLE_S:
            self._sample()

    def _sample(self) -> None:
        pid = self.companion.pid
        if pid is None:
            return
        process = Path("/proc") / str(pid)
        pages = int((process / "statm").read_text().split()[1])
        self.samples.append(
            SoakSample(
                t_s=self.t_s,
                memory_mb=pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
                files=len(list((process / "fd").iterdir())),
                threads=len(list((process / "task").iterdir())),
                disk_mb=_size_mb(self.companion.run_dir),
                flights=len(self.ends),
                stands_by=self.desk.stands_by(),
            )
        )


def _size_mb(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


@dataclass(frozen=True, slots=True)
class SoakRunner:
    """Tries a case in a folder of its own under `run_root`."""

    run_root: Path

    def __call__(self, case: SoakCase) -> list[TrialRow]:
        """Try one."""
        return [attempt(case, self.run_root / case.name)]


def attempt(case: SoakCase, folder: Path) -> TrialRow:
    """Soak and judge; where all held, only the samples are told."""
    LEAVES_AT_ONCE.set()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    write_network(folder, relayed=False)
    flight_file = write_flight(folder / "flight.toml", FLIGHT)
    ears = ZenohFleet(FLEET, folder / ROUTER)
    endpoints = EndpointSet(["udpin:127.0.0.1:0"])
    companion = _companion(folder, endpoints.urls[0])
    desk = SoakDesk(ears, _flown_table(flight_file))
    soak = Soak(case, folder, endpoints, companion, desk, flight_file)
    try:
        companion.start()
        why = soak.go()
    finally:
        companion.end()
        endpoints.close()
        ears.close()
    words = (companion.run_dir / "companion.out").read_text(errors="replace")
    why = why or ("an exception" if TRACEBACK in words else "") or wrong(soak.samples, case.hours)
    if not why:
        shutil.rmtree(folder)
    told = figures(soak.samples, case.hours)
    return TrialRow(name=case.name, held=not why, why=why, told=told, case=case)


def _companion(folder: Path, url: str) -> CompanionProcess:
    return CompanionProcess(
        run_dir=folder / VEHICLE,
        arguments=[
            f"--link=udpout:127.0.0.1:{url.rsplit(':', 1)[1]}",
            f"--airframe={AIRFRAME}",
            f"--fleet={FLEET}",
            f"--vehicle={VEHICLE}",
            f"--zenoh={folder / MEMBER}",
            "--configure",
        ],
    )


def _flown_table(path: Path) -> dict[str, Any]:
    """The flight as a desk sends it: without the truth's wind."""
    table = msgspec.toml.decode(path.read_bytes())
    return {key: value for key, value in table.items() if key != "wind"}


def settled(samples: list[SoakSample]) -> list[SoakSample]:
    """At standby, after the warm-up."""
    return [one for one in samples if one.stands_by and one.flights >= WARM_FLIGHTS]


def figures(samples: list[SoakSample], hours: float) -> dict[str, Any]:
    """What was measured, rounded for people."""
    calm = settled(samples)
    if len(calm) < 2:
        return {"flights": samples[-1].flights if samples else 0}
    last = samples[-1]
    return {
        "hours": round(last.t_s / 3600.0, 3),
        "flights": last.flights,
        "memory_mb": round(max(one.memory_mb for one in samples), 1),
        "growth_mb": round(calm[-1].memory_mb - calm[0].memory_mb, 2),
        "slope_mb_per_h": round(slope_per_h(calm), 3) if hours >= SLOPE_FROM_H else None,
        "files": [calm[0].files, calm[-1].files],
        "threads": [calm[0].threads, calm[-1].threads],
        "disk_mb_per_flight": round(last.disk_mb / max(last.flights, 1), 2),
    }


def slope_per_h(samples: list[SoakSample]) -> float:
    """Of memory, in MB, by least squares."""
    times_h = np.array([one.t_s for one in samples]) / 3600.0
    return float(np.polyfit(times_h, [one.memory_mb for one in samples], 1)[0])


def wrong(samples: list[SoakSample], hours: float) -> str:
    """What is out of bounds; empty where nothing is."""
    calm = settled(samples)
    if len(calm) < 2:
        return f"only {samples[-1].flights if samples else 0} flights: too few to say"
    first, last = calm[0], calm[-1]
    found: list[str] = []
    peak_mb = max(one.memory_mb for one in samples)
    if peak_mb > MOST_MB:
        found.append(f"{peak_mb:.0f} MB of memory")
    if hours < SLOPE_FROM_H and last.memory_mb - first.memory_mb > MOST_GROWTH_MB:
        found.append(f"memory grew from {first.memory_mb:.1f} to {last.memory_mb:.1f} MB")
    if hours >= SLOPE_FROM_H and slope_per_h(calm) > MOST_SLOPE_MB_PER_H:
        found.append(f"memory grows by {slope_per_h(calm):.2f} MB/h")
    if last.files > first.files + MORE_FILES:
        found.append(f"{last.files} open files after {first.files}")
    if last.threads > first.threads:
        found.append(f"{last.threads} threads after {first.threads}")
    most_mb = (
        last.flights * FLIGHT_LIMIT_S / 3600.0 * MOST_DISK_MB_PER_FLIGHT_H
        + last.t_s / 3600.0 * MOST_DISK_MB_PER_H
    )
    if last.disk_mb > most_mb:
        found.append(f"{last.disk_mb:.0f} MB on disk after {last.flights} flights")
    return "; ".join(found)
