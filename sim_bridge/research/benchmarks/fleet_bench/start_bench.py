"""A desk with a full store: how long `order import` and `ground-station dispatch` take to begin.

The programs are the product's, as processes; the drones are members without a flight behind them,
each at its place about the depot.
"""

import csv
import json
import math
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.adapters.clock import epoch_us, wall_s
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.schema.orders import AssignmentState
from sim_bridge.adapters.endpoint import free_tcp_port
from sim_bridge.research.benchmarks.fleet_bench.processes import (
    BenchProcess,
    desk_config,
    member_config,
)

FLEET = "bench"
DEPOT = (55.47, 8.45, 12.0)
RADIUS_M = 2500.0
"""Orders lie within this of the depot, drawn evenly over the area."""

STANDS_M = 28.0
"""Drones stand within this of the depot: the desk knows a drone on its pad by that."""

A_PROCESS = 50
LIMIT_S = 300.0
LOOK_S = 0.1
BUSY_S = 30.0
"""How long the desk is watched after its first assignment."""

DAY = """\
format = "day/1"
name = "bench"
fleet = "bench"
orders = ["orders.csv"]
[depot]
lat_deg = {lat}
lon_deg = {lon}
alt_amsl_m = {alt}
[truck]
speed_mps = 8.0
detour_factor = 1.3
capacity_kg = 800.0
[forecast]
speed_mps = 4.0
from_deg = 80.0
std_mps = 2.0
"""


@dataclass(frozen=True, slots=True)
class Begun:
    """Seconds of the clock: the import, and from the start of `dispatch` until its first assignment
    is in the store and until a drone has taken it; assignments within `busy_s` after the first.
    """

    orders: int
    drones: int
    busy_s: float
    import_s: float
    first_s: float
    taken_s: float
    assigned: int


def bench(orders: int, drones: int, seed: int, busy_s: float = BUSY_S) -> Begun:
    """One run. Raises LeewayError where a program ends by itself, or nothing is assigned."""
    with tempfile.TemporaryDirectory(prefix="leeway-bench-") as name:
        folder = Path(name)
        _write_day(folder, orders, drones, seed)
        url, port = f"sqlite:///{folder}/desk.db", free_tcp_port()
        begun_s = wall_s()
        _call(folder, "order", "import", "day.toml", "--store", url)
        import_s = wall_s() - begun_s
        desk_config(folder, 0, [port], calls=False)
        members = _members(folder, drones, seed, port)
        words = ("dispatch", "day.toml", "--store", url, "--zenoh", "desk-0.json5", "--auto-launch")
        begun_s = wall_s()
        desk = subprocess.Popen(_argv(*words), cwd=folder, env=_env(), stdout=subprocess.DEVNULL)
        try:
            first_s, taken_s, assigned = _watch(url, desk, begun_s, busy_s)
        finally:
            desk.kill()
            desk.wait()
            for member in members:
                member.kill()
    return Begun(orders, drones, busy_s, import_s, first_s, taken_s, assigned)


def _watch(
    url: str, desk: "subprocess.Popen[bytes]", begun_s: float, busy_s: float
) -> tuple[float, float, int]:
    """When the first was assigned and taken, and how many there are `busy_s` later."""
    store = Store(Database(url), epoch_us)
    first_s = taken_s = None
    try:
        while wall_s() - begun_s < LIMIT_S:
            rows = store.assignments()
            now_s = wall_s() - begun_s
            if rows and first_s is None:
                first_s = now_s
            if taken_s is None and any(row.state is not AssignmentState.ORDERED for row in rows):
                taken_s = now_s
            if first_s is not None and taken_s is not None and now_s > first_s + busy_s:
                return first_s, taken_s, len(rows)
            try:
                desk.wait(LOOK_S)
            except subprocess.TimeoutExpired:
                continue
            raise LeewayError("the desk has ended by itself; see its words above")
    finally:
        store.close()
    raise LeewayError(f"no drone has taken an order within {LIMIT_S:.0f} s")


def _members(folder: Path, drones: int, seed: int, port: int) -> list[BenchProcess]:
    """All drones switched on: they call until the desk answers."""
    calls = member_config(folder, port)
    stands = folder / "stands.json"
    stands.write_text(json.dumps(_stands(drones)))
    members: list[BenchProcess] = []
    for first in range(0, drones, A_PROCESS):
        count = str(min(A_PROCESS, drones - first))
        times = (str(seed), "50", "70")
        members.append(
            BenchProcess.start(
                "members",
                FLEET,
                str(first),
                count,
                str(calls),
                str(folder),
                *times,
                "1.0",
                str(stands),
            )
        )
    for member in members:
        if member.hear(LIMIT_S) is None:
            raise LeewayError(f"a process of members did not begin within {LIMIT_S:.0f} s")
        member.say("join")
    return members


def _stands(drones: int) -> list[tuple[float, float]]:
    """Places spread evenly within `STANDS_M`, as a sunflower's seeds are."""
    turn = math.pi * (3.0 - math.sqrt(5.0))
    return [_place(STANDS_M * math.sqrt((k + 0.5) / drones), k * turn) for k in range(drones)]


def _place(far_m: float, turn_rad: float) -> tuple[float, float]:
    """Degrees of a place so far from the depot."""
    lat, lon, alt = DEPOT
    frame = LocalFrame(math.radians(lat), math.radians(lon), alt)
    ned_m = (far_m * math.cos(turn_rad), far_m * math.sin(turn_rad), 0.0)
    lat_rad, lon_rad, _ = frame.to_geodetic(ned_m)
    return math.degrees(lat_rad), math.degrees(lon_rad)


def _write_day(folder: Path, orders: int, drones: int, seed: int) -> None:
    lat, lon, alt = DEPOT
    fleet = "".join(f'[[drones]]\nid = "v{k}"\nairframe = "m100"\n' for k in range(drones))
    (folder / "day.toml").write_text(DAY.format(lat=lat, lon=lon, alt=alt) + fleet)
    rng = np.random.default_rng(seed)
    with (folder / "orders.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["id", "lat_deg", "lon_deg", "alt_amsl_m", "mass_kg"])
        for number in range(orders):
            far_m, turn_rad = RADIUS_M * math.sqrt(rng.uniform()), rng.uniform(0.0, math.tau)
            lat_deg, lon_deg = _place(far_m, turn_rad)
            mass_kg = rng.uniform(0.2, 0.6)
            table.writerow(
                [f"o{number}", f"{lat_deg:.7f}", f"{lon_deg:.7f}", alt, f"{mass_kg:.2f}"]
            )


def _call(folder: Path, *words: str) -> None:
    done = subprocess.run(_argv(*words), cwd=folder, env=_env(), capture_output=True, check=False)
    if done.returncode != 0:
        raise LeewayError(f"ground-station {' '.join(words)}: {done.stderr.decode().strip()}")


def _argv(*words: str) -> list[str]:
    return [sys.executable, "-c", "from ground_station.app.cli.main import main; main()", *words]


def _env() -> dict[str, str]:
    return os.environ | {"OMP_NUM_THREADS": "1"}
