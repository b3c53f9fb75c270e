"""The experiments' commands on small sets: output, files, and messages."""

import csv
import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from sim_bridge.research.campaign import frontier_check
from sim_bridge.research.campaign.scenario_generator import GeneratorParams, draw_scenario_set
from sim_bridge.research.campaign.workbench import outcome_percentages_by_cell
from sim_bridge.research.study.intervals import (
    bootstrap_mean_interval95,
    bootstrap_share_interval95,
)
from sim_bridge.research.study.sheet import Sheet, low_to_high, mean_and_std
from sim_bridge.research.tables import energy_speed, lambda_sweep, table1
from sim_bridge.research.tables.table1 import read_recorded_wind
from sim_bridge.research.tables.urban_scene import SECTORS, TownParams, draw_connected_town


def test_scenario_sets_are_the_same_for_the_same_seed_and_connected():
    first, again = (
        draw_scenario_set(3, GeneratorParams(), 5, targets_per_graph=2) for _ in range(2)
    )
    assert first == again
    assert len({s.name for s in first}) == 6
    assert draw_scenario_set(3, GeneratorParams(), 6) != first[::2]


def test_the_paper_table_is_copied_right_its_rows_sum_to_a_hundred():
    for cells in table1.PAPER.values():
        for row in cells.values():
            assert sum(row) == pytest.approx(100.0, abs=0.11)


@pytest.mark.sample
def test_table_1_prints_every_cell(tmp_path):
    params = replace(
        table1.Table1Params(),
        rounds=2,
        graphs=1,
        targets=1,
        missions=10,
        levels=40,
        max_losses=(0.01,),
        generator=GeneratorParams(vertices=12),
        tuning=table1.TuningParams(fewest_missions=500, most_missions=500),
    )
    cells = outcome_percentages_by_cell(
        table1.fly_all_cells_on_scenario(job) for job in table1.build_jobs(params)
    )
    sheet = table1.table1_sheet("Table 1", cells, "note", params)
    assert len(sheet.rows) == 4 * 6
    for shares in cells.values():
        assert shares.sum(axis=-1) == pytest.approx(np.full(2, 100.0), abs=0.2)
    written = sheet.write_markdown_and_csv(tmp_path, "table1")
    with written[1].open() as file:
        assert len(list(csv.reader(file))) == 25


@pytest.fixture(scope="module")
def found():
    curves = energy_speed.compute_curves(read_airframe("octo8"))
    return {(c.model, c.payload_kg, c.wind): c for c in curves}


def test_the_multirotor_is_u_shaped_and_its_best_speed_rises_with_payload(found):
    for payload in (0.0, 8.0):
        for wind in energy_speed.WINDS:
            assert found["multirotor", payload, wind].is_u_shaped
    empty, loaded = (found["multirotor", kg, "calm"].best[0] for kg in (0.0, 8.0))
    assert loaded > empty + 2.0
    headwind = found["multirotor", 0.0, "headwind"].best[0] - energy_speed.WIND_MPS
    assert headwind < empty  # in ground terms the best speed falls with headwind


def test_the_papers_formula_hardly_feels_eight_kilograms_in_level_flight(found):
    paper = [found["paper's formula", kg, "calm"].best for kg in (0.0, 8.0)]
    rotor = [found["multirotor", kg, "calm"].best for kg in (0.0, 8.0)]
    assert paper[1][0] <= paper[0][0]  # the best speed does not rise
    # The formula counts the parcel's drag, not its weight: 1.8 times the mass.
    assert paper[1][1] / paper[0][1] < 1.25
    assert rotor[1][1] / rotor[0][1] > 1.5


def test_the_wind_of_a_town_differs_from_edge_to_edge_and_with_where_it_blows():
    _, graph = draw_connected_town("t", TownParams(blocks=4, vertices=20), np.random.default_rng(2))
    factor = graph.wind_factor
    assert factor is not None
    assert factor.shape == (graph.edge_count, SECTORS)
    assert factor.min() < 0.7
    assert factor.max() > 1.05
    assert np.ptp(factor, axis=1).max() > 0.3
    east, open_ground = graph.edge_duration_s([[8.0, 0.0]])[:, 0], replace(graph, wind_factor=None)
    scaled = open_ground.edge_duration_s([[8.0 * f, 0.0] for f in factor[:, 0]]).diagonal()
    assert np.isfinite(east).any()
    assert east == pytest.approx(scaled)


