"""`sim-bridge research bench map`: what the live map costs with many drones and orders.

Feed, stream and server are the product's, over a store on the disk; the drones' states come as
bytes and are decoded, without a network in between. Windows are processes of their own that read
all they are sent; the figures are of the map's process.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from companion.adapters.clock import wall_s
from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import WallClock
from ground_station.adapters.web.map_server import MapAnswers, MapServer
from ground_station.app.map.fleet_ear import FleetEar
from ground_station.app.map.map_feed import MapFeed
from ground_station.app.map.map_view import MapView
from ground_station.core.fleet.fleet_status import FleetStatus
from sim_bridge.research.benchmarks.map_bench_day import BenchLink, MapBenchDay
from sim_bridge.research.map_pages.chromium import page
from sim_bridge.research.map_pages.frame_rate import FrameRate, Motion, median_rate

WARM_S = 3.0
RUNS = 5
"""Of each motion; the median is told."""

WINDOW_PX = {"width": 1280, "height": 800}
WINDOW = """
import sys, urllib.request
with urllib.request.urlopen(sys.argv[1]) as stream:
    while stream.read1(65536):
        pass
"""


@dataclass(frozen=True, slots=True)
class MapLoad:
    """What was measured. `whole_kb`: the first event of a window; `change_kb`: one of the others,
    on average. `frames`: by motion, those of one more window, a headless Chromium's with a drone
    selected, if asked for; `core_with_browser_pct`: the map's own share meanwhile. `machine_load`:
    runnable processes over the last minute, before and after.
    """

    drones: int
    orders: int
    windows: int
    seconds: float
    core_pct: float
    pictures_hz: float
    whole_kb: float
    change_kb: float
    memory_mb: float
    machine_load: tuple[float, float]
    frames: dict[str, FrameRate] | None = None
    core_with_browser_pct: float | None = None


def bench(
    drones: int,
    orders: int,
    windows: int,
    seconds: float,
    seed: int,
    json_file: Path | None,
    in_browser: bool = False,
) -> MapLoad:
    """Measure, print, and write the figures. `in_browser`: the page's frames too, afterwards."""
    with ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="leeway-map-")))
        rng = np.random.default_rng(seed)
        day = MapBenchDay(folder, drones, orders, rng)
        held.callback(day.store.close)
        clock, load_before = WallClock(), os.getloadavg()[0]
        ear = FleetEar(BenchLink(day, rng), clock, FleetStatus(day.data.airframes))
        feed = MapFeed(MapView(day.data.day.fleet, day.data), ear, day.store, clock)
        server = MapServer("127.0.0.1", 0)
        held.callback(server.close)
        server.serve(MapAnswers(feed.stream, feed.history, feed.reach))
        for _ in range(windows):
            held.enter_context(_window(f"http://127.0.0.1:{server.port}/events"))
        _turn(feed, WARM_S)
        load = _measured(feed, (drones, orders, windows), seconds, load_before)
        if in_browser:
            load = _with_frames(load, feed, f"http://127.0.0.1:{server.port}/#{day.names[0]}")
    Console().print(_words(load), highlight=False)
    if json_file is not None:
        json_file.write_text(json.dumps(asdict(load), indent=1) + "\n")
    return load


@contextmanager
def _window(address: str) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", WINDOW, address])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _turn(feed: MapFeed, seconds: float) -> int:
    """Bytes of the changes that were published meanwhile."""
    until_s, sent, before = wall_s() + seconds, 0, feed.stream.frame
    while wall_s() < until_s:
        feed.turn()
        frame = feed.stream.frame
        if frame is not None and before is not None and frame is not before:
            sent += len(frame.since(before))  # made once, for the windows too
        before = frame
    return sent


def _measured(
    feed: MapFeed, size: tuple[int, int, int], seconds: float, load_before: float
) -> MapLoad:
    first = feed.stream.frame
    began_s, began_cpu_s = wall_s(), time.process_time()
    sent = _turn(feed, seconds)
    took_s, cpu_s = wall_s() - began_s, time.process_time() - began_cpu_s
    last = feed.stream.frame
    if first is None or last is None:
        raise LeewayError("bench map: nothing was published")
    pictures = last.number - first.number
    memory_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return MapLoad(
        *size,
        seconds=took_s,
        core_pct=100.0 * cpu_s / took_s,
        pictures_hz=pictures / took_s,
        whole_kb=len(last.whole) / 1e3,
        change_kb=sent / 1e3 / max(pictures, 1),
        memory_mb=memory_kb / 1024.0,
        machine_load=(load_before, os.getloadavg()[0]),
    )


def _with_frames(load: MapLoad, feed: MapFeed, address: str) -> MapLoad:
    with _turned_beside(feed), page(address, viewport=WINDOW_PX) as window:
        window.wait_for_selector("#detail svg")  # the selected drone's chart
        window.wait_for_timeout(1000.0 * WARM_S)
        began_s, began_cpu_s = wall_s(), time.process_time()
        frames = {one.value: median_rate(window, one, RUNS) for one in Motion}
        took_s, cpu_s = wall_s() - began_s, time.process_time() - began_cpu_s
        after = load.machine_load[0], os.getloadavg()[0]
        return replace(
            load,
            frames=frames,
            core_with_browser_pct=100.0 * cpu_s / took_s,
            machine_load=after,
        )


@contextmanager
def _turned_beside(feed: MapFeed) -> Iterator[None]:
    """The feed goes on in a thread of its own."""
    ended = threading.Event()

    def turn() -> None:
        while not ended.is_set():
            feed.turn()

    thread = threading.Thread(target=turn, name="feed")
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _frame_words(load: MapLoad) -> str:
    found = "".join(
        f"\n{name}: {rate.frames_hz:.1f} frames/s (of {RUNS} runs {rate.least_hz:.1f} to"
        f" {rate.most_hz:.1f}), {rate.main_ms:.0f} ms of CPU each,"
        f" {rate.page_ms:.0f} ms with raster"
        for name, rate in (load.frames or {}).items()
    )
    if load.core_with_browser_pct is not None:
        found += f"\nthe map meanwhile: {load.core_with_browser_pct:.1f} % of a core"
    return f"{found}\nload of the machine {load.machine_load[0]:.1f}, {load.machine_load[1]:.1f}"


def _words(load: MapLoad) -> str:
    return (
        f"{load.drones} drones, {load.orders} orders, {load.windows} windows:"
        f" {load.core_pct:.1f} % of a core at {load.pictures_hz:.1f} pictures/s;"
        f" whole {load.whole_kb:.0f} kB, change {load.change_kb:.1f} kB;"
        f" {load.memory_mb:.0f} MB of memory{_frame_words(load)}"
    )
