"""`sim-bridge research bench flight`: speed and memory; results only, not a test.

Each result is the median of `rounds` runs, with minimum and maximum to show machine noise.
"""

import os
import statistics
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from companion.adapters.files.params import params_dir
from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.app.flight.fly import FlyOptions, fly_vehicles_and_evaluate
from sim_bridge.app.flight.stage import Script
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.autopilot.kinds import AUTOPILOTS
from sim_bridge.research.study.run import ExperimentRun, Report
from sim_bridge.research.study.sheet import Column, Sheet, low_to_high

FLEET = 20
FLEET_SECONDS_S = 90.0
REAL_TIME_SECONDS_S = 120.0  # take-off, wind estimation, outbound route
SINGLE_VEHICLE_S = 300.0
STABILIZATION_S = 5.0
SAMPLE_INTERVAL_S = 1.0
MINUTE_3_S = (120.0, 180.0)
IMPORTS = (
    "import companion.app.cli.flying, companion.app.flight.run, time; print(time.process_time())"
)
"""Program that prints the CPU time of importing the flight modules."""


@dataclass(slots=True)
class _Meter(Script):
    """Stops a run after some simulated time and measures its resources."""

    until_s: float = 60.0
    start_wall_s: float | None = None
    start_t_s: float = 0.0
    ended_t_s: float = 0.0
    ended_wall_s: float = 0.0
    exchanges_s: list[float] = field(default_factory=list)
    cpu_s: float = 0.0
    rss_mb: float = 0.0
    private_mb: float = 0.0
    """Maximum unique set size (USS) in minute 3."""
    _sampled_t_s: float = 0.0
    _cpu_at_start_s: float = 0.0
    _process: psutil.Process | None = None

    def on_step_completed(self, crafts: list[Craft], t_s: float, reply_wall_s: float) -> None:
        now = wall_s()
        self.exchanges_s.append(reply_wall_s)
        if self.start_wall_s is None and t_s >= STABILIZATION_S:
            self.start_wall_s, self.start_t_s = now, t_s
            self.exchanges_s.clear()
            pid = crafts[0].companion.pid
            self._process = psutil.Process(pid) if pid else None
            self._cpu_at_start_s = self._companion_cpu_time_s()
        self.ended_wall_s, self.ended_t_s = now, t_s
        if t_s - self._sampled_t_s >= SAMPLE_INTERVAL_S and self._process is not None:
            self._sampled_t_s = t_s
            with suppress(psutil.Error):  # if the process has ended, keep the last values
                self.cpu_s = self._companion_cpu_time_s() - self._cpu_at_start_s
                self.rss_mb = max(self.rss_mb, self._process.memory_info().rss / 1e6)
                if MINUTE_3_S[0] <= t_s < MINUTE_3_S[1]:
                    private_mb = self._process.memory_full_info().uss / 1e6
                    self.private_mb = max(self.private_mb, private_mb)

    def should_continue(self, t_s: float) -> bool:
        return t_s < self.until_s

    def _companion_cpu_time_s(self) -> float:
        """Return the CPU time of the companion; it never decreases, even after exit."""
        if self._process is None:
            return 0.0
        times = self._process.cpu_times()
        return max(times.user + times.system, self._cpu_at_start_s + self.cpu_s)

    @property
    def _wall_duration_s(self) -> float:
        """Wall time since the end of the warm-up."""
        return max(self.ended_wall_s - (self.start_wall_s or self.ended_wall_s), 1e-9)

    @property
    def real_time_factor(self) -> float:
        """Simulated over wall seconds, after the warm-up."""
        return (self.ended_t_s - self.start_t_s) / self._wall_duration_s

    @property
    def load_percent(self) -> float:
        """CPU time of the companion over wall time, after the warm-up."""
        return 100.0 * self.cpu_s / self._wall_duration_s

    @property
    def exchange_p99_ms(self) -> float:
        """99th percentile of the time from telemetry to the companion's commands."""
        ordered = sorted(self.exchanges_s)
        return 1e3 * ordered[min(int(0.99 * len(ordered)), len(ordered) - 1)]