@pytest.mark.sample
def test_the_sweep_over_lambda_has_every_cell_and_shares_that_sum_up():
    scenario = draw_scenario_set(1, GeneratorParams(vertices=10), 3)[0]
    parts = lambda_sweep.fly_all_planners_on_graph(lambda_sweep.SweepJob(scenario, missions=5))
    cells = len(lambda_sweep.PLANNERS) * len(lambda_sweep.LAMBDAS) * len(lambda_sweep.BUDGETS_WH)
    assert (
        len(lambda_sweep.build_lambda_sweep_report([parts, parts]).sheets["lambda_sweep"].rows)
        == cells
    )
    assert all(sum(shares) == pytest.approx(100.0) for _, shares in parts)


def test_a_wind_log_points_to_where_the_air_moves(tmp_path):
    path = tmp_path / "w.csv"
    path.write_text("t_s,wind_speed_mps,wind_from_deg\n0,5,90\n1,5,0\n400,5,0\n")
    log = read_recorded_wind(path, longest_mission_s=300.0)
    assert log.wind_en_mps[0] == pytest.approx((-5.0, 0.0), abs=1e-9)  # from the east: to the west
    assert log.wind_en_mps[1] == pytest.approx((0.0, -5.0), abs=1e-9)
    assert log.start_s == (0.0, 100.0)
    path.write_text("t_s,speed,dir\n0,5,90\n")
    with pytest.raises(LeewayError, match="speed"):
        read_recorded_wind(path, 300.0)


def test_means_and_intervals_are_the_textbook_ones():
    assert mean_and_std([1.0, 2.0, 3.0]).text == "2.0 ± 1.0"
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    low, high = bootstrap_mean_interval95(values, np.random.default_rng(2))
    half = 1.96 * values.std(ddof=1) / math.sqrt(values.size)  # large samples: the normal interval
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.03)


@pytest.mark.parametrize("hits", [[0] * 9 + [1], [60] * 9 + [59], [0] * 10, [60] * 10])
def test_an_interval_of_a_share_stays_within_0_and_100_percent(hits):
    shares = np.array(hits) / 60.0
    half = 1.96 * shares.std(ddof=1) / math.sqrt(10)
    normal = shares.mean() - half, shares.mean() + half
    assert min(normal) < 0.0 or max(normal) > 1.0 or half == 0.0  # the textbook's leaves them
    low, high = bootstrap_share_interval95(hits, [60] * 10, np.random.default_rng(1))
    assert 0.0 <= low < high <= 1.0
    assert low <= shares.mean() <= high


def test_a_csv_cell_holds_one_value_and_unknown_is_empty(tmp_path):
    several = mean_and_std([93.4, 94.4]), low_to_high((0.0, 0.015), ".1%")
    rows = [["a", *several, "12.5%", "-"], ["b", "not configured", "-", "3%", "1.5"]]
    sheet = Sheet("T", ["name", "SUC %", "95", "share", "margin"], rows)
    page, table = sheet.write_markdown_and_csv(tmp_path, "t")
    assert "| a | 93.9 ± 0.7 | 0.0% to 1.5% | 12.5% | - |" in page.read_text()
    with table.open(newline="") as file:
        assert list(csv.reader(file)) == [
            ["name", "SUC % mean", "SUC % std", "95 low, %", "95 high, %", "share, %", "margin"],
            ["a", "93.9", "0.7", "0.0", "1.5", "12.5", ""],
            ["b", "", "", "", "", "3", "1.5"],
        ]


def test_the_frontier_check_counts_what_is_beyond_noise():
    near = frontier_check.FrontierDistance(
        "a", 100.0, 0.01, 10_000, 0.80, 0.012, 0.012, 0.03, noise=0.004, levels=500
    )
    assert near.distance_less_noise == pytest.approx(0.004)
    # Two standard errors of a loss of 1 % over 10,000 missions are 0.199 points.
    assert near.loss_beyond_bound_and_noise == pytest.approx(
        0.002 - 2 * math.sqrt(0.01 * 0.99 / 10_000)
    )
    every = [msgspec.structs.replace(near, max_loss=bound) for bound in (0.001, 0.01, 0.05)]
    assert "1.20 points on average" in frontier_check.format_summary(every)
