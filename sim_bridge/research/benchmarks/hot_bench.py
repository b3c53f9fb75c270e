"""`sim-bridge research bench hot`: where the CPU of a simulated flight goes; figures, never a test.

Seconds of CPU, not of the clock: a busy machine changes them by some tenths, not by times.
"""

import json
import os
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from companion.adapters.files.params import params_dir
from sim_bridge.app.flight.fly import FlyOptions, Progress, fly
from sim_bridge.app.flight.report import slim_table
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.research.benchmarks.hot_meter import SIMULATOR, Spent, metered
from sim_bridge.research.benchmarks.timing import Samples

SECONDS_S = 180.0
"""Take-off, the way out with its looks at the gate, the drop, the way back."""

STARTS = {
    "python alone": "pass",
    "a companion": "import companion.app.cli.main, companion.app.cli.flying",
    "the simulator": "import sim_bridge.app.flight.fly",
}
"""What is started, and what that imports."""

METER = "from sim_bridge.research.benchmarks.hot_meter import meter_companion as meter"


@dataclass(slots=True)
class _Stop(Progress):
    """Ends a flight after some simulated time."""

    t_s: float = 0.0

    def update(self, crafts: list[Craft], t_s: float) -> None:
        self.t_s = t_s

    def goes_on(self, t_s: float) -> bool:
        return t_s < SECONDS_S


@dataclass(frozen=True, slots=True)
class _Figure:
    """One part: each round's milliseconds of CPU per simulated minute, and calls in it."""

    process: str
    part: str
    ms_per_min: Samples
    calls_per_min: float


def bench(rounds: int, autopilot: str, console: Console) -> dict[str, Any]:
    """Fly and start so many times; prints two tables and returns their rows."""
    starts = {
        name: Samples.of(_start_s(code) for _ in range(rounds)) for name, code in STARTS.items()
    }
    flights = [_fly(autopilot) for _ in range(rounds)]
    figures = [
        _figure(process, part, [flight[process][part] for flight in flights])
        for process, parts in flights[0].items()
        for part in parts
    ]
    console.print(_starts_table(rounds, starts))
    console.print(_parts_table(rounds, autopilot, figures))
    return {
        "starts": [{"what": name, "cpu_s": list(each.values)} for name, each in starts.items()],
        "parts": [
            {
                "process": each.process,
                "part": each.part,
                "cpu_ms_per_min": list(each.ms_per_min.values),
                "calls_per_min": each.calls_per_min,
            }
            for each in figures
        ],
    }


def _start_s(code: str) -> float:
    """Seconds of CPU, the system's included, from a process's start to its end."""
    pid = os.posix_spawn(sys.executable, [sys.executable, "-c", code], os.environ)
    _, _, used = os.wait4(pid, 0)
    return used.ru_utime + used.ru_stime


def _fly(autopilot: str) -> dict[str, dict[str, Spent]]:
    """What each process spent on one flight, per simulated minute."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spent.json"
        stop = _Stop()
        options = FlyOptions(
            flight_file=params_dir() / "flights" / "default.toml",
            autopilot=autopilot,
            run_root=Path(folder),
            picture=False,
            before_companion=f"{METER}; meter({str(path)!r})",
        )
        with metered(SIMULATOR) as simulator:
            fly(options, stop)
        rows = json.loads(path.read_text())
    companion = {part: Spent(*each) for part, each in rows.items()}
    minutes = stop.t_s / 60.0
    return {
        "simulator": _per_minute(simulator, minutes),
        "companion": _per_minute(companion, minutes),
    }


def _per_minute(spent: Mapping[str, Spent], minutes: float) -> dict[str, Spent]:
    return {
        part: Spent(round(each.calls / minutes), each.cpu_s / minutes)
        for part, each in spent.items()
    }


def _figure(process: str, part: str, spent: list[Spent]) -> _Figure:
    times = Samples.of((each.cpu_s for each in spent), 1e3)
    return _Figure(process, part, times, spent[0].calls)


def _starts_table(rounds: int, starts: Mapping[str, Samples]) -> Table:
    table = slim_table(
        f"starting a process, median of {rounds}",
        ("what", "left"),
        ("CPU s", "right"),
        ("least to most", "right"),
    )
    for name, each in starts.items():
        table.add_row(name, f"{each.median:.2f}", each.spread(2))
    return table


def _parts_table(rounds: int, autopilot: str, figures: list[_Figure]) -> Table:
    table = slim_table(
        f"CPU per simulated minute, {autopilot}, default flight, median of {rounds}",
        ("process", "left"),
        ("part", "left"),
        ("ms", "right"),
        ("least to most", "right"),
        ("calls", "right"),
        ("us a call", "right"),
    )
    for each in figures:
        calls, cost_us = "", ""
        if each.calls_per_min > 1:
            calls = f"{each.calls_per_min:,}"
            cost_us = f"{1e3 * each.ms_per_min.median / each.calls_per_min:,.0f}"
        table.add_row(
            each.process,
            each.part,
            f"{each.ms_per_min.median:,.0f}",
            each.ms_per_min.spread(0),
            calls,
            cost_us,
        )
    return table
