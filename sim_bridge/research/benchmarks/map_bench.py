"""`sim-bridge research bench map`: what the live map costs with many drones and orders.

Feed, stream and server are the product's, over a store on the disk; the drones' states come as
bytes and are decoded, without a network in between. Windows are processes of their own that read
all they are sent; the figures are of the map's process.
"""

import json
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

from companion.adapters.clock import epoch_us, wall_s
from companion.core.base.errors import LeewayError
from companion.fleet.messages import Refused, State, decode_state, encode
from ground_station.adapters.clock import WallClock
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.web.map_server import MapAnswers, MapServer
from ground_station.app.map.fleet_ear import FleetEar
from ground_station.app.map.map_feed import MapFeed
from ground_station.app.map.map_view import MapView
from ground_station.core.fleet.fleet_link import FleetInput, LivelinessChanged, StateReceived
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.orders import Order
from sim_bridge.research.map_pages.chromium import page
from sim_bridge.research.map_pages.frame_rate import FrameRate, frame_rate

WARM_S = 3.0
GATHER_S = 0.05
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
    on average. `at_rest`, `moving`: frames of one more window, a headless Chromium's, if asked for.
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
    at_rest: FrameRate | None = None
    moving: FrameRate | None = None


class BenchLink:
    """Every drone says its state once a second, all of them evenly over it."""

    def __init__(self, drones: int, rng: np.random.Generator) -> None:
        self._drones, self._rng = drones, rng
        self._began_s, self._said = wall_s(), 0
        self._joined, self._pause = False, threading.Event()

    def receive(self, wait_s: float) -> list[FleetInput]:
        """What is due; waits this long for it at most."""
        self._pause.wait(min(wait_s, GATHER_S))
        found: list[FleetInput] = [] if self._joined else list(self._lives())
        self._joined = True
        due = int((wall_s() - self._began_s) * self._drones)
        found += [StateReceived(self._state(n)) for n in range(self._said, due)]
        self._said = due
        return found

    def ask_states(self, wait_s: float) -> None:
        """They come anyhow."""

    def _lives(self) -> Iterator[FleetInput]:
        yield from (LivelinessChanged(f"d{k}", f"l{k}", True) for k in range(self._drones))

    def _state(self, number: int) -> State:
        turn, k = divmod(number, self._drones)
        north, east, speed = self._rng.normal(size=3).tolist()
        state = State(
            vehicle=f"d{k}", life=f"l{k}", uptime_s=float(turn), epoch_us=epoch_us(),
            airframe="m100", max_payload_kg=1.0, phase="outbound", log="l", last_seq=0, armed=True,
            assignment=f"o{k}.1", order=f"o{k}", lat_deg=55.0 + k / 2000.0 + 1e-4 * turn,
            lon_deg=8.0 + 1e-4 * turn, height_rel_m=40.0, ground_speed_mps=9.0 + abs(speed),
            energy_left_wh=60.0 - 0.1 * turn, margin_wh=20.0 - 0.1 * turn, p_home=0.999,
            p_home_now=0.9999, p_success=0.99, wind_to_n_mps=north, wind_to_e_mps=4.0 + east,
            text="going",
        )  # fmt: skip
        told = decode_state(encode(state))
        if isinstance(told, Refused):
            raise LeewayError(told.reason)
        return told


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
        store = _store(folder, orders, drones, rng)
        held.callback(store.close)
        clock = WallClock()
        ear = FleetEar(BenchLink(drones, rng), clock, FleetStatus())
        feed = MapFeed(MapView("bench"), ear, store, clock)
        server = MapServer("127.0.0.1", 0)
        held.callback(server.close)
        server.serve(MapAnswers(feed.stream, feed.history, feed.reach))
        for _ in range(windows):
            held.enter_context(_window(f"http://127.0.0.1:{server.port}/events"))
        _turn(feed, WARM_S)
        load = _measured(feed, (drones, orders, windows), seconds)
        if in_browser:
            load = _with_frames(load, feed, f"http://127.0.0.1:{server.port}/", seconds)
    Console().print(_words(load), highlight=False)
    if json_file is not None:
        json_file.write_text(json.dumps(asdict(load), indent=1) + "\n")
    return load


def _store(folder: Path, orders: int, drones: int, rng: np.random.Generator) -> Store:
    store = Store(Database(f"sqlite:///{folder}/desk.db", durable=False), epoch_us)
    places = rng.uniform(0.0, 0.1, size=(orders, 2))
    store.add_orders(
        [
            Order(id=f"o{k}", lat_deg=55.0 + lat, lon_deg=8.0 + lon, alt_amsl_m=1.0, mass_kg=0.5)
            for k, (lat, lon) in enumerate(places.tolist())
        ]
    )
    for k in range(min(drones, orders)):
        store.assign(f"o{k}", f"d{k}", {"format": "flight/1"}, None, "bench")
    return store


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


def _measured(feed: MapFeed, size: tuple[int, int, int], seconds: float) -> MapLoad:
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
    )


def _with_frames(load: MapLoad, feed: MapFeed, address: str, seconds: float) -> MapLoad:
    with _turned_beside(feed), page(address, viewport=WINDOW_PX) as window:
        window.wait_for_timeout(1000.0 * WARM_S)
        at_rest = frame_rate(window, seconds, moving=False)
        return replace(load, at_rest=at_rest, moving=frame_rate(window, seconds, moving=True))


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
    frames = {"at rest": load.at_rest, "moved": load.moving}
    return "".join(
        f"; {name} {rate.frames_hz:.1f} frames/s, {rate.task_ms:.0f} ms of work each,"
        f" at most {rate.longest_ms:.0f} ms apart"
        for name, rate in frames.items()
        if rate is not None
    )


def _words(load: MapLoad) -> str:
    return (
        f"{load.drones} drones, {load.orders} orders, {load.windows} windows:"
        f" {load.core_pct:.1f} % of a core at {load.pictures_hz:.1f} pictures/s;"
        f" whole {load.whole_kb:.0f} kB, change {load.change_kb:.1f} kB;"
        f" {load.memory_mb:.0f} MB of memory{_frame_words(load)}"
    )
