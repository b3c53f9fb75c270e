"""Desk and driver's terminal as separate processes over zenoh; the desk is killed."""

import os
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest

from ground_station.adapters.files.day_files import write_day_plan
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.shift.days import begin_day
from ground_station.core.schema.orders import OrderState
from tests.fleet.zenoh_net import config_file, free_port
from tests.ground_station.hand_made_day import PLAN, stop

pytestmark = pytest.mark.timeout(240)

HARBOUR = Path(__file__).parents[3] / "params" / "days" / "harbour.toml"
PATIENCE_S = 120.0


def start(folder: Path, *arguments: str) -> "subprocess.Popen[str]":
    with (folder / f"{arguments[0]}.out").open("a") as out:
        return subprocess.Popen(
            [
                sys.executable,
                "-c",
                "from ground_station.app.cli.main import main; main()",
                *arguments,
            ],
            stdin=subprocess.PIPE if arguments[0] == "truck" else subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            cwd=folder,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            text=True,
        )


@pytest.mark.sample
def test_a_driver_with_the_enter_key_and_a_desk_that_is_killed_bring_the_day_home(tmp_path):
    text = HARBOUR.read_text().replace('no_fly = "../sites/harbour.geojson"\n', "")
    (tmp_path / "day.toml").write_text(text)
    rows = "H-1,55.4702,8.4460,13.0,4.0\nH-2,55.4712,8.4460,13.0,5.0\n"
    (tmp_path / "harbour_orders.csv").write_text("id,lat_deg,lon_deg,alt_amsl_m,mass_kg\n" + rows)
    stops = [
        stop("depot", 0.0, 0.0, 0.0),
        stop("stop-1", 300.0, 60.0, 200.0, ("H-1", "H-2")),
        stop("depot-end", 0.0, 300.0, 300.0),
    ]
    plan = msgspec.structs.replace(PLAN, stops=stops, sorties=[], makespan_s=300.0)
    write_day_plan(tmp_path / "plan.json", plan)
    port = free_port()
    config_file(tmp_path / "desk.json5", listen=port)
    config_file(tmp_path / "truck.json5", connect=port)
    url = f"sqlite:///{tmp_path}/desk.db"
    dispatch = (
        "dispatch", "day.toml", "--plan=plan.json", f"--store={url}", "--zenoh=desk.json5",
        "--until-done",
    )  # fmt: skip
    truck = start(tmp_path, "truck", "day.toml", "--zenoh=truck.json5")
    desk = start(tmp_path, *dispatch)
    store = Store(Database(url), lambda: 1)
    day = DayStore(store.database, lambda: 1)
    killed = False
    try:
        until_s = time.monotonic() + PATIENCE_S
        while desk.poll() is None:
            assert time.monotonic() < until_s, (tmp_path / "dispatch.out").read_text()[-3000:]
            assert truck.stdin is not None
            truck.stdin.write("\n")
            truck.stdin.flush()
            time.sleep(0.3)
            if not killed and day.last_ordered_truck_stop() == "stop-1":
                desk.kill()
                desk.wait()
                killed = True
                desk = start(tmp_path, *dispatch)
        assert killed
        assert desk.returncode == 0, (tmp_path / "dispatch.out").read_text()[-3000:]
        assert {row.state for row in store.orders()} == {OrderState.DELIVERED}
        assert [visit.stop for visit in day.truck_stop_visits()] == ["depot", "stop-1", "depot-end"]
    finally:
        for process in (truck, desk):
            process.kill()
            process.wait()
            if process.stdin is not None:
                process.stdin.close()
        store.close()


def test_a_running_desk_takes_a_spare_into_its_day_and_ends_with_the_day(tmp_path):
    url, zenoh = (
        f"sqlite:///{tmp_path}/desk.db",
        config_file(tmp_path / "z.json5", listen=free_port()),
    )
    desk = start(tmp_path, "dispatch", "harbour", f"--store={url}", f"--zenoh={zenoh}")
    words = ("hold", "d1", "--reason=motor", "--out-of-service", "--spare=d9", f"--store={url}")
    log = tmp_path / "dispatch.out"

    def until_dispatching(times: int) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while log.read_text().count("dispatching harbour") < times:
            assert desk.poll() is None, log.read_text()
            assert time.monotonic() < until_s, log.read_text()
            time.sleep(0.1)

    try:
        until_dispatching(1)
        assert start(tmp_path, *words).wait(PATIENCE_S) == 0
        until_dispatching(2)
        store = Store(Database(url), lambda: 1)
        begin_day(store.database, lambda: 1, "2999-01-01", "anna")
        assert desk.wait(PATIENCE_S) == 2  # it has the data of another day
        store.close()
        assert "a new day has begun while this desk ran" in log.read_text()
        again = start(
            tmp_path, "dispatch", "harbour", "--new-day", f"--store={url}", f"--zenoh={zenoh}"
        )
        assert again.wait(PATIENCE_S) == 2
        assert "the store's day is 2999-01-01: check the clock" in log.read_text()
    finally:
        desk.kill()
        desk.wait()
