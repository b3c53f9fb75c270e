"""Flights over a hill: by truth the clearance is kept, on both autopilots.

The canary: a companion without terrain data flies the same flight into the hill.

PX4 passes a waypoint that it does not reach in height and continues: three measures prevent that.
Without them the companion detects it; without detection the vehicle is lost.
"""

import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.adapters.logs.tlog_log import read_tlog
from companion.core.mission.events import Position
from sim_bridge.app.flight import companion_process
from sim_bridge.app.flight.fly import FlyOptions, fly_vehicles_and_evaluate
from sim_bridge.app.flight.judge import find_minimum_clearance_away_from_sites
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.app.world.truth_record import COLUMNS, TruthRecord
from sim_bridge.truth.terrain import GridTerrain, PlaneTerrain, RotatedTerrain
from tests.companion.routing.test_flight_heights import HILLS, ridge
from tests.sitl.conftest import SHORT, Keep, merge_tables_recursively
from tests.sitl.fault_guards import without

CLEARANCE_M = 20.0
PARAMS = Path(__file__).parents[2] / "params"


def hill_m(north_m: float, east_m: float) -> float:
    """A hill of 45 m half way, level ground at depot and customer."""
    return 45.0 * math.exp(-(((east_m + 160.0) / 55.0) ** 2) - (north_m / 150.0) ** 2)


def hill_grid() -> dict[str, Any]:
    """Return the strip along the route, turned as a desk sends it: its along-axis points west."""
    along, across = list(range(-120, 481, 20)), list(range(-200, 201, 20))
    up = [[round(hill_m(right, -ahead), 1) for right in across] for ahead in along]
    heights = {"along_m": along, "across_m": across, "up_m": up, "course_deg": -90.0}
    return {"kind": "grid", "heights": heights}


HILL: dict[str, Any] = {
    "site": {
        "customer": {"name": "customer", "east_m": -330.0, "north_m": 0.0},
        "rally": [],
    },
    "mission": {"clearance_m": CLEARANCE_M, "leg_length_m": 60.0},
}


def flights(folder: Path, terrain: dict[str, Any]) -> Path:
    table = merge_tables_recursively(SHORT, HILL)
    table["site"]["terrain"] = terrain
    path = folder / f"hill_{terrain['kind']}.toml"
    path.write_bytes(msgspec.toml.encode(table))
    return path


def flown(folder: Path, autopilot: str, *, told_flat: bool = False) -> dict[str, Any]:
    options = FlyOptions(
        flight_file=flights(folder, hill_grid()),
        autopilot=autopilot,
        run_root=folder / "runs",
        picture=False,
        lockstep_limit_s=30.0,
        companion_flight_file=flights(folder, {"kind": "flat"}) if told_flat else None,
    )
    return fly_vehicles_and_evaluate(options)["flights"][0]


@pytest.mark.sample
@pytest.mark.sitl
@pytest.mark.drawn(of="autopilot")
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_over_a_hill_a_flight_keeps_its_clearance_by_truth(tmp_path, autopilot):
    row = flown(tmp_path, autopilot)
    assert row["outcome"] == "SUC"
    assert row["least_clearance_m"] >= CLEARANCE_M
    events = read_tlog(Path(row["run"]) / "stream.tlog").events
    heard_m = [event.height_rel_m for event in events if isinstance(event, Position)]
    assert max(heard_m) > 45.0 + CLEARANCE_M  # it climbed by the autopilot's telemetry, too


@pytest.mark.sample
@pytest.mark.sitl
@pytest.mark.drawn(of="autopilot")
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_untold_of_the_hill_the_same_flight_meets_it(tmp_path, autopilot):
    row = flown(tmp_path, autopilot, told_flat=True)
    assert row["least_clearance_m"] < 2.0
    assert math.hypot(row["least_clearance_at"]["east_m"] + 160.0, 0.0) < 60.0


UNASKED = without("companion.adapters.autopilots.px4", "_is_altitude_radius_ok", "True")
UNSLOWED = "import companion.core.routing.leg_energy as energy; energy._MIN_SLOPE_HEIGHT_M = 1e9"
UNEASED = without(
    "companion.core.routing.route_planner", "raise_waypoints_to_limit_return_slopes", "given[0]"
)
AIRBORNE, PARCEL = COLUMNS.index("airborne"), COLUMNS.index("parcel_aboard")
DIES = {"kind": "companion_kill", "phase": "return", "at_s": 1.0, "restart": False}


def over_slopes(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    *taken_out: str,
    dies: bool = False,
    steep: bool = False,
) -> tuple[dict[str, Any], Craft]:
    """Fly the shipped hills on PX4 without these measures; `steep`: with a ridge en route."""
    entry = "\n".join((*taken_out, companion_process.COMPANION_CODE))
    monkeypatch.setattr(companion_process, "COMPANION_CODE", entry)
    table = msgspec.toml.decode((PARAMS / "flights" / "hills.toml").read_bytes())
    terrain = (ridge() if steep else HILLS).site.terrain
    table["site"]["terrain"] = {"kind": "grid", "heights": msgspec.to_builtins(terrain.heights)}
    if steep:
        table["site"]["rally"] = []  # it lies on the ridge
    table["faults"] = [DIES] if dies else []
    path = folder / "slopes.toml"
    path.write_bytes(msgspec.toml.encode(table))
    options = FlyOptions(
        flight_file=path,
        autopilot="px4",
        run_root=folder / "runs",
        picture=False,
        lockstep_limit_s=30.0,
    )
    kept = Keep()
    row = fly_vehicles_and_evaluate(options, kept)["flights"][0]
    return row, kept.craft


