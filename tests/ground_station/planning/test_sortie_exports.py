"""A day's sorties as files, each read by a library for its format: pads and customer match the plan
and the orders.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import gpxpy
import msgspec
import pytest

from companion.core.exports.export_format import ExportFormat
from ground_station.adapters.files.day_files import read_day
from ground_station.app.planning.sortie_missions import write_missions
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import initial_state

pytestmark = pytest.mark.usefixtures("compiled_planner")

VILLAGES = Path(__file__).parents[3] / "params" / "days" / "villages.toml"
EXACT_DEG = 2e-6
"""A fifth of a metre: the rounding of seven-digit coordinates and of a pad's survey."""

LatLon = tuple[float, float]
READ_WPL = """
import json, sys
from pymavlink import mavwp
loader = mavwp.MAVWPLoader()
loader.load(sys.argv[1])
print(json.dumps([[loader.wp(k).command, loader.wp(k).x, loader.wp(k).y]
                  for k in range(loader.count())]))
"""
WAYPOINT, LAND = 16, 21


@dataclass(frozen=True)
class Read:
    """Content of a file: start of the mission, customers passed, and landing positions."""

    start: LatLon
    passed: list[LatLon]
    landings: list[LatLon]


@pytest.fixture(scope="module")
def planned() -> tuple[DayData, DayPlan]:
    data = read_day(VILLAGES)
    plan = plan_day(data, initial_state(data), PlanParams(trials=30_000))
    elsewhere_first = sorted(plan.sorties, key=lambda sortie: sortie.launch == sortie.home)
    assert elsewhere_first[0].launch != elsewhere_first[0].home
    return data, msgspec.structs.replace(plan, sorties=elsewhere_first[:3])


def by_gpxpy(path: Path) -> Read:
    document = gpxpy.parse(path.read_text())
    out, home = document.routes
    customers = [mark for mark in document.waypoints if mark.type == "customer"]
    start, *passed, end = (
        (at.latitude, at.longitude) for at in (out.points[0], *customers, home.points[-1])
    )
    return Read(start, passed, [end])


def by_mavproxys_loader(path: Path) -> Read:
    words = [sys.executable, "-c", READ_WPL, str(path)]
    done = subprocess.run(words, env=os.environ | {"MAVLINK20": "1"}, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    (_, *home), *items = json.loads(done.stdout)
    passed = [(x, y) for command, x, y in items if command == WAYPOINT]
    landings = [(x, y) for command, x, y in items if command == LAND]
    return Read((home[0], home[1]), passed, landings)


READERS = {
    ExportFormat.GPX: by_gpxpy,
    ExportFormat.WPL: by_mavproxys_loader,
}


@pytest.mark.sample
@pytest.mark.parametrize("file_format", READERS)
def test_each_sorties_file_begins_at_its_pad_and_ends_at_the_pad_of_its_home(
    planned: tuple[DayData, DayPlan], tmp_path: Path, file_format: ExportFormat
) -> None:
    data, plan = planned
    assert write_missions(data, plan, tmp_path, file_format) == len(plan.sorties)
    orders = {order.id: (order.lat_deg, order.lon_deg) for order in data.orders}
    for sortie in plan.sorties:
        found = READERS[file_format](tmp_path / f"{sortie.order}{file_format.suffix}")
        pad, home = (
            pytest.approx((at.lat_deg, at.lon_deg), abs=EXACT_DEG)
            for at in (
                plan.get_stop(id_).pads[sortie.vehicle] for id_ in (sortie.launch, sortie.home)
            )
        )
        assert found.start == pad, sortie.order
        assert home in found.landings, sortie.order
        assert pytest.approx(orders[sortie.order], abs=EXACT_DEG) in found.passed, sortie.order
