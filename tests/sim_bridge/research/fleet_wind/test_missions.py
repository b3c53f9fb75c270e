"""Missions with own wind alone and with the fleet's: counts, risks, and shared reports."""

from pathlib import Path

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.shared_winds import MAX_REPORTS
from sim_bridge.research.fleet_wind.fields import FleetWindSetting, FleetWorld, draw_patrols
from sim_bridge.research.fleet_wind.foresight import FleetForecaster
from sim_bridge.research.fleet_wind.missions import (
    ABRT,
    DEL,
    FAIL,
    FRONT_SHARE,
    SUC,
    MissionSetting,
    MissionsFlown,
    fit_risk_level_and_share,
    mission_sheet,
    outcome_counts_by_policy,
    split_missions_into_work_items,
)
from sim_bridge.research.promise.planner import ScaledForecaster
from tests.sim_bridge.research.study_command import run_study

ROOT = Path(__file__).parents[4]
SHIPPED = ROOT / "params" / "fields" / "front.toml"


def ends_by_level(lost: list[int], success: list[int], missions: int = 100) -> list[list[int]]:
    """Return codes (missions, levels): for each level so many lost, then so many successes."""
    codes = np.full((missions, len(lost)), ABRT)
    for level, (gone, won) in enumerate(zip(lost, success, strict=True)):
        codes[:gone, level] = np.where(np.arange(gone) % 2, DEL, FAIL)
        codes[gone : gone + won, level] = SUC
    return codes.tolist()


def flown(case: int, own: list[list[int]], fleet: list[list[int]]) -> MissionsFlown:
    best = [SUC] * 80 + [ABRT] * 20
    return MissionsFlown(case, 0, {"own_only": own, "fleet": fleet}, best, 10, 9)


def test_a_risk_loses_as_much_as_is_accepted_between_two_that_were_flown() -> None:
    codes = np.array(ends_by_level([0, 1, 4, 10], [20, 30, 40, 50]))
    assert fit_risk_level_and_share(codes, 0.01) == (1, 0.0)
    level, share = fit_risk_level_and_share(codes, 0.02)
    assert level == 1
    assert share == pytest.approx(1.0 / 3.0)
    assert fit_risk_level_and_share(codes, 0.5) == (3, 0.0)
    lossy = np.array(ends_by_level([5, 6, 7, 8], [20, 30, 40, 50]))
    assert fit_risk_level_and_share(lossy, 0.01) == (0, 0.0)


def test_each_half_is_judged_at_the_risk_that_the_other_half_sets() -> None:
    """Half 0 loses one in a hundred at its second level, half 1 at its third."""
    first = ends_by_level([0, 1, 9, 9], [10, 20, 30, 40])
    second = ends_by_level([0, 0, 1, 9], [11, 21, 31, 41])
    row = outcome_counts_by_policy([flown(0, first, second), flown(1, second, second)], 1, 0.01)
    # Half 0 at half 1's level, where own wind alone loses nine; half 1 at half 0's level.
    assert row["own_only"]["SUC"] == 30 + 21
    assert row["own_only"]["DEL"] + row["own_only"]["FAIL"] == 9 + 0
    assert row["fleet"]["SUC"] == 31 + 31
    assert row["fleet"]["DEL"] + row["fleet"]["FAIL"] == 2
    assert row["clairvoyant"] == {"SUC": 160, "DEL": 0, "FAIL": 0, "ABRT": 40}
    assert all(sum(counts.values()) == 200 for counts in row.values())


FIELDS = FleetWindSetting(None, str(SHIPPED), "x", 8, 0, 1)


def test_the_table_names_each_policy_and_the_share_it_loses() -> None:
    own = ends_by_level([0] * 11 + [3], [10] * 11 + [40])
    row = outcome_counts_by_policy([flown(0, own, own)], 1, 0.01)
    sheet = mission_sheet(row, 0.9, MissionSetting(FIELDS, 1, 100, 0.4, "hard", 0.01))
    assert [cells[:2] for cells in sheet.rows] == [
        ["own wind alone", "100"], ["the fleet's wind", "100"], ["clairvoyant", "100"],
    ]  # fmt: skip
    assert sheet.rows[2][2:] == ["80.0", "0.0", "0.0", "20.0"]


def test_one_mission_in_ten_has_a_front_in_its_hour_and_none_is_lost() -> None:
    work = split_missions_into_work_items(MissionSetting(FIELDS, 3, 200, 0.4, "hard", 0.01))
    assert sum(one.count for one in work) == 200
    assert sum(one.count for one in work if one.front) == round(FRONT_SHARE * 200)
    assert {one.number for one in work} == {0, 1, 2}
    assert len({(w.number, w.front, w.first_mission) for w in work}) == len(work)


class Still:
    """An unused truth."""


def test_a_mission_hears_the_nearest_others_and_uses_them_once_its_own_wind_is_known() -> None:
    process, rng = read_wind_process("coast"), np.random.default_rng(2)
    ways = draw_patrols(8, 8, 2000.0, rng)
    told_s = np.arange(10.0, 2001.0, 10.0)
    told = np.array([6.0, 2.0]) + 0.5 * rng.standard_normal((8, told_s.size, 2))
    world = FleetWorld(Still(), 2000, FieldProcess(process), ways, told_s, told)  # type: ignore[arg-type]
    place = np.array([100.0, -200.0])
    foresight = FleetForecaster(world, (), process, place, 1000.0)
    assert isinstance(foresight.candidate_forecasts(-295.0)[0], ScaledForecaster)
    from companion.core.wind.estimator import WindBelief

    for t_s in range(-295, 1, 5):
        wind = np.array([6.0, 2.0]) + 0.3 * rng.standard_normal(2)
        foresight.update_from_estimate(
            WindBelief(float(t_s), wind, 0.05 * np.eye(2), ("told",), True)
        )
    (outlook,) = foresight.candidate_forecasts(0.0)
    assert not isinstance(outlook, ScaledForecaster)
    here = outlook.outlook.field.accepted_members  # type: ignore[attr-defined]
    places = {
        way.name: float(np.hypot(*(way.positions_ne_m_at(np.array([0.0]))[0] - place)))
        for way in ways[1:]
    }
    nearest = sorted(places, key=places.__getitem__)[:MAX_REPORTS]
    assert set(here) == {"(own)", *nearest}


@pytest.mark.night
def test_the_command_judges_missions_in_a_made_field(tmp_path: Path) -> None:
    words = ("--field", str(SHIPPED), "--draws", "0", "--alert-draws", "0", "--seed", "3")
    few = ("--missions", "12", "--mission-draws", "2", "--wind-air", "0.5")
    found, _ = run_study(tmp_path, "fleet-wind", *words, *few)
    assert set(found["missions"]) == {"own_only", "fleet", "clairvoyant"}
    for counts in found["missions"].values():
        assert set(counts) == {"SUC", "DEL", "FAIL", "ABRT"}
        assert sum(counts.values()) == 12
    assert found["missions"]["clairvoyant"]["DEL"] == found["missions"]["clairvoyant"]["FAIL"] == 0
    assert found["missions_flown"]["wind_air"] == 0.5
