"""The campaign command: its JSON, the same rows for any jobs, refusals."""

import json

import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import WorkerOptions
from sim_bridge.main import app
from sim_bridge.research.campaign.campaign import (
    TaskResult,
    fly_campaign_task,
    split_campaign_into_tasks,
    summarize_campaign_rows,
)
from sim_bridge.research.campaign.scenario_generator import (
    DirectionalWindModel,
    GeneratorParams,
    draw_scenario_set,
)
from sim_bridge.research.campaign.workbench import CampaignParams, Workbench
from sim_bridge.research.planners.scenario import LogWind, scenario_json
from sim_bridge.research.study.run import Experiment, ExperimentRun

SMALL = GeneratorParams(
    vertices=12,
    square_sizes_m=((500.0, 1.0),),
    budget_wh=35.0,
    wind_model=DirectionalWindModel(directions=8, speeds_mps=(3.0, 9.0), dwell_s=60.0),
)
KEYS = ["scenario", "planner", "missions", "SUC", "DEL", "FAIL", "ABRT", "energy_wh_mean"]
KEYS += ["energy_wh_std", "margin_wh_mean", "margin_wh_std", "time_s_mean", "time_s_std"]
KEYS += ["decisions", "decision_us_median", "decision_us_p99"]


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    paths = []
    for scenario in draw_scenario_set(2, SMALL, 21):
        paths.append(tmp_path / f"{scenario.name}.json")
        paths[-1].write_bytes(scenario_json(scenario))
    return paths


def call(*arguments):
    return CliRunner().invoke(app, ["research", "campaign", *[str(a) for a in arguments]])


def rows_and_notes(scenario, planners, params):
    tasks = split_campaign_into_tasks([scenario], planners, params)
    results = [fly_campaign_task(task) for task in tasks]
    return list(summarize_campaign_rows(tasks, results)), [result.note for result in results]


def test_rows_have_the_stated_keys_and_count_every_mission(files, tmp_path):
    out = tmp_path / "rows.json"
    planners = ["ser", "rer", "ger", "ber-paper", "ber"]
    options = [x for name in planners for x in ("--planner", name)]
    result = call(*files, *options, "--missions", 50, "--jobs", 1, "--levels", 60, "--json", out)
    assert result.exit_code == 0, result.output
    rows = json.loads(out.read_text())["rows"]
    assert len(rows) == 10
    for row in rows:
        assert list(row) == KEYS
        assert row["SUC"] + row["DEL"] + row["FAIL"] + row["ABRT"] == row["missions"] == 50


@pytest.mark.night
def test_rows_do_not_depend_on_the_number_of_jobs(tmp_path):
    params = CampaignParams(missions=20_500, seed=4)
    tasks = split_campaign_into_tasks(draw_scenario_set(2, SMALL, 22), ["rer", "ser"], params)
    study = Experiment("campaign", tasks, fly_campaign_task, TaskResult)
    alone, pooled = (
        list(
            summarize_campaign_rows(
                tasks,
                ExperimentRun(
                    tmp_path / str(jobs), WorkerOptions(jobs)
                ).run_cases_and_return_results(study),
            )
        )
        for jobs in (1, 2)
    )
    assert len(alone) == 4
    for row, same in zip(alone, pooled, strict=True):
        assert row == replace(
            same, decision_us_median=row.decision_us_median, decision_us_p99=row.decision_us_p99
        )


def test_winds_differ_between_scenarios_and_not_between_planners():
    first, second = draw_scenario_set(2, SMALL, 24)
    params = CampaignParams(missions=200)
    every, at = np.arange(200), np.full(200, 30.0)
    states = [
        Workbench(s, params).draw_block_winds(0).advance_to_states_at(every, at).tolist()
        for s in (first, first, second)
    ]
    assert states[0] == states[1]
    assert states[0] != states[2]


def test_tasks_cover_every_mission_once():
    tasks = split_campaign_into_tasks(
        draw_scenario_set(1, SMALL, 24), ["rer"], CampaignParams(missions=123_456)
    )
    blocks = [b for t in tasks for b in range(t.first_block, t.first_block + t.blocks)]
    assert blocks == list(range(13))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--planner", "best"], "planner"),
        (["--planner", "clairvoyant"], "recorded"),
        (["--planner", "rer", "--missions", "0"], "missions"),
        (["--planner", "rer", "--wind-classes", "5"], "wind classes"),
        (["--planner", "ber", "--max-loss", "1.5"], "max loss"),
        (["--planner", "ber", "--max-loss", "nan"], "max loss"),
        (["--planner", "rer", "--risk-weight", "-1"], "risk weight"),
        (["--planner", "rer", "--json", "/no/such/folder/x.json"], "folder"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(files, options, words):
    error = call(files[0], *options).exception
    assert isinstance(error, LeewayError)
    assert words in str(error)
    assert len(str(error).splitlines()) == 1


def test_a_broken_file_stops_everything_before_it_starts(files, tmp_path):
    bad, out = tmp_path / "bad.json", tmp_path / "rows.json"
    bad.write_text("{}")
    for names in ([files[0], bad], [tmp_path / "none.json"]):
        error = call(*names, "--planner", "rer", "--json", out).exception
        assert isinstance(error, LeewayError)
        assert names[-1].name in str(error)
        assert not out.exists()


GALE = LogWind(t_s=[0.0, 900.0], wind_en_mps=[(14.0, 3.0), (14.0, 3.0)], start_s=(0.0, 100.0))


@pytest.mark.parametrize("change", [{"budget_wh": 0.5}, {"wind": GALE}], ids=["poor", "gale"])
def test_ber_says_so_when_no_flight_keeps_the_bound(change):
    params = CampaignParams(missions=50, max_loss=0.0, levels=60, log_levels=30)
    scenario = replace(draw_scenario_set(1, SMALL, 25)[0], **change)
    (row,), (note,) = rows_and_notes(scenario, ["ber"], params)
    assert row.ABRT == 50
    assert note == f"{scenario.name}: ber stays at the depot: no flight keeps P(loss) within 0"
