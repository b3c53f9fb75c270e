"""Time windows in the search: small optima by enumeration, the benchmark's files and rows."""

import json
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.benchmarks.tsptw_files import read_best_known, read_instance
from ground_station.app.cli.benchmark import benchmark
from ground_station.core.benchmark.tsptw import LATE_PRICE, TsptwInstance
from ground_station.core.truck_drones.schedule import simulate_schedule
from ground_station.core.truck_drones.search import SearchPolicy

CUSTOMERS = 7


def drawn_instance(seed: int, window_s: float) -> TsptwInstance:
    """Draw customers with windows that do not follow their order on a short tour."""
    rng = np.random.default_rng(seed)
    at_m = rng.uniform(0.0, 100.0, (CUSTOMERS + 1, 2))
    travel_s = np.linalg.norm(at_m[:, None] - at_m[None, :], axis=2)
    opens_s = rng.uniform(0.0, 300.0, CUSTOMERS + 1)
    opens_s[0] = 0.0
    closes_s = opens_s + window_s
    closes_s[0] = 1e6
    return TsptwInstance("drawn", travel_s, opens_s, closes_s)


def least_cost(instance: TsptwInstance) -> float:
    def cost(tour: tuple[int, ...]) -> float:
        now_s, here, late_s = 0.0, 0, 0.0
        for customer in tour:
            now_s = max(now_s + instance.travel_s[here, customer], instance.opens_s[customer])
            late_s += max(0.0, now_s - instance.closes_s[customer])
            here = customer
        return now_s + instance.travel_s[here, 0] + LATE_PRICE * late_s

    return min(cost(tour) for tour in permutations(range(1, CUSTOMERS + 1)))


@pytest.mark.usefixtures("compiled_planner")
@pytest.mark.parametrize(("seed", "window_s"), [(1, 20.0), (2, 60.0), (3, 150.0), (4, 1.0)])
def test_small_problems_are_solved_to_their_optimum(seed: int, window_s: float) -> None:
    instance = drawn_instance(seed, window_s)
    problem = instance.problem()
    plan = SearchPolicy(trials=20_000).plan(problem, np.random.default_rng(0))
    tour = [node for node in simulate_schedule(problem, plan).truck_route if 0 < node <= CUSTOMERS]
    makespan_s, late_s = instance.makespan_and_lateness_s(tour)
    assert makespan_s + LATE_PRICE * late_s == pytest.approx(least_cost(instance), abs=1e-3)


TINY = "3\n0 5 9\n5 0 4\n9 4 0\n0 100\n20 30\n0 12\n"


def test_the_benchmark_plans_checks_and_compares(tmp_path: Path, compiled_planner: None) -> None:
    (tmp_path / "tiny.txt").write_text(TINY)
    (tmp_path / "best").write_text("# instance value\ntiny.txt 25 0 2 1\n")
    out = tmp_path / "rows.json"
    options = ["--best-known", str(tmp_path / "best"), "--json", str(out)]
    result = CliRunner().invoke(benchmark, ["tsptw", str(tmp_path), *options])
    assert result.exit_code == 0, result.output
    assert "1 of 1" in result.output
    (row,) = json.loads(out.read_text())["rows"]
    assert row["tour"] == [2, 1]  # the second window closes before the first opens
    assert (row["makespan_s"], row["late_s"], row["best_known_s"]) == (25.0, 0.0, 25.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "0 nodes"),
        ("1\n0\n0 1\n", "1 nodes"),
        (TINY.replace("5 0 4", "5 0 nan"), ":3: 'nan'"),
        (TINY.replace("5 0 4", "5 0"), "15 numbers, expected 16"),
        (TINY.replace("20 30", "30 20"), ":6: window 30 to 20"),
        (TINY.replace("5 0 4", "-5 0 4"), "travel time -5"),
    ],
)
def test_a_broken_instance_is_refused_with_its_place(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "broken.txt"
    path.write_text(text)
    with pytest.raises(LeewayError, match=words) as caught:
        read_instance(path)
    assert str(path) in str(caught.value)


def test_broken_best_known_values_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "best.txt"
    path.write_text("a.txt 5\nb.txt\n")
    with pytest.raises(LeewayError, match=r":2: 'b\.txt'"):
        read_best_known(path)
