"""`sim-bridge research bench flight`: how fast, how light; figures, never a test.

Each figure is the median of `rounds` runs with its least and greatest, since machines are noisy;
`make fly` on a fresh clone is timed once.
"""

import math
import os
import shutil
import subprocess
import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from rich.console import Console
from rich.table import Table

from companion.adapters.files.params import params_dir
from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.app.faults.host import slow_fsync
from sim_bridge.app.flight.fly import FlyOptions, Progress, fly
from sim_bridge.app.flight.report import slim_table
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.research.benchmarks.timing import Samples

AUTOPILOTS = ("px4", "ardupilot")
PROMPT = ("ms", "< 20")
"""What is asked of a command: a fifth of a tick of 0.1 s."""

SLOW_SYNC_S = 3.0
"""A card that is busy; 0.5 to 10 s were seen."""

FLEET = 20
FLEET_SECONDS_S = 90.0
REAL_TIME_SECONDS_S = 120.0  # take-off, measuring the wind, the way out
SOLO_SECONDS_S = 300.0
WARM_UP_S = 5.0
MEMORY_EVERY_S = 1.0


@dataclass(slots=True)
class _Meter(Progress):
    """Stops a run after some simulated time and notes what it took."""

    until_s: float = 60.0
    began_wall_s: float | None = None
    began_t_s: float = 0.0
    ended_t_s: float = 0.0
    ended_wall_s: float = 0.0
    exchanges_s: list[float] = field(default_factory=list)
    cpu_s: float = 0.0
    rss_mb: float = 0.0
    _looked_t_s: float = 0.0
    _cpu_at_start_s: float = 0.0
    _process: psutil.Process | None = None

    def update(self, crafts: list[Craft], t_s: float) -> None:
        now = wall_s()
        if self.began_wall_s is None and t_s >= WARM_UP_S:
            self.began_wall_s, self.began_t_s = now, t_s
            self.exchanges_s.clear()
            pid = crafts[0].companion.pid
            self._process = psutil.Process(pid) if pid else None
            self._cpu_at_start_s = self._cpu()
        self.ended_wall_s, self.ended_t_s = now, t_s
        if t_s - self._looked_t_s >= MEMORY_EVERY_S:
            self._looked_t_s = t_s
            self._look()

    def _look(self) -> None:
        """CPU and memory so far; what cannot be read any more keeps its last figure."""
        if self._process is None:
            return
        with suppress(psutil.Error):
            self.cpu_s = self._cpu() - self._cpu_at_start_s
            self.rss_mb = max(self.rss_mb, self._process.memory_info().rss / 1e6)

    def exchanged(self, wall_s: float) -> None:
        self.exchanges_s.append(wall_s)

    def goes_on(self, t_s: float) -> bool:
        return t_s < self.until_s

    def _cpu(self) -> float:
        """Seconds of CPU of the companion so far; it never falls, also when it has ended."""
        if self._process is None:
            return 0.0
        times = self._process.cpu_times()
        return max(times.user + times.system, self._cpu_at_start_s + self.cpu_s)

    @property
    def wall(self) -> float:
        """Wall seconds from the warm-up's end."""
        return self.ended_wall_s - (self.began_wall_s or self.ended_wall_s)

    @property
    def times_real(self) -> float:
        """Simulated over wall seconds, after the warm-up."""
        return (self.ended_t_s - self.began_t_s) / max(self.wall, 1e-9)

    @property
    def exchange_p99_ms(self) -> float:
        """99th percentile from a step's telemetry to the companion's answer with its commands."""
        ordered = sorted(self.exchanges_s)
        return 1e3 * ordered[min(int(0.99 * len(ordered)), len(ordered) - 1)]


