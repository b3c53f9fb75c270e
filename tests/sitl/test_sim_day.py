"""A small day from orders to verdict: desk, truck, driver, both autopilots, in one process.

The plan is written by hand, so that nothing of the planner is needed; the desk, its store, the
companions' loops, the truck's port and the simulated vehicles are those of every day.
"""

import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.core.base.place import Place
from companion.core.mission.flight_plan import frame_at
from ground_station.adapters.files.day_files import read_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from sim_bridge.app.day.build import here
from sim_bridge.app.day.desk import DeskHere
from sim_bridge.app.day.faults import DayWish
from sim_bridge.app.day.fly import finished, settings_of
from sim_bridge.app.day.run import DayOptions, fly_day

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(240)]

DAY = """
format = "day/1"
name = "tiny"
fleet = "tiny"
orders = ["orders.csv"]
[depot]
lat_deg = 55.47
lon_deg = 8.45
alt_amsl_m = 12.0
[truck]
deliver_s = 15.0
launch_s = 5.0
recover_s = 5.0
[mission]
cruise_height_m = 20.0
wind_settle_s = 4.0
[forecast]
speed_mps = 4.0
from_deg = 80.0
[[drones]]
id = "d1"
airframe = "m100"
[[drones]]
id = "d2"
airframe = "m100"
"""
ORDERS = """id,lat_deg,lon_deg,alt_amsl_m,mass_kg,service
T-1,55.4709,8.4500,12.0,0.4,drone
T-2,55.4691,8.4500,12.0,0.3,drone
T-3,55.4700,8.4506,12.0,6.0,truck
"""


def planned(data: DayData) -> DayPlan:
    """The truck serves T-3 forty metres off; both drones fly from there and land there."""
    frame = frame_at(data.day.depot.place)

    def place(north_m: float, east_m: float) -> Place:
        lat, lon, alt = frame.to_geodetic((north_m, east_m, 0.0))
        return Place(lat_deg=math.degrees(lat), lon_deg=math.degrees(lon), alt_amsl_m=alt)

    def sortie(order: str, vehicle: str, height_m: float) -> PlannedSortie:
        heights = {"outbound_height_m": height_m, "return_height_m": height_m}
        energy = {"energy_wh": 12.0, "sure_wh": 20.0, "usable_wh": 90.0}
        return PlannedSortie(
            order=order, vehicle=vehicle, launch="stop-1", home="stop-1",
            launch_s=60.0, land_s=160.0, **heights, **energy,
        )  # fmt: skip

    pads = {"d1": place(15.0, 40.0), "d2": place(-15.0, 40.0)}
    stops = [
        PlannedStop(id="depot", place=place(0.0, 0.0), arrive_s=0.0, depart_s=0.0),
        PlannedStop(
            id="stop-1", place=place(0.0, 40.0), arrive_s=8.0, depart_s=170.0,
            serves=["T-3"], pads=pads,
        ),
        PlannedStop(id="depot-end", place=place(0.0, 0.0), arrive_s=178.0, depart_s=178.0),
    ]  # fmt: skip
    return DayPlan(
        format="day-plan/1", day="tiny", policy="by hand", seed=0, trials=0, makespan_s=178.0,
        stops=stops, sorties=[sortie("T-1", "d1", 20.0), sortie("T-2", "d2", 32.0)],
    )  # fmt: skip


def flown(folder: Path, limit_s: float) -> dict[str, Any]:
    """The day with 5 % of messages lost and the desk killed once, so far."""
    (folder / "day.toml").write_text(DAY)
    (folder / "orders.csv").write_text(ORDERS)
    data = read_day(folder / "day.toml")
    run = folder / "run"
    wish = DayWish(loss=0.05, ground_kills=1)
    options = DayOptions("tiny", data, wish, 3, run, limit_s, "test", picture=False)
    return fly_day(
        options,
        here(wish.loss, run),
        lambda built, where: DeskHere.open(built, planned(built.data), where, 0, 100),
        lambda world: True,
    )


@pytest.fixture(scope="module")
def row(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return flown(tmp_path_factory.mktemp("day"), 600.0)


def test_a_day_with_a_lossy_network_and_a_killed_desk_delivers_all_and_loses_nobody(row):
    assert row["ended"]
    assert row["delivered"] == 3
    assert row["by_truck"] == 1
    assert row["undelivered"] == row["believed_otherwise"] == []
    assert (row["lost"], row["flown_twice"], row["promises_broken"]) == ([], [], [])
    assert row["messages"]["lost"] > 0
    assert row["what_went_wrong"][0].endswith("desk killed")


def test_both_autopilots_fly_at_once_and_planned_separation_holds(row):
    assert {f["autopilot"] for f in row["flights"]} == {"px4", "ardupilot"}
    assert row["separation_min_m"] >= 10.0


def test_its_row_is_in_its_folder(row):
    kept = msgspec.json.decode((Path(row["run"]) / "day.json").read_bytes())
    assert kept["flights"] == row["flights"]


def test_the_same_seed_is_the_same_day(row, tmp_path):
    """Everything that the desk says, with its times, from the start until drones fly out."""
    until_s = 95.0
    again = flown(tmp_path, until_s)
    assert not again["ended"]
    first = (Path(row["run"]) / "desk.log").read_text().splitlines()
    second = (tmp_path / "run" / "desk.log").read_text().splitlines()
    assert any("take_off" in line for line in second)
    assert second == [line for line in first if float(line.split()[0]) < until_s]


def test_a_finished_day_is_known_by_what_decides_it_and_no_other_is(row):
    folder = Path(row["run"])
    assert finished(folder, "test") == msgspec.json.decode((folder / "day.json").read_bytes())
    assert finished(folder, "of another program") is None
    assert finished(folder.parent, "test") is None


def test_a_half_written_day_is_flown_again(row, tmp_path):
    whole = (Path(row["run"]) / "day.json").read_text()
    (tmp_path / "day.json").write_text(whole[: len(whole) // 2])
    assert finished(tmp_path, "test") is None


def test_what_decides_a_day_is_its_files_and_options(tmp_path):
    (tmp_path / "day.toml").write_text(DAY)
    (tmp_path / "orders.csv").write_text(ORDERS)
    settings = settings_of(tmp_path / "day.toml", DayWish(), None)
    assert settings == settings_of(tmp_path / "day.toml", DayWish(), None)
    assert settings != settings_of(tmp_path / "day.toml", DayWish(loss=0.1), None)
    assert settings != settings_of(tmp_path / "day.toml", DayWish(), 500)
    (tmp_path / "orders.csv").write_text(ORDERS.replace("0.4", "0.5"))
    assert settings != settings_of(tmp_path / "day.toml", DayWish(), None)
