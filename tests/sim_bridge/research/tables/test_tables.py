"""The experiments' commands on small sets: they print, write, and say what they must."""

import csv
import math
import os
import signal
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import Workers
from sim_bridge.adapters.journal import Journal, PiecesLost, digest_of, journaled_map
from sim_bridge.research.campaign import frontier_check
from sim_bridge.research.campaign.scenario_generator import GeneratorParams, scenario_set
from sim_bridge.research.results.sheet import Sheet, interval95, mean_std
from sim_bridge.research.tables import energy_speed, lambda_sweep, table1
from sim_bridge.research.tables.table1 import recorded_wind
from sim_bridge.research.tables.urban_scene import SECTORS, TownParams, generate_town


def test_scenario_sets_are_the_same_for_the_same_seed_and_connected():
    first, again = (scenario_set(3, GeneratorParams(), 5, targets=2) for _ in range(2))
    assert first == again
    assert len({s.name for s in first}) == 6
    assert scenario_set(3, GeneratorParams(), 6) != first[::2]


def test_the_paper_table_is_copied_right_its_rows_sum_to_a_hundred():
    for cells in table1.PAPER.values():
        for row in cells.values():
            assert sum(row) == pytest.approx(100.0, abs=0.11)


def test_table_1_prints_every_cell_and_draws(tmp_path):
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
    cells = table1.cells_of([table1.fly(job) for job in table1.jobs_of(params)], params)
    sheet = table1.sheet("Table 1", cells, "note", params)
    assert len(sheet.rows) == 4 * 6
    for shares in cells.values():
        assert shares.sum(axis=-1) == pytest.approx(np.full((2, 1), 100.0), abs=0.2)
    table1.draw(cells, "Table 1", tmp_path / "table1.png")
    written = sheet.write(tmp_path, "table1")
    assert (tmp_path / "table1.png").stat().st_size > 1000
    with written[1].open() as file:
        assert len(list(csv.reader(file))) == 25


def test_the_multirotor_is_u_shaped_and_its_best_speed_rises_with_payload():
    found = {
        (c.model, c.payload_kg, c.wind): c for c in energy_speed.curves(read_airframe("octo8"))
    }
    for payload in (0.0, 8.0):
        for wind in energy_speed.WINDS:
            assert found["multirotor", payload, wind].is_u_shaped
    empty, loaded = (found["multirotor", kg, "calm"].best[0] for kg in (0.0, 8.0))
    assert loaded > empty + 2.0
    headwind = found["multirotor", 0.0, "headwind"].best[0] - energy_speed.WIND_MPS
    assert headwind < empty  # in ground terms the best speed falls with headwind


def test_the_papers_formula_hardly_feels_eight_kilograms_in_level_flight():
    found = {
        (c.model, c.payload_kg, c.wind): c for c in energy_speed.curves(read_airframe("octo8"))
    }
    paper = [found["paper's formula", kg, "calm"].best for kg in (0.0, 8.0)]
    rotor = [found["multirotor", kg, "calm"].best for kg in (0.0, 8.0)]
    assert paper[1][0] <= paper[0][0]  # the best speed does not rise
    # The formula feels the parcel's drag, not its weight: 1.8 times the mass.
    assert paper[1][1] / paper[0][1] < 1.25
    assert rotor[1][1] / rotor[0][1] > 1.5


def test_the_wind_of_a_town_differs_from_edge_to_edge_and_with_where_it_blows():
    town = generate_town("t", TownParams(blocks=4, vertices=20), np.random.default_rng(2))
    factor = town.graph.wind_factor
    assert factor is not None
    assert factor.shape == (town.graph.edge_count, SECTORS)
    assert factor.min() < 0.7
    assert factor.max() > 1.05
    assert np.ptp(factor, axis=1).max() > 0.3
    east = town.graph.duration_s([[8.0, 0.0]])[:, 0]
    scaled = [town.graph.duration_s([[8.0 * f, 0.0]])[e, 0] for e, f in enumerate(factor[:, 0])]
    assert np.isfinite(east).any()
    assert len(scaled) == len(east)


def test_the_sweep_over_lambda_has_every_cell_and_shares_that_sum_up():
    scenario = scenario_set(1, GeneratorParams(vertices=10), 3)[0]
    parts = lambda_sweep.fly(lambda_sweep.SweepJob(scenario, missions=5))
    points = lambda_sweep.points_of([parts, parts])
    cells = len(lambda_sweep.PLANNERS) * len(lambda_sweep.LAMBDAS) * len(lambda_sweep.BUDGETS_WH)
    assert len(lambda_sweep.sheet(points).rows) == cells
    for point in points:
        assert point.success + point.abort + point.loss == pytest.approx([100.0, 100.0])