def kinds(row: dict[str, Any]) -> list[str]:
    return [decision["kind"] for decision in row["decisions"]]


@pytest.mark.sample
@pytest.mark.sitl
def test_px4_is_told_how_near_in_height_to_take_waypoints_and_gets_its_own_value_back(
    tmp_path, monkeypatch
):
    row, craft = over_slopes(tmp_path, monkeypatch)
    assert (row["outcome"], row["least_clearance_m"] >= CLEARANCE_M) == ("SUC", True)
    assert "way_home_refused" not in kinds(row)
    # The hold over the drop begins 3 m above it, and ends at its height.
    assert craft.record.release_height_m == pytest.approx(6.0, abs=1.0)
    result = msgspec.json.decode((craft.run_dir / "result.json").read_bytes())
    (changed,) = (s for s in result["settings"] if s["name"] == "NAV_MC_ALT_RAD")
    assert (changed["set"], changed["restored"]) == (3.0, True)
    assert craft.autopilot.params["NAV_MC_ALT_RAD"] == pytest.approx(0.8)


@pytest.mark.sample
@pytest.mark.sitl
def test_px4_that_flies_on_past_a_waypoint_out_of_height_is_led_on_by_one_jump(
    tmp_path, monkeypatch
):
    """As flown on SIH: the shipped flight, tailwind on the return, without the three measures."""
    row, craft = over_slopes(tmp_path, monkeypatch, UNASKED, UNSLOWED, UNEASED)
    assert row["outcome"] == "SUC"
    said = "; ".join(text for _, text in craft.operator.received_texts)
    assert "missed: continuing to ret" in said
    assert "RTL" not in said
    assert "companion released control" not in said
    assert {"delivered", "waypoint_missed"} <= set(kinds(row))


@pytest.mark.sample
@pytest.mark.sitl
@pytest.mark.parametrize("taken_out", [(), (UNEASED,)])
def test_the_mission_aboard_leads_px4_home_over_a_ridge_by_heights_that_it_keeps_up_with(
    tmp_path, monkeypatch, taken_out
):
    """The companion dies on the return. The canary: at the terrain's minimum height it passes a
    waypoint out of height and turns back for it, where others continue.
    """
    row, craft = over_slopes(tmp_path, monkeypatch, *taken_out, dies=True, steep=True)
    assert row["outcome"] == "SUC"
    assert row["least_clearance_m"] >= CLEARANCE_M
    assert (flown_back_m(craft.record) > 10.0) is bool(taken_out)


def flown_back_m(record: TruthRecord) -> float:
    """Return the largest increase of distance to the depot on the return."""
    home = [(row[AIRBORNE], row[PARCEL], math.hypot(*row[1:3])) for row in record.rows]
    away = [metres for airborne, parcel, metres in home if airborne and not parcel]
    nearest, most_m = away[0], 0.0
    for metres in away:
        nearest = min(nearest, metres)
        most_m = max(most_m, metres - nearest)
    return most_m


def record_of(*rows: tuple[float, float, float, float]) -> TruthRecord:
    """Return a record of north, east, height and airborne, one row a second."""
    kept = TruthRecord()
    for second, (north, east, up, airborne) in enumerate(rows):
        kept.rows.append((float(second), north, east, -up, *[0.0] * 7, airborne, 1.0))
    return kept


def test_the_nearest_ground_is_looked_for_away_from_pads_and_in_flight_only():
    ground = PlaneTerrain(slope_east_frac=0.1)
    kept = record_of((0, 0, 0, 0), (0, 10, 2, 1), (0, 100, 40, 1), (0, 200, 45, 1), (0, 300, 31, 1))
    nearest = find_minimum_clearance_away_from_sites(kept, ground, [(0.0, 0.0), (0.0, 300.0)])
    assert nearest is not None
    assert (nearest.clearance_m, nearest.east_m) == (pytest.approx(25.0), 200.0)
    assert (
        find_minimum_clearance_away_from_sites(record_of((0, 0, 0, 0)), ground, [(0.0, 0.0)])
        is None
    )
    down = record_of((0, 0, 0, 0), (0, 100, 40, 1), (0, 120, 11, 0))
    met = find_minimum_clearance_away_from_sites(down, ground, [(0.0, 0.0)])
    assert met is not None
    assert met.clearance_m == 0.0


def test_a_turned_strip_is_the_same_ground_in_the_simulators_own_reading():
    # Two lattices of one plane: 0.2 a metre north and 0.1 a metre east.
    strip = GridTerrain([-500.0, 500.0], [-500.0, 500.0], [[0.0, -200.0], [100.0, -100.0]])
    turned = RotatedTerrain(strip, 90.0)  # forward is east, right is south
    plane = PlaneTerrain(0.2, 0.1)
    offset = turned.height_above_depot_m(0.0, 0.0)
    for north, east in ((100.0, 0.0), (0.0, 100.0), (-50.0, 200.0)):
        assert turned.height_above_depot_m(north, east) - offset == pytest.approx(
            plane.height_above_depot_m(north, east)
        )
