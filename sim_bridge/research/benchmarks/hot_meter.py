"""CPU of the parts that a flight spends its time in, counted inside the process that flies."""

import atexit
import functools
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from sim_bridge.adapters.wall_clock import cpu_s

SIMULATOR = {
    "simulator step": "sim_bridge.truth.vehicle:Vehicle.step",
    "autopilot step": "sim_bridge.autopilot.autopilot:Autopilot.step",
    "lockstep exchange": "sim_bridge.adapters.lockstep:Lockstep.exchange",
}
COMPANION = {
    "messages parsed": "companion.adapters.autopilots.codec:MavlinkCodec.parse",
    "pilot, all of it": "companion.core.pilot.pilot:Pilot.handle",
    "wind estimator update": "companion.core.wind.estimator:WindEstimator.update",
    "gate look": "companion.core.return_budget.budget:Gate.assess",
}
"""What a part is called, and the method that it is; each process's beside `WHOLE`."""

WHOLE = "whole process"


@dataclass(slots=True)
class Spent:
    """Calls of a part and their seconds of CPU, what they call included."""

    calls: int = 0
    cpu_s: float = 0.0


@contextmanager
def metered(parts: Mapping[str, str]) -> Iterator[dict[str, Spent]]:
    """Count these methods, and the whole process, until the end of the block."""
    spent = {name: Spent() for name in (*parts, WHOLE)}
    kept: list[tuple[type, str, Any]] = []
    began_s = cpu_s()
    try:
        for name, place in parts.items():
            owner, method = _method(place)
            kept.append((owner, method, getattr(owner, method)))
            setattr(owner, method, _counting(kept[-1][2], spent[name]))
        yield spent
    finally:
        spent[WHOLE] = Spent(1, cpu_s() - began_s)
        for owner, method, before in kept:
            setattr(owner, method, before)


def _method(place: str) -> tuple[type, str]:
    module, _, path = place.partition(":")
    owner, method = path.split(".")
    return getattr(import_module(module), owner), method


def _counting(method: Any, spent: Spent) -> Any:
    @functools.wraps(method)
    def counted(*args: Any, **kwargs: Any) -> Any:
        began_s = cpu_s()
        try:
            return method(*args, **kwargs)
        finally:
            spent.calls += 1
            spent.cpu_s += cpu_s() - began_s

    return counted


def meter_companion(path: str) -> None:
    """Count in this process, a companion that is imported, and at its end write that to a file."""
    import_module("companion.app.cli.flying")
    meter = metered(COMPANION)
    spent = meter.__enter__()

    def end() -> None:
        meter.__exit__(None, None, None)
        rows = {name: [each.calls, each.cpu_s] for name, each in spent.items()}
        Path(path).write_text(json.dumps(rows))

    atexit.register(end)
