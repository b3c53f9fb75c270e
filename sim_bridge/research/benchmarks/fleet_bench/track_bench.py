"""What drones over a town hear of one another: each of all, as before, and by grid cell.

Links and router are real; members are processes, and all share this machine.
"""

import contextlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import msgspec
import psutil

from companion.adapters.clock import wall_s
from companion.core.base.errors import LeewayError
from sim_bridge.adapters.endpoint import free_tcp_port
from sim_bridge.research.benchmarks.fleet_bench.processes import (
    BenchProcess,
    BenchRouter,
    member_config,
)
from sim_bridge.research.benchmarks.fleet_bench.track_flights import (
    TRACK_HZ,
    WARM_TICKS,
    TrackCounts,
    TrackFlights,
)

A_PROCESS = 25
LIMIT_S = 120.0
START_S = 3.0
"""From the word until they fly: every process has heard it by then."""


PATIENT = {"publication": [{"key_exprs": ["leeway/**"], "config": {"congestion_control": "block"}}]}
"""zenoh's settings of the drones: nothing is dropped where this machine is busy (a drone's own link
drops a track that does not leave within a millisecond). So what is missing was not listened to.
"""


@dataclass(frozen=True, slots=True)
class TracksHeard:
    """Of each drone, a second: messages, bytes (of payload), and of the drone that heard most,
    messages. `near_frac`: how much of what was told within a kilometre came. CPU in
    cores, with the load of the machine over the last minute.
    """

    by: str
    messages_hz: float
    most_messages_hz: float
    bytes_hz: float
    near_hz: float
    near_frac: float
    drones_cpu: float
    router_cpu: float
    load_of_machine: float


def bench(flights: TrackFlights, seconds: float) -> list[TracksHeard]:
    """Of all and by cell, over the same flights; of several fleets also by cell where each hears
    its own only.
    """
    ways = ["all", "cell"] if flights.fleets == 1 else ["all", "cell", "cell, own fleet"]
    return [_run(flights, seconds, how) for how in ways]


def _run(flights: TrackFlights, seconds: float, how: str) -> TracksHeard:
    ticks = round(seconds * TRACK_HZ)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="leeway-bench-")))
        router = BenchRouter(folder, free_tcp_port())
        stack.callback(router.process.kill)
        config = member_config(folder, router.port, qos=PATIENT)
        members: list[BenchProcess] = []
        for first in range(0, flights.drones, A_PROCESS):
            count = min(A_PROCESS, flights.drones - first)
            words = (first, count, flights.drones, flights.across_m, flights.seed, flights.fleets)
            words = (*words, config, ticks)
            members.append(BenchProcess.start("tracks", how, *map(str, words)))
            stack.callback(members[-1].kill)
        for member in members:
            if member.hear(LIMIT_S) is None:
                raise LeewayError(f"a process of drones did not begin in {LIMIT_S:.0f} s")
        begun_s = wall_s() + START_S
        for member in members:
            member.say(str(begun_s))
        counted_s = begun_s + WARM_TICKS / TRACK_HZ
        router.process.ends_within(counted_s - wall_s())
        before = _cpu_s(router.process), sum(map(_cpu_s, members))
        router.process.ends_within(seconds)
        after = _cpu_s(router.process), sum(map(_cpu_s, members))
        counts = [_told(member) for member in members]
    drone_seconds = flights.drones * seconds
    near_due = sum(one.near_due for one in counts)
    return TracksHeard(
        by=how,
        messages_hz=round(sum(one.messages for one in counts) / drone_seconds, 1),
        most_messages_hz=round(max(one.most for one in counts) / seconds, 1),
        bytes_hz=round(sum(one.payload_bytes for one in counts) / drone_seconds),
        near_hz=round(near_due / drone_seconds, 1),
        near_frac=round(sum(one.near for one in counts) / max(near_due, 1), 5),
        drones_cpu=round((after[1] - before[1]) / seconds, 2),
        router_cpu=round((after[0] - before[0]) / seconds, 2),
        load_of_machine=round(os.getloadavg()[0], 1),
    )


def _told(member: BenchProcess) -> TrackCounts:
    line = member.hear(LIMIT_S)
    if line is None:
        raise LeewayError("a process of drones has ended by itself")
    return msgspec.json.decode(line, type=TrackCounts)


def _cpu_s(process: BenchProcess) -> float:
    spent = psutil.Process(process.process.pid).cpu_times()
    return spent.user + spent.system