Row = tuple[str, list[float], str, str]
"""Measured quantity, one value per round, unit and goal."""


def run_flight_benchmarks(rounds: int, run: ExperimentRun) -> Report:
    """Run all benchmarks, with progress on stderr."""
    rows: list[Row] = []
    for autopilot in AUTOPILOTS:
        label = f"{autopilot} and companion, one core"
        meters = _measure_flights(rounds, run, label, autopilot, SINGLE_VEHICLE_S, cores=1)
        rows.append((label, [m.real_time_factor for m in meters], "x", ">= 20"))
        rows.append(("its private memory", [m.private_mb for m in meters], "MB", "< 55"))
    label = f"{FLEET} of both, two cores"
    meters = _measure_flights(rounds, run, label, "mixed", FLEET_SECONDS_S, FLEET, cores=2)
    rows.append((label, [m.real_time_factor for m in meters], "x", ">= 1"))
    for autopilot in AUTOPILOTS:
        label = f"companion at real time, {autopilot}"
        meters = _measure_flights(rounds, run, label, autopilot, REAL_TIME_SECONDS_S)
        rows += [
            (label, [m.load_percent for m in meters], "%", "< 5"),
            ("its memory", [m.rss_mb for m in meters], "MB", "< 250"),
            # Goal: a fifth of a tick of 0.1 s.
            ("telemetry to command p99", [m.exchange_p99_ms for m in meters], "ms", "< 20"),
        ]
    imports_s = [
        float(
            subprocess.run([sys.executable, "-c", IMPORTS], capture_output=True, check=True).stdout
        )
        for _ in range(rounds)
    ]
    rows.append(("companion's imports", imports_s, "s", "< 0.6"))
    document = {"rows": [{"what": w, "values": v, "unit": u, "goal": g} for w, v, u, g in rows]}
    return Report({"bench_flight": _build_result_sheet(rounds, rows)}, document)


def _build_result_sheet(rounds: int, rows: list[Row]) -> Sheet:
    columns: dict[str, Column] = {
        "what": "{0[0]}",
        "median": lambda row: f"{statistics.median(row[1]):.3g}",
        "least to most": lambda row: (
            low_to_high((min(row[1]), max(row[1])), ".3g") if len(row[1]) > 1 else ""
        ),
        "n": lambda row: str(len(row[1])),
        "goal": "{0[3]} {0[2]}",
        "met": lambda row: "yes" if _meets_goal(statistics.median(row[1]), row[3]) else "NO",
    }
    note = f"Median of {rounds} runs, seeds from 1 on. x: times real time; %: of one core."
    return Sheet.from_objects("Speed and size", rows, columns, note)


def _meets_goal(value: float, goal: str) -> bool:
    sign, limit = goal.split()
    return value >= float(limit) if sign == ">=" else value < float(limit)


def _measure_flights(
    rounds: int,
    run: ExperimentRun,
    label: str,
    autopilot: str,
    until_s: float,
    vehicles: int = 1,
    *,
    cores: int | None = None,
) -> list[_Meter]:
    """Fly as fast as so many cores allow; None: at real time on all of them."""
    all_cores = os.sched_getaffinity(0)
    meters = [_Meter(until_s=until_s) for _ in range(rounds)]
    try:
        os.sched_setaffinity(0, sorted(all_cores)[:cores])
        for seed, meter in enumerate(meters, start=1):
            run.print_message(f"{label}: run {seed} of {rounds} ...")
            with tempfile.TemporaryDirectory() as folder:
                options = FlyOptions(
                    flight_file=params_dir() / "flights" / "default.toml",
                    autopilot=autopilot,
                    seed=seed,
                    vehicles=vehicles,
                    speedup=1.0 if cores is None else None,
                    run_root=Path(folder),
                    picture=False,
                )
                fly_vehicles_and_evaluate(options, meter)
    finally:
        os.sched_setaffinity(0, all_cores)
    return meters
