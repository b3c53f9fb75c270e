"""`sim-bridge research map-picture`: the documents' picture of the map, from a simulated day."""

import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.params import day_file
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.past_store import PastStore
from ground_station.adapters.web.live_stream import LiveStream
from ground_station.adapters.web.map_server import MapAnswers, MapServer, PastAnswers
from ground_station.app.map.map_view import MapView
from ground_station.app.map.replay.past_folder import past_files
from ground_station.app.map.replay.replay_feed import ReplayFeed
from sim_bridge.research.map_pages.chromium import browser

DAY = "import sys; from sim_bridge.main import main; sys.argv[0] = 'sim-bridge'; main()"
STEP_US = 5_000_000
GO = """(t) => {
  const bar = document.querySelector('#time');
  bar.value = t;
  bar.dispatchEvent(new Event('input'));
}"""
SETTLE_MS = 2500.0
"""The page asks for history and reach every two seconds."""


def draw(day: str, seed: int, out: Path) -> str:
    """Fly the day, show it when most drones are in the air, and write the page as a PNG.

    Returns what is seen, in words. Raises LeewayError where day or browser fails.
    """
    with tempfile.TemporaryDirectory(prefix="leeway-map-") as folder:
        feed = ReplayFeed(*_flown(day, seed, Path(folder)))
        t_us, vehicle = _fullest(feed)
        past = PastAnswers(feed.span, feed.moment, feed.history, feed.reach)
        with closing(MapServer("127.0.0.1", 0)) as server, browser() as made:
            server.serve(MapAnswers(LiveStream(), lambda _: None, lambda _: None, None, past))
            window = made.new_context(
                viewport={"width": 1280, "height": 800},
                locale="en-GB",
                timezone_id="UTC",
                color_scheme="light",
            ).new_page()
            window.goto(f"{server.address}/#{vehicle}")
            window.wait_for_selector("#link.past")
            window.evaluate(GO, t_us)
            window.wait_for_timeout(SETTLE_MS)
            window.keyboard.press("f")
            window.wait_for_timeout(SETTLE_MS)
            window.screenshot(path=out)
            return f"{out}: {window.locator('#title').inner_text()}, {vehicle} selected"


def _flown(day: str, seed: int, folder: Path) -> tuple[MapView, PastStore, tuple]:
    options = [day, "--seed", str(seed), "--runs", str(folder), "--no-picture"]
    done = subprocess.run(
        [sys.executable, "-c", DAY, "day", *options], capture_output=True, text=True, check=False
    )
    runs = sorted(path.parent for path in folder.glob("*/desk.db"))
    if len(runs) != 1:
        raise LeewayError(f"map-picture: the day left no store: {done.stderr[-300:]}")
    data, files = read_day(day_file(day)), past_files(str(runs[0]))
    assert files.store is not None
    with closing(Database(files.store, create=False)) as database:
        store = PastStore(database)
    return MapView(data.day.fleet, data), store, files.records


def _fullest(feed: ReplayFeed) -> tuple[int, str]:
    """The middle of the time with the most drones in the air, and the first of them."""
    span = feed.span()
    flying = {
        t_us: sorted(k for k, v in feed.moment(t_us)["drones"].items() if v.get("armed"))
        for t_us in range(span["from_us"], span["to_us"], STEP_US)
    }
    most = max(len(names) for names in flying.values())
    if most == 0:
        raise LeewayError("map-picture: no drone flew on this day")
    times = [t_us for t_us, names in flying.items() if len(names) == most]
    middle_us = times[len(times) // 2]
    return middle_us, flying[middle_us][0]
