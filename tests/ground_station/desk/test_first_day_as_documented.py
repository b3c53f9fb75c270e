"""docs/how-to/dispatch.md as written: two simulated drones, each with a companion, get orders."""

import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store

pytestmark = [pytest.mark.night, pytest.mark.timeout(600)]

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "dispatch.md"
PATIENCE_S = 300.0


@pytest.fixture
def held() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def start(held: ExitStack, folder: Path, line: str) -> Path:
    """Run a line of the page in its own terminal; return the file of its output."""
    words = shlex.split(line, comments=True)
    path = folder / f"{len(list(folder.glob('*.out')))}-{words[0]}.out"
    out = held.enter_context(path.open("w"))
    process = subprocess.Popen(words, cwd=folder, stdout=out, stderr=subprocess.STDOUT)

    def stop() -> None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    held.callback(stop)
    return path


def test_both_drones_of_the_page_get_an_order_and_are_launched(tmp_path, held):
    text = PAGE.read_text()
    block = text.split("Two simulated drones on one machine", 1)[1].split("```")[1]
    for line in block.strip().splitlines():
        start(held, tmp_path, line)
    desk = start(held, tmp_path, "ground-station dispatch harbour")
    limit_s, confirmed = time.monotonic() + PATIENCE_S, set[str]()
    while len(confirmed) < 2 or "d1" not in desk.read_text():
        assert time.monotonic() < limit_s, "\n".join(
            f"{path.name}: {path.read_text()[-1500:]}" for path in sorted(tmp_path.glob("*.out"))
        )
        time.sleep(1.0)
        for line in desk.read_text().splitlines():
            order = line.partition("order launch ")[2].partition("`")[0]
            if "ready:" in line and order and order not in confirmed:
                confirm = ["ground-station", "order", "launch", order]
                subprocess.run(confirm, cwd=tmp_path, check=True, capture_output=True)
                confirmed.add(order)
    store = Store(Database(f"sqlite:///{tmp_path}/leeway-desk.db", create=False), lambda: 1)
    held.callback(store.close)
    limit_s = time.monotonic() + PATIENCE_S
    while {row.vehicle for row in store.assignments() if row.state.value == "flying"} != {
        "d1",
        "d2",
    }:
        assert time.monotonic() < limit_s, desk.read_text()[-3000:]
        time.sleep(1.0)