def bench(rounds: int, console: Console, *, fresh_clone: bool = True) -> dict[str, Any]:
    """Run all benchmarks; prints a table and returns its rows."""
    rows: list[tuple[str, list[float], str, str]] = []
    for autopilot in AUTOPILOTS:
        what = f"one vehicle, {autopilot}, one core"
        meters = _measure(rounds, console, what, autopilot, 1, None)
        speeds = [m.times_real for m in meters]
        rows.append((f"{autopilot} and companion, one core", speeds, "x", ">= 20"))
    meters = _measure(rounds, console, f"{FLEET} vehicles, two cores", "mixed", FLEET, None)
    rows.append(
        (
            f"{FLEET} of both, two cores",
            [m.times_real for m in meters],
            "x",
            ">= 1",
        )
    )
    for autopilot in AUTOPILOTS:
        meters = _measure(rounds, console, f"{autopilot} at real time", autopilot, 1, 1.0)
        loads = [100.0 * m.cpu_s / m.wall for m in meters]
        rows.append((f"companion at real time, {autopilot}", loads, "%", "< 5"))
        rows.append(("  its memory", [m.rss_mb for m in meters], "MB", "< 250"))
        rows.append(("  telemetry to command p99", [m.exchange_p99_ms for m in meters], *PROMPT))
    rows += slow_disk(rounds, console)
    if fresh_clone:
        rows.append(("make fly, fresh clone", [_fresh_clone_s(console)], "s", "< 180"))
    console.print(_table(rounds, rows))
    return {"rows": [{"what": w, "values": v, "unit": u, "goal": g} for w, v, u, g in rows]}


def slow_disk(rounds: int, console: Console) -> list[tuple[str, list[float], str, str]]:
    """Telemetry to command at real time where each sync of the disk takes 3 s.

    Lockstep's companion keeps its checkpoints by a thread, as on a vehicle.
    """
    rows: list[tuple[str, list[float], str, str]] = []
    for autopilot in AUTOPILOTS:
        what = f"{autopilot} at real time, the disk takes {SLOW_SYNC_S:.0f} s to sync"
        slow = slow_fsync(SLOW_SYNC_S)
        meters = _measure(rounds, console, what, autopilot, 1, 1.0, before_companion=slow)
        words = f"the same p99, disk syncs in {SLOW_SYNC_S:.0f} s, {autopilot}"
        rows.append((words, [m.exchange_p99_ms for m in meters], *PROMPT))
    return rows


def _table(rounds: int, rows: list[tuple[str, list[float], str, str]]) -> Table:
    table = slim_table(
        f"median of {rounds}; x: times real time, %: of one core",
        ("what", "left"),
        ("median", "right"),
        ("least to most", "right"),
        ("goal", "left"),
        ("met", "left"),
    )
    for what, values, unit, goal in rows:
        each = Samples.of(values)
        met = "yes" if _is_met(each.median, goal) else "NO"
        table.add_row(what, f"{each.median:.1f}", each.spread(), f"{goal} {unit}", met)
    return table


def _is_met(value: float, goal: str) -> bool:
    sign, limit = goal.split()
    return value >= float(limit) if sign == ">=" else value < float(limit)


def _fresh_clone_s(console: Console) -> float:
    """Wall seconds of `make fly` on a clone of what is committed; NaN where it did not work."""
    console.print("make fly on a fresh clone ...")
    git = shutil.which("git")
    make = shutil.which("make")
    if git is None or make is None:
        return math.nan
    with tempfile.TemporaryDirectory() as folder:
        clone = [git, "clone", "--quiet", str(Path(__file__).parents[3]), folder]
        began_s = wall_s()
        done = subprocess.run(clone, check=False).returncode == 0
        done = done and subprocess.run([make, "-C", folder, "fly"], check=False).returncode == 0
        return wall_s() - began_s if done else math.nan


def _measure(
    rounds: int,
    console: Console,
    what: str,
    autopilot: str,
    vehicles: int,
    speedup: float | None,
    *,
    before_companion: str = "",
) -> list[_Meter]:
    cores = os.sched_getaffinity(0)
    if speedup is None:
        os.sched_setaffinity(0, sorted(cores)[: 1 if vehicles == 1 else 2])
    until_s = SOLO_SECONDS_S if vehicles == 1 else FLEET_SECONDS_S
    until_s = REAL_TIME_SECONDS_S if speedup is not None else until_s
    meters: list[_Meter] = []
    try:
        for index in range(rounds):
            console.print(f"{what}: run {index + 1} of {rounds} ...", highlight=False)
            meter = _Meter(until_s=until_s)
            with tempfile.TemporaryDirectory() as folder:
                options = FlyOptions(
                    flight_file=params_dir() / "flights" / "default.toml",
                    autopilot=autopilot,
                    seed=index + 1,
                    vehicles=vehicles,
                    speedup=speedup,
                    run_root=Path(folder),
                    picture=False,
                    before_companion=before_companion,
                )
                fly(options, meter)
            meters.append(meter)
    finally:
        os.sched_setaffinity(0, cores)
    return meters
