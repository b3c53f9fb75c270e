"""A day among geo-zones: planner obstacles, flight settings, and errors by row."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.app.map.site_shown import site_shown
from ground_station.core.dispatch.flight_tables import depot_delivery_flight_table
from ground_station.core.planning.day_problem import (
    layer_range_by_position,
    max_layer_height_m,
    obstacle_map,
)
from ground_station.core.schema.day import DayFilesError
from ground_station.core.schema.day_data import DayData

ROOT = Path(__file__).parents[3]
HOURS = 'from_utc = "2026-05-01T{}:00:00Z"\nuntil_utc = "2026-05-01T{}:00:00Z"\n'


STEEP = "{ kind = 'plane', slope_east_frac = 0.0228 }"


def day(
    folder: Path, zones: str | dict[str, Any], mission: str = "", terrain: str | None = "{}"
) -> DayData:
    """Read a small day with a zone file."""
    text = zones if isinstance(zones, str) else json.dumps(zones)
    (folder / "zones.json").write_text(text)
    (folder / "day.toml").write_text(
        'format = "day/1"\nno_fly = "zones.json"\n'
        "depot = { lat_deg = 55.47, lon_deg = 8.45, alt_amsl_m = 12.0"
        f"{'' if terrain is None else f', terrain = {terrain}'} }}\n"
        'drones = [{ id = "d1", airframe = "m100" }]\n'
        'orders = ["orders.csv"]\n'
        f"[mission]\n{mission}"
    )
    orders = (ROOT / "params" / "days" / "harbour_orders.csv").read_text()
    (folder / "orders.csv").write_text(orders.replace(",,", ",12,") if terrain is None else orders)
    return read_day(folder / "day.toml")


def example(name: str) -> dict[str, Any]:
    return json.loads((ROOT / "docs" / "how-to" / "geo-zones" / name).read_text())


def test_a_day_keeps_out_of_zones_of_its_hours(tmp_path: Path) -> None:
    at_ten = day(tmp_path, example("ed269.json"), HOURS.format("10", "11"))
    assert not obstacle_map(at_ten).obstacles
    at_noon = day(tmp_path, example("ed269.json"), HOURS.format("12", "13"))
    assert [o.name for o in obstacle_map(at_noon).obstacles] == ["XXX0001 Lock works"]
    assert [area.name for area in site_shown(at_noon).areas] == ["XXX0001 Lock works"]


def test_a_low_zone_in_the_air_counts_from_the_ground_and_leave_opens_it(tmp_path: Path) -> None:
    low = "cruise_height_m = 80.0\n"  # 125 m, less 8 m, 24 m of avoidance and two layers, is 69 m
    closed = day(tmp_path, example("ed318.json"), low)
    assert len(obstacle_map(closed).buffered_outlines_at(0.0)) == 1
    opened = day(tmp_path, example("ed318.json"), low + 'authorised_zones = ["XXX0002"]\n')
    assert not obstacle_map(opened).obstacles


@pytest.mark.parametrize(("terrain", "floor_m"), [("{}", 121.0), (STEEP, 121.0 - 44.4), (None, 0)])
def test_a_zone_above_ground_is_flown_under_where_the_day_states_the_ground(
    tmp_path: Path, terrain: str | None, floor_m: float
) -> None:
    mask = example("ed269.json")
    mask["features"][0]["geometry"][0] |= {"lowerLimit": 121, "upperLimit": 9999}
    data = day(tmp_path, mask, terrain=terrain)
    site = obstacle_map(data)
    table = depot_delivery_flight_table(data.day, data.day.drones[0], data.orders[0])["site"]
    if terrain is None:
        assert (site.lowest_floor_flown_under_m, "terrain" in table) == (math.inf, False)
        return
    assert table["terrain"]["kind"] == "plane"
    (zone,) = site.obstacles
    # Orders are up to 0.95 km west and 0.76 km east of the depot, and 1 km is added.
    assert zone.bottom_m == pytest.approx(floor_m, abs=1.0)
    assert site.is_flown_under(zone) == (terrain == "{}")
    if terrain == "{}":
        _, layers = layer_range_by_position(np.zeros(1), 40.0, max_layer_height_m(site))
        # 121 m less 8 m clearance and 24 m avoidance is 89 m: layers at 40, 52, 64, 76, 88 m.
        assert layers.tolist() == [5]


def test_every_flight_carries_the_days_terms_and_none_where_none_are_stated(tmp_path: Path) -> None:
    mission = HOURS.format("12", "13") + 'authorised_zones = ["XXX0002"]\n'
    for words, keys in ((mission, {"authorised_zones", "from_utc", "until_utc"}), ("", set())):
        data = day(tmp_path, example("ed318.json"), words)
        table = depot_delivery_flight_table(data.day, data.day.drones[0], data.orders[0])["mission"]
        assert {"authorised_zones", "from_utc", "until_utc"} & table.keys() == keys


def test_wrong_zones_are_named_by_file_and_row_all_at_once(tmp_path: Path) -> None:
    document = example("ed269.json")
    good = document["features"][0]
    document["features"] += [good | {"restriction": "MAYBE"}, good | {"identifier": ""}]
    with pytest.raises(DayFilesError) as caught:
        day(tmp_path, document)
    assert [(p.row, p.text.split(":")[0]) for p in caught.value.problems] == [
        (2, "zone XXX0001"),
        (3, "identifier = ''"),
    ]


def test_a_torn_zone_file_is_named(tmp_path: Path) -> None:
    text = json.dumps(example("ed269.json"))
    with pytest.raises(DayFilesError, match=r"zones\.json") as caught:
        day(tmp_path, text[: len(text) // 2])
    assert len(caught.value.problems) == 1
