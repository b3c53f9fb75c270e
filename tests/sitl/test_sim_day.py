"""A small day from orders to verdict: desk, truck, driver, both autopilots, in one process.

The plan is written by hand, so that the planner is not needed; the desk, its store, the companions'
loops, the truck's port and the simulated vehicles are those of every day.
"""

import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.core.base.location import Location
from companion.core.mission.flight_plan import depot_frame
from ground_station.adapters.files.day_files import read_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from sim_bridge.app.day.desk import SteppedDesk
from sim_bridge.app.day.faults import DayWorldOptions
from sim_bridge.app.day.fly import compute_day_inputs_digest, read_result_row_if_settings_match
from sim_bridge.app.day.run import DayOptions, fly_day_and_write_result

pytestmark = [pytest.mark.sample, pytest.mark.sitl, pytest.mark.timeout(240)]

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
    """Return a plan: the truck serves T-3 40 m away; both drones start and land there."""
    frame = depot_frame(data.day.depot.location)

    def place(north_m: float, east_m: float) -> Location:
        lat, lon, alt = frame.to_geodetic((north_m, east_m, 0.0))
        return Location(lat_deg=math.degrees(lat), lon_deg=math.degrees(lon), alt_amsl_m=alt)

    def sortie(order: str, vehicle: str, height_m: float) -> PlannedSortie:
        heights = {"outbound_height_m": height_m, "return_height_m": height_m}
        energy = {"energy_wh": 12.0, "required_wh": 20.0, "usable_wh": 90.0}
        return PlannedSortie(
            order=order, vehicle=vehicle, launch="stop-1", home="stop-1",
            launch_s=60.0, land_s=160.0, **heights, **energy,
        )  # fmt: skip

    pads = {"d1": place(15.0, 40.0), "d2": place(-15.0, 40.0)}
    stops = [
        PlannedStop(id="depot", location=place(0.0, 0.0), arrive_s=0.0, depart_s=0.0),
        PlannedStop(
            id="stop-1", location=place(0.0, 40.0), arrive_s=8.0, depart_s=170.0,
            serves=["T-3"], pads=pads,
        ),
        PlannedStop(id="depot-end", location=place(0.0, 0.0), arrive_s=178.0, depart_s=178.0),
    ]  # fmt: skip
    return DayPlan(
        format="day-plan/1", day="tiny", policy="by hand", seed=0, trials=0, makespan_s=178.0,
        stops=stops, sorties=[sortie("T-1", "d1", 20.0), sortie("T-2", "d2", 32.0)],
    )  # fmt: skip


def flown(folder: Path, limit_s: float) -> dict[str, Any]:
    """Fly the day with 5 % of messages lost and the desk killed once, up to a time."""
    (folder / "day.toml").write_text(DAY)
    (folder / "orders.csv").write_text(ORDERS)
    data = read_day(folder / "day.toml")
    run = folder / "run"
    wish = DayWorldOptions(loss=0.05, ground_kills=1)
    options = DayOptions("tiny", data, wish, 3, run, limit_s, "test")
    return fly_day_and_write_result(
        options,
        lambda built, where: SteppedDesk.start_truck_desk(
            built, planned(built.data), where, 0, 100
        ),
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
    """All messages of the desk, with their times, from the start until drones fly out."""
    until_s = 95.0
    again = flown(tmp_path, until_s)
    assert not again["ended"]
    first = (Path(row["run"]) / "desk.log").read_text().splitlines()
    second = (tmp_path / "run" / "desk.log").read_text().splitlines()
    assert any("take_off" in line for line in second)
    assert second == [line for line in first if float(line.split()[0]) < until_s]


def test_a_finished_day_is_known_by_what_decides_it_and_no_other_is(row):
    folder = Path(row["run"])
    assert read_result_row_if_settings_match(folder, "test") == msgspec.json.decode(
        (folder / "day.json").read_bytes()
    )
    assert read_result_row_if_settings_match(folder, "of another program") is None
    assert read_result_row_if_settings_match(folder.parent, "test") is None


def test_a_half_written_day_is_flown_again(row, tmp_path):
    whole = (Path(row["run"]) / "day.json").read_text()
    (tmp_path / "day.json").write_text(whole[: len(whole) // 2])
    assert read_result_row_if_settings_match(tmp_path, "test") is None


def test_what_decides_a_day_is_its_files_and_options(tmp_path):
    (tmp_path / "day.toml").write_text(DAY)
    (tmp_path / "orders.csv").write_text(ORDERS)
    settings = compute_day_inputs_digest(tmp_path / "day.toml", DayWorldOptions(), None)
    assert settings == compute_day_inputs_digest(tmp_path / "day.toml", DayWorldOptions(), None)
    assert settings != compute_day_inputs_digest(
        tmp_path / "day.toml", DayWorldOptions(loss=0.1), None
    )
    assert settings != compute_day_inputs_digest(tmp_path / "day.toml", DayWorldOptions(), 500)
    (tmp_path / "orders.csv").write_text(ORDERS.replace("0.4", "0.5"))
    assert settings != compute_day_inputs_digest(tmp_path / "day.toml", DayWorldOptions(), None)
