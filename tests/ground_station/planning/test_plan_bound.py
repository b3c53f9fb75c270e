"""No plan beats the bound; a long search on driven plans finds none worse than it began with."""

from dataclasses import replace
from io import StringIO
from itertools import pairwise, permutations
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rich.console import Console
from scipy.sparse.csgraph import floyd_warshall
from typer.testing import CliRunner

from ground_station.adapters.files.day_files import read_day
from ground_station.app.benchmarks.day_bench import DayPromises, print_promises
from ground_station.app.cli.main import app
from ground_station.core.planning.day_planner import (
    PlanParams,
    day_problem,
    road_searched_plans,
    tried_plans,
)
from ground_station.core.planning.plan_bound import plan_bound, shortest_way_s, spanning_way_s
from ground_station.core.schema.day_state import first_state
from tests.ground_station.truck_drones.test_optimal import best_makespan_s, tiny_problem

pytestmark = pytest.mark.usefixtures("compiled_planner")

HARBOUR = Path(__file__).parents[3] / "params" / "days" / "harbour.toml"
QUICK = PlanParams(trials=2000)


@pytest.mark.parametrize("seed", range(6))
def test_the_best_of_all_plans_of_a_tiny_problem_is_not_below_the_bound(seed):
    problem = tiny_problem(seed, 3, 1 + seed % 2, 900.0)
    bound = plan_bound(problem)
    best_s = best_makespan_s(problem)
    assert 0.0 < bound.makespan_s <= best_s
    assert bound.forced_stops == 1, "the first is too heavy for drones"


def test_of_a_truck_alone_the_bound_is_the_best_plan():
    """Nothing is relaxed then: deliveries, and the shortest tour."""
    problem = tiny_problem(3, 4, 1, 900.0)
    nobody = replace(problem.kinds[0], can_serve=np.zeros(problem.nodes, dtype=np.bool_))
    roads_s = floyd_warshall(problem.travel_s)  # without detours: no place is passed twice
    alone = replace(problem, kinds=(nobody,), travel_s=roads_s)
    assert plan_bound(alone).makespan_s == pytest.approx(best_makespan_s(alone))


def test_orders_that_only_drones_may_serve_take_the_fleets_time():
    problem = tiny_problem(5, 4, 1, 900.0)
    by_truck = problem.truck_can_serve.copy()
    by_truck[2:5] = False
    bound = plan_bound(replace(problem, truck_can_serve=by_truck))
    legs = problem.legs[0]
    least_s = [
        min(legs.out_s[a, j] + legs.back_s[j, b] for a in (0, 1, 5) for b in (0, 1, 5))
        for j in (2, 3, 4)
    ]
    assert bound.fleet_s == pytest.approx(sum(least_s) + 3 * 90.0)
    two = replace(problem.kinds[0], count=2)
    halved = plan_bound(replace(problem, truck_can_serve=by_truck, kinds=(two,)))
    assert halved.fleet_s == pytest.approx(bound.fleet_s / 2.0)


@pytest.mark.parametrize("seed", range(4))
def test_the_shortest_way_is_the_best_of_all_orders_by_scipys_shortest_roads(seed):
    travel_s = np.random.default_rng(seed).uniform(10.0, 100.0, (7, 7))
    np.fill_diagonal(travel_s, 0.0)
    places = [2, 3, 5]
    roads_s = floyd_warshall(travel_s)
    ways = [(0, *order, 6) for order in permutations(places)]
    least_s = min(sum(roads_s[a, b] for a, b in pairwise(way)) for way in ways)
    assert shortest_way_s(travel_s, places) == pytest.approx(least_s)


def test_a_long_search_drives_no_longer_and_never_below_the_bound():
    data = read_day(HARBOUR)
    start = first_state(data)
    tried = list(tried_plans(data, start, QUICK))
    anew = list(road_searched_plans(data, start, QUICK, 60, lambda done_frac, best_s: None))
    bound = plan_bound(day_problem(data, start))
    best = {one.name: one for one in reversed(tried)}  # the first of each search
    assert {after.name for after in anew} == {f"driven anew: {name}" for name in best}
    for after in anew:
        before = best[after.name.removeprefix("driven anew: ")]
        assert after.lost == 0
        assert bound.makespan_s <= after.driven_s <= before.driven_s + 1e-6


def test_the_command_prints_the_bound_and_what_was_driven_anew(tmp_path):
    words = ["benchmark", "day-plan", "--day", "harbour", "--trials", "500", "--drives", "20"]
    words += ["--json", str(tmp_path / "harbour.json")]
    done = CliRunner().invoke(app, words, env={"COLUMNS": "120"})
    assert done.exit_code == 0, done.output
    assert "no plan takes less than " in done.output
    assert done.output.count("driven anew: ") == 2
    written = msgspec.json.decode((tmp_path / "harbour.json").read_bytes(), type=DayPromises)
    again = StringIO()
    print_promises(Console(width=120, file=again), written)
    assert done.output.endswith(again.getvalue())


@pytest.mark.parametrize("seed", range(5))
def test_the_tree_past_many_places_is_no_longer_than_the_shortest_way(seed: int) -> None:
    """Both past six places, where the exact way is known; roads are faster one way than back."""
    travel_s = tiny_problem(seed, 6, 1, 900.0).travel_s * np.random.default_rng(seed).uniform(
        1.0, 1.5, (8, 8)
    )
    exact_s = shortest_way_s(travel_s, [1, 2, 3, 4, 5, 6])
    assert 0.3 * exact_s < spanning_way_s(travel_s, [1, 2, 3, 4, 5, 6]) <= exact_s


def test_many_places_for_the_truck_alone_have_a_bound() -> None:
    problem = tiny_problem(2, 16, 1, 900.0)
    nobody = replace(problem.kinds[0], can_serve=np.zeros(problem.nodes, dtype=np.bool_))
    bound = plan_bound(replace(problem, kinds=(nobody,)))
    assert bound.forced_stops == 16
    assert 0.0 < bound.way_s < bound.makespan_s
