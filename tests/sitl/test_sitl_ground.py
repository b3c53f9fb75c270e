"""Flights over a hill: by truth no nearer to it than the clearance, on both autopilots.

The canary: a companion that is not told of the ground flies the same flight into the hill.
"""

import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.adapters.logs.tlog_log import read_tlog
from companion.core.mission.events import Position
from sim_bridge.app.flight.fly import FlyOptions, fly
from sim_bridge.app.flight.judge import nearest_ground
from sim_bridge.app.flight.record import TruthRecord
from sim_bridge.truth.terrain import GridTerrain, PlaneTerrain, TurnedTerrain
from tests.sitl.conftest import SHORT, merged

CLEARANCE_M = 20.0


def hill_m(north_m: float, east_m: float) -> float:
    """A hill of 45 m half way, nothing at depot and customer."""
    return 45.0 * math.exp(-(((east_m + 160.0) / 55.0) ** 2) - (north_m / 150.0) ** 2)


def hill_grid() -> dict[str, Any]:
    """The strip along the way, turned as a desk sends it: its along-axis points west."""
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
    table = merged(SHORT, HILL)
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
        told=flights(folder, {"kind": "flat"}) if told_flat else None,
    )
    return fly(options)["flights"][0]


@pytest.mark.sitl
@pytest.mark.drawn(of="autopilot")
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_over_a_hill_a_flight_keeps_its_clearance_by_truth(tmp_path, autopilot):
    row = flown(tmp_path, autopilot)
    assert row["outcome"] == "SUC"
    assert row["least_clearance_m"] >= CLEARANCE_M
    events = read_tlog(Path(row["run"]) / "stream.tlog").events
    heard_m = [event.height_rel_m for event in events if isinstance(event, Position)]
    assert max(heard_m) > 45.0 + CLEARANCE_M  # it climbed, by what the autopilot says, too


@pytest.mark.sitl
@pytest.mark.drawn(of="autopilot")
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_untold_of_the_hill_the_same_flight_meets_it(tmp_path, autopilot):
    row = flown(tmp_path, autopilot, told_flat=True)
    assert row["least_clearance_m"] < 2.0
    assert math.hypot(row["least_clearance_at"]["east_m"] + 160.0, 0.0) < 60.0


def record_of(*rows: tuple[float, float, float, float]) -> TruthRecord:
    """North, east, height and whether it is in the air, one row a second."""
    kept = TruthRecord()
    for second, (north, east, up, airborne) in enumerate(rows):
        kept.rows.append((float(second), north, east, -up, *[0.0] * 7, airborne, 1.0))
    return kept


def test_the_nearest_ground_is_looked_for_away_from_pads_and_in_flight_only():
    ground = PlaneTerrain(slope_east_frac=0.1)
    kept = record_of((0, 0, 0, 0), (0, 10, 2, 1), (0, 100, 40, 1), (0, 200, 45, 1), (0, 300, 31, 1))
    nearest = nearest_ground(kept, ground, [(0.0, 0.0), (0.0, 300.0)])
    assert nearest is not None
    assert (nearest.clearance_m, nearest.east_m) == (pytest.approx(25.0), 200.0)
    assert nearest_ground(record_of((0, 0, 0, 0)), ground, [(0.0, 0.0)]) is None
    down = record_of((0, 0, 0, 0), (0, 100, 40, 1), (0, 120, 11, 0))
    met = nearest_ground(down, ground, [(0.0, 0.0)])
    assert met is not None
    assert met.clearance_m == 0.0


def test_a_turned_strip_is_the_same_ground_in_the_simulators_own_reading():
    # Two lattices of one plane: 0.2 a metre north and 0.1 a metre east.
    strip = GridTerrain([-500.0, 500.0], [-500.0, 500.0], [[0.0, -200.0], [100.0, -100.0]])
    turned = TurnedTerrain(strip, 90.0)  # ahead is east, right is south
    plane = PlaneTerrain(0.2, 0.1)
    offset = turned.up_m(0.0, 0.0)
    for north, east in ((100.0, 0.0), (0.0, 100.0), (-50.0, 200.0)):
        assert turned.up_m(north, east) - offset == pytest.approx(plane.up_m(north, east))
