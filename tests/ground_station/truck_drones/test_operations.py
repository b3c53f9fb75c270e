"""One truck and one drone: the search against external optima, and the checker's canaries."""

import json
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise, permutations
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.benchmarks.tspd_files import (
    TspdInstance,
    read_instance,
    read_optimum_cost_or_none,
    read_reference_costs,
)
from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from ground_station.app.cli.benchmark import benchmark
from ground_station.core.benchmark.operations_check import plan_violations

pytestmark = pytest.mark.sample


@pytest.fixture(scope="module", autouse=True)
def _compiled_code_is_kept() -> None:
    """Enable the compile cache before the first import of the search."""
    enable_compile_cache_and_check_if_known()


SMALL = Path("../shared/data/tspd/uniform_small")
STREET = ((0.0, 0.0), (4.0, 0.0), (3.0, 0.0), (1.0, 0.0), (-4.0, 0.0))
"""One vehicle at least has to go 4 away and come back: with equal vehicles 8 is the least."""
STREET_PLAN = [(0, 0, 4, [3, 2, 1])]


def drawn_instance(seed: int, nodes: int, drone_cost: float) -> TspdInstance:
    """Instance with uniformly distributed locations."""
    rng = np.random.default_rng(seed)
    places = tuple((float(x), float(y)) for x, y in rng.uniform(0.0, 100.0, (nodes, 2)))
    return TspdInstance(f"drawn-{seed}", "drawn", 1.0, drone_cost, places)


def optimum_of(instance: TspdInstance) -> float:
    """Return the minimum cost by dynamic programming over served sets and the meeting node. No node
    is visited twice except the start of an operation.
    """
    places = instance.points

    def apart(one: int, other: int) -> float:
        return math.dist(places[one], places[other])

    customers = range(1, len(places))
    best = {(frozenset[int](), 0): 0.0}
    for count in range(len(places)):
        for (served, start), cost in [item for item in best.items() if len(item[0][0]) == count]:
            left = [node for node in customers if node not in served]
            for size in range(1, len(left) + 1):
                for route in permutations(left, size):
                    for new, stop, path, fly in _operations(route, start):
                        truck = sum(apart(a, b) for a, b in pairwise(path))
                        drone = 0.0 if fly is None else apart(start, fly) + apart(fly, stop)
                        longer = max(instance.truck_cost * truck, instance.drone_cost * drone)
                        key = (served | new, stop)
                        best[key] = min(best.get(key, math.inf), cost + longer)
    everybody = frozenset(customers)
    return min(
        cost + instance.truck_cost * apart(stop, 0)
        for (served, stop), cost in best.items()
        if served == everybody
    )


def _operations(
    route: Sequence[int], start: int
) -> Iterator[tuple[frozenset[int], int, list[int], int | None]]:
    """Yield the operations of a route: all nodes by truck, or the first by drone; ending at the
    last node, at the start, or at the depot.
    """
    new = frozenset(route)
    if len(route) == 1:
        yield new, route[0], [start, route[0]], None
    for stop in {route[-1], start, 0} if len(route) > 1 else {start, 0}:
        by_truck = route[1:-1] if stop == route[-1] else route[1:]
        yield new, stop, [start, *by_truck, stop], route[0]


@pytest.mark.sample
@pytest.mark.drawn(keep=2)
@pytest.mark.parametrize("seed", range(4))
def test_small_instances_are_solved_to_the_optimum_of_an_exhaustive_program(seed: int) -> None:
    from ground_station.app.benchmarks.tspd_bench import plan_and_check_instance

    instance = drawn_instance(seed, 6, (1.0, 0.5, 1.0 / 3.0, 0.7)[seed])
    row = plan_and_check_instance(instance, None, 0)
    assert row["cost"] == pytest.approx(optimum_of(instance), rel=1e-9)


@pytest.mark.sample
def test_truck_and_drone_share_a_street() -> None:
    from ground_station.app.benchmarks.tspd_bench import plan_and_check_instance

    row = plan_and_check_instance(TspdInstance("street", "made", 1.0, 1.0, STREET), None, 0)
    assert row["cost"] == pytest.approx(8.0)


def test_the_same_seed_makes_the_same_plan_and_no_search_beats_what_the_checker_sums() -> None:
    from ground_station.app.benchmarks.tspd_bench import plan_and_check_instance

    instance = drawn_instance(7, 30, 0.5)
    one, other = (plan_and_check_instance(instance, None, 3) for _ in range(2))
    assert one["operations"] == other["operations"]
    truck_alone = plan_violations(
        instance.points, 1.0, 0.5, [(0, 0, -1, list(range(1, 30)))], one["cost"]
    )
    assert "is reported" in truck_alone[0]
    assert len(truck_alone) == 1


