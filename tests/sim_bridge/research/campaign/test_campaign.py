"""The campaign command: its JSON, the same rows for any jobs, resuming, refusals."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import PieceDone, PieceLost, Workers
from sim_bridge.research.campaign import campaign_runner
from sim_bridge.research.campaign.campaign import (
    CampaignParams,
    run_campaign,
    run_task,
    tasks_of,
    without_timings,
)
from sim_bridge.research.campaign.campaign_runner import campaign_journal, run
from sim_bridge.research.campaign.scenario_generator import GeneratorParams, WindRose, scenario_set
from sim_bridge.research.cli.campaign import app
from sim_bridge.research.planners.scenario import LogWind, scenario_json

SMALL = GeneratorParams(
    vertices=12,
    sides_m=((500.0, 1.0),),
    budget_wh=35.0,
    rose=WindRose(directions=8, speeds_mps=(3.0, 9.0), dwell_s=60.0),
)
KEYS = ["scenario", "planner", "missions", "SUC", "DEL", "FAIL", "ABRT", "energy_wh_mean"]
KEYS += ["energy_wh_std", "margin_wh_mean", "margin_wh_std", "time_s_mean", "time_s_std"]
KEYS += ["decisions", "decision_us_median", "decision_us_p99"]


@pytest.fixture
def files(tmp_path):
    paths = []
    for scenario in scenario_set(2, SMALL, 21):
        paths.append(tmp_path / f"{scenario.name}.json")
        paths[-1].write_bytes(scenario_json(scenario))
    return paths


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


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
    assert not out.with_name("rows.json.partial").exists()


def test_rows_do_not_depend_on_the_number_of_jobs():
    scenarios = scenario_set(2, SMALL, 22)
    params = CampaignParams(missions=20_500, seed=4)
    alone = run(scenarios, ["rer", "ser"], params, Workers()).rows
    pooled = run(scenarios, ["rer", "ser"], params, Workers(2)).rows
    assert [without_timings(r) for r in alone] == [without_timings(r) for r in pooled]


def one_is_lost(work, do, workers, say):
    """Stands for workers of which one was killed twice, by a task of the second scenario."""
    for index, task in enumerate(work):
        if (task.scenario, task.planner) == (1, "ser"):
            yield PieceLost(index, task, "SIGKILL")
        else:
            yield PieceDone(index, do(task))


def test_a_row_whose_worker_is_killed_is_left_out_and_named(files, tmp_path, monkeypatch):
    monkeypatch.setattr(campaign_runner, "side_by_side", one_is_lost)
    out = tmp_path / "rows.json"
    words = ("--planner", "ser", "--planner", "rer", "--missions", 60, "--json", out)
    result = call(*files, *words, "--jobs", 1)
    assert result.exit_code == 1
    names = [json.loads(path.read_text())["name"] for path in files]
    assert f"lost: {names[1]}, ser, missions from 1 on: SIGKILL" in result.output
    rows = json.loads(out.read_text())["rows"]
    kept = [(names[0], "ser"), (names[0], "rer"), (names[1], "rer")]
    assert [(row["scenario"], row["planner"]) for row in rows] == kept
    monkeypatch.undo()
    assert call(*files, *words, "--jobs", 1).exit_code == 0, "the same command tries it again"
    assert len(json.loads(out.read_text())["rows"]) == 4
    assert not out.with_name("rows.json.partial").exists()


def interrupted(done, total):
    """Ctrl-C when one task is done."""
    if done == 1:
        raise KeyboardInterrupt


def test_an_interrupted_campaign_goes_on_where_it_stopped(tmp_path):
    scenarios = scenario_set(2, SMALL, 23)
    params = CampaignParams(missions=100)
    journal = campaign_journal(tmp_path / "rows.json", scenarios, ["ser", "rer"], params)
    with pytest.raises(KeyboardInterrupt):
        run(scenarios, ["ser", "rer"], params, Workers(), journal, interrupted)
    assert len(journal.read()) == 1
    with journal.path.open("a") as file:
        file.write('[1, {"cut')  # the power went while a line was written
    rows = run(scenarios, ["ser", "rer"], params, Workers(), journal).rows
    whole = run_campaign(scenarios, ["ser", "rer"], params)
    assert [without_timings(r) for r in rows] == [without_timings(r) for r in whole]


def test_a_journal_of_another_campaign_is_not_taken_up(tmp_path):
    scenarios = scenario_set(1, SMALL, 23)
    params = CampaignParams(missions=100)
    out = tmp_path / "rows.json"
    journal = campaign_journal(out, scenarios, ["ser"], params)
    run(scenarios, ["ser"], params, Workers(), journal)
    other = CampaignParams(missions=100, seed=9)
    assert campaign_journal(out, scenarios, ["ser"], other).read() == {}


def test_winds_differ_between_scenarios_and_not_between_planners():
    from sim_bridge.research.campaign.campaign import Workbench

    first, second = scenario_set(2, SMALL, 24)
    params = CampaignParams(missions=200)
    every, at = np.arange(200), np.full(200, 30.0)
    states = [
        Workbench(s, params).winds(0).state_at(every, at).tolist() for s in (first, first, second)
    ]
    assert states[0] == states[1]
    assert states[0] != states[2]


def test_tasks_cover_every_mission_once():
    params = CampaignParams(missions=123_456)
    tasks = tasks_of(1, ["rer"], params)
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
        (["--planner", "rer", "--jobs", "-2"], "jobs"),
        (["--planner", "rer", "--json", "/no/such/folder/x.json"], "folder"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(files, options, words):
    result = call(files[0], *options)
    assert result.exit_code == 2
    assert words in result.output
    assert len(result.output.strip().splitlines()) == 1


def test_a_broken_file_stops_everything_before_it_starts(files, tmp_path):
    bad = tmp_path / "bad.json"
    bad.write_text("{}")
    out = tmp_path / "rows.json"
    result = call(files[0], bad, "--planner", "rer", "--json", out)
    assert result.exit_code == 2
    assert "bad.json" in result.output
    assert not out.exists()
    assert call(tmp_path / "none.json", "--planner", "rer").exit_code == 2


def test_ber_says_so_when_it_stays():
    scenarios = scenario_set(1, SMALL, 25)
    said = []
    params = CampaignParams(missions=50, max_loss=0.0, levels=60)
    from msgspec.structs import replace

    poor = [replace(scenarios[0], budget_wh=0.5)]
    rows = run(poor, ["ber"], params, Workers(), say=said.append).rows
    assert rows[0].ABRT == 50
    assert "stays at the depot" in said[0]


def test_ber_says_so_when_no_flight_keeps_the_bound_in_a_recording():
    from msgspec.structs import replace

    gale = LogWind(t_s=[0.0, 900.0], wind_en_mps=[(14.0, 3.0), (14.0, 3.0)], start_s=(0.0, 100.0))
    scenario = replace(scenario_set(1, SMALL, 25)[0], wind=gale)
    params = CampaignParams(missions=20, max_loss=0.0, log_levels=30)
    said = []
    rows = run([scenario], ["ber"], params, Workers(), say=said.append).rows
    assert rows[0].ABRT == 20
    assert said == [f"{scenario.name}: ber stays at the depot: no flight keeps P(loss) within 0"]


def test_recorded_winds_are_flown_by_every_planner():
    from msgspec.structs import replace

    times = [float(t) for t in range(700)]
    winds = [(5.0 + np.sin(t / 40.0), 2.0 * np.cos(t / 60.0)) for t in times]
    log = LogWind(t_s=times, wind_en_mps=[(float(e), float(n)) for e, n in winds], start_s=(0, 300))
    scenario = replace(scenario_set(1, SMALL, 26)[0], wind=log)
    params = CampaignParams(missions=60, log_levels=60, wind_classes=8)
    planners = ["ser", "rer", "ger", "ber-paper", "ber", "clairvoyant"]
    rows = {r.planner: r for r in run_campaign([scenario], planners, params)}
    assert all(r.SUC <= rows["clairvoyant"].SUC for r in rows.values())
    assert rows["clairvoyant"].DEL + rows["clairvoyant"].FAIL == 0


def test_an_unknown_planner_is_refused_where_it_is_built():
    from sim_bridge.research.campaign.campaign import CampaignTask, Workbench

    scenario = scenario_set(1, SMALL, 27)[0]
    params = CampaignParams(missions=5)
    with pytest.raises(LeewayError, match="planner"):
        run_task(scenario, params, CampaignTask(0, "x", 0, 1, False), Workbench(scenario, params))