def test_a_wind_log_points_to_where_the_air_moves(tmp_path):
    path = tmp_path / "w.csv"
    path.write_text("t_s,wind_speed_mps,wind_from_deg\n0,5,90\n1,5,0\n400,5,0\n")
    log = recorded_wind(path, longest_mission_s=300.0)
    assert log.wind_en_mps[0] == pytest.approx((-5.0, 0.0), abs=1e-9)  # from the east: to the west
    assert log.wind_en_mps[1] == pytest.approx((0.0, -5.0), abs=1e-9)
    assert log.start_s == (0.0, 100.0)
    path.write_text("t_s,speed,dir\n0,5,90\n")
    with pytest.raises(LeewayError, match="speed"):
        recorded_wind(path, 300.0)


def test_the_coast_recording_can_be_read():
    path = Path("../shared/data/wind/coast_2023_1hz.csv")
    if not path.exists():
        pytest.skip("the shared recordings are not here")
    log = recorded_wind(path, 300.0)
    assert len(log.t_s) > 6000


def test_means_and_intervals_are_the_textbook_ones():
    assert mean_std([1.0, 2.0, 3.0]) == "2.0 ± 1.0"
    low, high = interval95([1.0, 2.0, 3.0])
    assert high - low == pytest.approx(2 * 1.96 / math.sqrt(3.0))


def test_long_work_goes_on_where_it_stopped_and_does_nothing_twice(tmp_path):
    journal = Journal(tmp_path / "x.partial", digest_of("squares", 5), int)
    asked = []

    def square(n, stops_at=None):
        if n == stops_at:
            raise KeyboardInterrupt
        asked.append(n)
        return n * n

    with pytest.raises(KeyboardInterrupt):
        journaled_map(range(5), lambda n: square(n, stops_at=3), Workers(), journal)
    assert journaled_map(range(5), square, Workers(), journal) == [0, 1, 4, 9, 16]
    assert asked == [0, 1, 2, 3, 4]
    other = Journal(journal.path, digest_of("squares", 6), int)
    assert other.read() == {}


def killed_at_three(n):
    if n == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return n * n


def test_what_no_worker_came_back_with_is_named_and_all_else_kept(tmp_path):
    journal = Journal(tmp_path / "x.partial", digest_of("squares", 5), int)
    with pytest.raises(PiecesLost) as caught:
        journaled_map(range(5), killed_at_three, Workers(2), journal)
    assert [(one.index, one.piece) for one in caught.value.lost] == [(3, 3)]
    assert journal.read() == {0: 0, 1: 1, 2: 4, 4: 16}


def test_the_frontier_check_counts_what_is_beyond_noise():
    flown = frontier_check.RivalCampaign(0.01, "rer", success=0.80, loss=0.012, missions=10_000)
    near = frontier_check.Distance("a", 100.0, flown, 0.012, 0.03, noise=0.004, levels=500)
    assert near.beyond_noise == pytest.approx(0.004)
    # Two standard errors of a loss of 1 % over 10,000 missions are 0.199 points.
    assert near.excess_loss == pytest.approx(0.002 - 2 * math.sqrt(0.01 * 0.99 / 10_000))
    assert near.lead is None
    rival = msgspec.structs.replace(flown, rival_success=0.82)
    beaten = msgspec.structs.replace(near, flown=rival)
    assert beaten.lead == pytest.approx(-0.02)
    assert "behind beyond noise in 1 of 1" in frontier_check.summary(
        [beaten]
        + [
            msgspec.structs.replace(near, flown=msgspec.structs.replace(rival, max_loss=b, rival=r))
            for b, r in [(0.001, ""), (0.01, ""), (0.05, ""), (0.0, "ser"), (0.0, "ber-paper")]
        ]
    )


def test_a_sheet_is_markdown_and_csv(tmp_path):
    page, table = Sheet("T", ["a", "b"], [["1", "2"]], "n").write(tmp_path, "t")
    assert "| 1 | 2 |" in page.read_text()
    assert table.read_text().splitlines() == ["a,b", "1,2"]


def test_processes_side_by_side_run_matrix_routines_on_one_thread_each(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    names = ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"]
    assert journaled_map(names, os.getenv, Workers(2), Journal(tmp_path / "j", "d", str)) == [
        "1",
        "1",
    ]
    assert [os.getenv(name) for name in names] == ["7", None]