@pytest.mark.sample
@pytest.mark.drawn(keep=2)
@pytest.mark.parametrize("name", ["1-n11", "7-n13", "9-n11", "4-n15", "3-n17"])
def test_proven_optima_are_reached_to_a_thousandth(name: str) -> None:
    path = SMALL / f"uniform-{name}.txt"
    if not path.exists():
        pytest.skip("the published instances are not here")
    from ground_station.app.benchmarks.tspd_bench import plan_and_check_instance

    optimum = read_optimum_cost_or_none(path)
    assert optimum is not None
    cost = plan_and_check_instance(read_instance(path), None, 0)["cost"]
    assert optimum * (1.0 - 1e-9) <= cost <= optimum * 1.001


def test_the_checker_accepts_a_right_plan() -> None:
    assert plan_violations(STREET, 1.0, 1.0, STREET_PLAN, 8.0) == []


@pytest.mark.parametrize(
    ("operations", "cost", "said"),
    [
        (STREET_PLAN, 7.9, "is reported"),
        ([(0, 0, 4, [1, 2])], 8.0, "not served: 1, the first is node 3"),
        ([(0, 3, -1, []), (0, 0, 1, [2, 4])], 9.0, "begins at 0, the last one ended at 3"),
        ([(0, 3, 1, [2, 4])], 9.0, "the plan ends at 3"),
        ([*STREET_PLAN, (0, 0, 2, [2])], 10.0, "the drone serves 2, a node of the truck"),
        ([(0, 0, 9, [1, 2, 3, 4])], 9.0, "there is no node 9"),
        (STREET_PLAN, math.nan, "is reported"),
    ],
)
def test_the_checker_says_what_is_wrong(operations, cost: float, said: str) -> None:
    assert any(said in fault for fault in plan_violations(STREET, 1.0, 1.0, operations, cost))


def write_instance(folder: Path, name: str, places=STREET, drone: str = "1.0") -> Path:
    """An instance in the published format."""
    lines = ["/*The speed of the Truck*/", "1.0", "/*The speed of the Drone*/", drone]
    lines += ["/*Number of Nodes*/", str(len(STREET)), "/*The Depot*/"]
    lines += [f"{x} {y} loc{node}" for node, (x, y) in enumerate(places)]
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def test_wrong_files_are_named_with_their_line(tmp_path: Path) -> None:
    with pytest.raises(LeewayError, match=r"few.txt:6: 5 nodes, but 4 places follow"):
        read_instance(write_instance(tmp_path, "few.txt", STREET[:4]))
    with pytest.raises(LeewayError, match=r"word.txt:4: 'fast' is not a number"):
        read_instance(write_instance(tmp_path, "word.txt", drone="fast"))
    with pytest.raises(LeewayError, match=r"zero.txt:4: cost 0, expected more than 0"):
        read_instance(write_instance(tmp_path, "zero.txt", drone="0"))
    with pytest.raises(LeewayError, match=r"nan.txt:4: 'nan' is not a finite number"):
        read_instance(write_instance(tmp_path, "nan.txt", drone="nan"))
    means = tmp_path / "means.csv"
    means.write_text("set,alpha,n\nuniform,1,many\n")
    with pytest.raises(LeewayError, match=r"means.csv:2: not a row of means"):
        read_reference_costs(means)


def test_the_command_plans_a_folder_and_compares_with_what_is_known(tmp_path: Path) -> None:
    path = write_instance(tmp_path, "street.txt")
    path.with_name("street-DP.txt").write_text("/* Total cost : 8.0 */\n")
    out = tmp_path / "rows.json"
    done = CliRunner().invoke(
        benchmark, ["tspd", str(tmp_path), "--seconds", "0.1", "--json", str(out)]
    )
    assert done.exit_code == 0, done.output
    assert "proven optima: 1; above by more than 0.1 %: 0" in done.output
    (row,) = json.loads(out.read_text())["rows"]
    assert row["cost"] == pytest.approx(8.0)
    assert plan_violations(STREET, 1.0, 1.0, row["operations"], row["cost"]) == []
    assert {"instance", "n", "alpha", "cost", "seconds", "operations"} <= set(row)
    assert not (tmp_path / "rows.json.journal").exists()
