"""Missions judged with own wind alone and with the fleet's: counts, risks, and who is told what."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.shared_winds import MOST_TOLD
from sim_bridge.research.cli.main import app
from sim_bridge.research.fleet_wind.mission_outlook import FleetForesight
from sim_bridge.research.fleet_wind.mission_study import (
    ABRT,
    DEL,
    FAIL,
    FRONT_SHARE,
    SUC,
    MissionSetting,
    MissionsFlown,
    works_of,
)
from sim_bridge.research.fleet_wind.mission_verdict import (
    MissionEnds,
    mission_row,
    mission_sheets,
    risk_for,
)
from sim_bridge.research.fleet_wind.patrols import patrols
from sim_bridge.research.fleet_wind.study import FleetWindSetting
from sim_bridge.research.fleet_wind.worlds import FleetWorld
from sim_bridge.research.promise.planner import SpreadOutlook

ROOT = Path(__file__).parents[4]
SHIPPED = ROOT / "params" / "fields" / "front.toml"


def ends_by_level(lost: list[int], success: list[int], missions: int = 100) -> list[list[int]]:
    """Codes (missions, levels): of each level so many lost, then so many successes."""
    codes = np.full((missions, len(lost)), ABRT)
    for level, (gone, won) in enumerate(zip(lost, success, strict=True)):
        codes[:gone, level] = np.where(np.arange(gone) % 2, DEL, FAIL)
        codes[gone : gone + won, level] = SUC
    return codes.tolist()


def flown(case: int, own: list[list[int]], fleet: list[list[int]]) -> MissionsFlown:
    best = [SUC] * 80 + [ABRT] * 20
    return MissionsFlown(case, 0, False, {"own_only": own, "fleet": fleet}, best, 10, 9)


def test_a_risk_loses_as_much_as_is_accepted_between_two_that_were_flown() -> None:
    codes = np.array(ends_by_level([0, 1, 4, 10], [20, 30, 40, 50]))
    assert risk_for(codes, 0.01) == (1, 0.0)
    level, share = risk_for(codes, 0.02)
    assert level == 1
    assert share == pytest.approx(1.0 / 3.0)
    assert risk_for(codes, 0.5) == (3, 0.0)
    lossy = np.array(ends_by_level([5, 6, 7, 8], [20, 30, 40, 50]))
    assert risk_for(lossy, 0.01) == (0, 0.0)


def test_each_half_is_judged_at_the_risk_that_the_other_half_sets() -> None:
    """Half 0 loses one in a hundred at its second level, half 1 at its third."""
    first = ends_by_level([0, 1, 9, 9], [10, 20, 30, 40])
    second = ends_by_level([0, 0, 1, 9], [11, 21, 31, 41])
    ends = MissionEnds.of([flown(0, first, second), flown(1, second, second)], seed=1)
    row = mission_row(ends, 0.01)
    # Of half 0 the level of half 1, where own wind alone loses nine; of half 1 that of half 0.
    assert row["own_only"]["SUC"] == 30 + 21
    assert row["own_only"]["DEL"] + row["own_only"]["FAIL"] == 9 + 0
    assert row["fleet"]["SUC"] == 31 + 31
    assert row["fleet"]["DEL"] + row["fleet"]["FAIL"] == 2
    assert row["clairvoyant"] == {"SUC": 160, "DEL": 0, "FAIL": 0, "ABRT": 40}
    assert all(sum(counts.values()) == 200 for counts in row.values())


def test_at_equal_loss_successes_lie_between_the_risks_that_were_flown() -> None:
    codes = ends_by_level([0, 2, 4, 8], [10, 30, 40, 44])
    better = ends_by_level([0, 1, 2, 4], [10, 30, 40, 44])
    ends = MissionEnds.of([flown(0, codes, better)], seed=1)
    at = ends.at_equal_loss(0.02)
    assert at["own_only"] == pytest.approx(0.30)
    assert at["fleet"] == pytest.approx(0.40)
    assert ends.at_equal_loss(0.03)["own_only"] == pytest.approx(0.35)


def test_at_equal_risk_both_are_counted_in_the_same_missions() -> None:
    lost, success = [0] * 11 + [3], [10] * 11 + [40]
    own = ends_by_level(lost, success)
    fleet = ends_by_level([0] * 11 + [2], [14] * 11 + [44])
    ends = MissionEnds.of([flown(0, own, fleet)], seed=1)
    fields = FleetWindSetting(None, str(SHIPPED), "x", 8, 0, 4.0, 13.0, 1)
    setting = MissionSetting(fields, 1, 100, 0.4, "hard", 0.01)
    sheets = mission_sheets(ends, [flown(0, own, fleet)], setting)
    assert sheets["equal-risk"].rows[0][1:6] == ["10.0", "0", "14.0", "0", "+4.0"]
    assert sheets["equal-risk"].rows[-1][1:6] == ["40.0", "3", "44.0", "2", "+4.0"]
    assert {row[1] for row in sheets["missions"].rows} == {
        "own wind alone", "the fleet's wind", "clairvoyant",
    }  # fmt: skip


def test_one_mission_in_ten_has_a_front_in_its_hour_and_none_is_lost() -> None:
    fields = FleetWindSetting(None, str(SHIPPED), "x", 8, 0, 4.0, 13.0, 1)
    work = works_of(MissionSetting(fields, 3, 200, 0.4, "hard", 0.01))
    assert sum(one.count for one in work) == 200
    assert sum(one.count for one in work if one.front) == round(FRONT_SHARE * 200)
    assert {one.number for one in work} == {0, 1, 2}
    assert len({(w.number, w.front, w.first) for w in work}) == len(work)


class Still:
    """A truth of no use here."""


def test_a_mission_hears_the_nearest_others_and_uses_them_once_its_own_wind_is_known() -> None:
    process, rng = read_wind_process("coast"), np.random.default_rng(2)
    ways = patrols(8, 8, 2000.0, rng)
    told_s = np.arange(10.0, 2001.0, 10.0)
    told = np.array([6.0, 2.0]) + 0.5 * rng.standard_normal((8, told_s.size, 2))
    world = FleetWorld(Still(), 2000, FieldProcess(process), ways, told_s, told)  # type: ignore[arg-type]
    place = np.array([100.0, -200.0])
    foresight = FleetForesight(world, [], process, place, 1000.0)
    assert isinstance(foresight.outlooks(-295.0)[0], SpreadOutlook)
    from companion.core.wind.estimator import WindBelief

    for t_s in range(-295, 1, 5):
        wind = np.array([6.0, 2.0]) + 0.3 * rng.standard_normal(2)
        foresight.observe(WindBelief(float(t_s), wind, 0.05 * np.eye(2), ("told",), True))
    (outlook,) = foresight.outlooks(0.0)
    assert not isinstance(outlook, SpreadOutlook)
    here = outlook.outlook.field.members  # type: ignore[attr-defined]
    places = {way.name: float(np.hypot(*(way.at(np.array([0.0]))[0] - place))) for way in ways[1:]}
    nearest = sorted(places, key=places.__getitem__)[:MOST_TOLD]
    assert set(here) == {"(own)", *nearest}
    liar = FleetForesight(world, [], process, place, 1000.0, (7.0, 0.0))
    for t_s in range(-295, 1, 5):
        liar.observe(
            WindBelief(float(t_s), np.array([6.0, 2.0]), 0.05 * np.eye(2), ("told",), True)
        )
    assert isinstance(liar.outlooks(0.0)[0], SpreadOutlook), "contradicted by its own wind"


@pytest.mark.night
def test_the_command_judges_missions_in_a_made_field(tmp_path: Path) -> None:
    words = ["fleet-wind", "--field", str(SHIPPED), "--draws", "0", "--alert-draws", "0"]
    words += ["--missions", "12", "--mission-draws", "2", "--wind-air", "0.5", "--jobs", "1"]
    words += ["--json", str(tmp_path / "m.json"), "--out", str(tmp_path / "out"), "--seed", "3"]
    said = CliRunner().invoke(app, words)
    assert said.exit_code == 0, said.output
    found = json.loads((tmp_path / "m.json").read_text())
    assert set(found["missions"]) == {"own_only", "fleet", "clairvoyant"}
    for counts in found["missions"].values():
        assert set(counts) == {"SUC", "DEL", "FAIL", "ABRT"}
        assert sum(counts.values()) == 12
    assert found["missions"]["clairvoyant"]["DEL"] == found["missions"]["clairvoyant"]["FAIL"] == 0
    assert found["missions_flown"]["wind_air"] == 0.5
