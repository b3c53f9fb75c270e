"""The truck-and-drone planner against published optima and an independent checker."""

import copy
import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.benchmarks.mfstsp_files import (
    read_problem,
    read_reference_results,
    read_vehicles,
)
from ground_station.app.benchmarks.mfstsp_bench import (
    BenchParams,
    BenchRow,
    inputs_and_planner_source_digest,
    problem_for_checker,
    row_progress_log,
    rows_to_plan,
    solve_row,
)
from ground_station.app.cli.benchmark import benchmark
from ground_station.core.benchmark.mfstsp import truck_and_drones_problem
from ground_station.core.benchmark.schedule_check import (
    schedule_violations,
    sortie_duration_limits_s,
)
from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.problem import DroneKind, LegTables, TruckAndDrones
from ground_station.core.truck_drones.schedule import Schedule, simulate_schedule
from ground_station.core.truck_drones.search import SearchPolicy
from ground_station.core.truck_drones.tables import tables_of
from ground_station.core.truck_drones.tour import short_tour_over_customers

pytestmark = pytest.mark.usefixtures("compiled_planner")

DATA = Path("../shared/data/mfstsp")
VEHICLES = """% a comment line
1,1,-1,-1,-1,-1,-1,-1,-1,-1,30,-1,NA
2,2,15.6464,31.2928,7.8232,360,50,5,60,30,60,457503,low
3,2,15.6464,31.2928,7.8232,360,50,5,60,30,60,457503,low
"""
"""Vehicle file 101 of the published problems, with two of its drones."""


def problem_folder(root: Path, customers: int = 8) -> Path:
    """A problem in the published format; customer 2 is too heavy for a drone."""
    rng = np.random.default_rng(5)
    folder = root / "p1"
    folder.mkdir()
    (root / "tbl_vehicles_101.csv").write_text(VEHICLES)
    lat_lon = np.array([47.6, -122.3]) + rng.uniform(-0.04, 0.04, (customers + 1, 2))
    weights = [-1.0, 2.0, 100.0, *([3.0] * (customers - 2))]
    places = [
        f"{node}, {int(node > 0)}, {lat:.6f}, {lon:.6f}, 0.0, {weights[node]}"
        for node, (lat, lon) in enumerate(lat_lon.tolist())
    ]
    (folder / "tbl_locations.csv").write_text("% head\n" + "\n".join(places) + "\n")
    far_s = 9000.0 * np.linalg.norm(lat_lon[:, None] - lat_lon[None, :], axis=2)
    roads = [
        f"{i}, {j}, {far_s[i, j] * (1.0 + 0.1 * (i > j)):.6f}, 0.0"
        for i in range(customers + 1)
        for j in range(customers + 1)
    ]
    (folder / "tbl_truck_travel_data_PG.csv").write_text("% head\n" + "\n".join(roads) + "\n")
    return folder


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, dict[str, Any]]:
    """A problem for the checker, and a row that it accepts."""
    folder = problem_folder(tmp_path_factory.mktemp("solved"))
    row = solve_row(BenchRow(folder, "101", 2), BenchParams(0.2, 0))
    return checked(folder, "101", 2), row


def checked(folder: Path, vehicles: str, drones: int) -> Any:
    fleet = read_vehicles(folder.parent / f"tbl_vehicles_{vehicles}.csv")
    return problem_for_checker(read_problem(folder), fleet.drones[0], fleet.deliver_s, drones)


def test_takeoff_and_landing_take_what_the_published_rules_say(tmp_path: Path):
    """The benchmark's rules: 3.6956 s and 6.3913 s for vehicle file 101."""
    folder = problem_folder(tmp_path)
    drone = read_vehicles(folder.parent / "tbl_vehicles_101.csv").drones[0]
    assert drone.climb_and_turn_s == pytest.approx(3.6956, abs=5e-5)
    assert drone.landing_s == pytest.approx(6.3913, abs=1e-4)  # 50 m / 7.8232 m/s is 6.39125 s


def test_sortie_times_and_endurance_agree_with_the_checkers_own_sums(tmp_path: Path):
    folder = problem_folder(tmp_path)
    fleet = read_vehicles(folder.parent / "tbl_vehicles_101.csv")
    problem = truck_and_drones_problem(read_problem(folder), fleet.drones[0], 2, fleet.deliver_s)
    legs, judge = problem.leg_tables[0], checked(folder, "101", 2)
    for launch, customer, meet in ((0, 1, 3), (4, 5, 9), (6, 7, 1)):
        least_s, most_s = sortie_duration_limits_s(judge, launch, customer, meet)
        fly_s = legs.out_s[launch, customer] + legs.back_s[customer, meet]
        spent_s = legs.out_hover_s[launch, customer] + legs.back_hover_s[customer, meet]
        assert fly_s == pytest.approx(least_s, abs=1e-6)
        assert fly_s + legs.endurance_hover_s - spent_s == pytest.approx(most_s, abs=1e-6)


@pytest.mark.sample
@pytest.mark.parametrize(
    ("problem", "vehicles", "drones"),
    [
        ("20170608T121355407419", "101", 2),  # the benchmark's rules: 3257.554 s
        ("20170608T121426910678", "103", 4),  # the driver must wait for a drone before delivering
        ("20170608T121458174165", "104", 3),
    ],
)
def test_proven_optima_of_the_published_problems_are_met_and_not_beaten(
    problem: str, vehicles: str, drones: int
):
    if not (DATA / problem).is_dir():
        pytest.skip(f"{DATA} is not here")
    _, program = read_reference_results(DATA / "reference_results.csv")
    proven = program[problem, vehicles, drones]
    assert proven.is_optimal
    row = solve_row(BenchRow(DATA / problem, vehicles, drones), BenchParams(None, 0))
    assert row["makespan_s"] == pytest.approx(proven.makespan_s, abs=0.01)


def _sooner(row: dict[str, Any]) -> None:
    row["makespan_s"] -= 1.0


def _skipped_customer(row: dict[str, Any]) -> None:
    del row["sorties"][0]


def _faster_truck(row: dict[str, Any]) -> None:
    for stop in row["truck"][1:]:
        stop["arrive_s"] -= 5.0


def _two_things_at_once(row: dict[str, Any]) -> None:
    tasks = row["driver"]
    launch = next(task for task in tasks if task["what"] == "launch")
    other = next(t for t in tasks if t["node"] == launch["node"] and t is not launch)
    length_s = other["end_s"] - other["start_s"]
    other["start_s"], other["end_s"] = launch["start_s"], launch["start_s"] + length_s


def _hasty_launch(row: dict[str, Any]) -> None:
    task = next(task for task in row["driver"] if task["what"] == "launch")
    task["end_s"] -= 20.0


def _one_drone_for_all(row: dict[str, Any]) -> None:
    for part in (*row["sorties"], *row["driver"]):
        part["drone"] = None if part["drone"] is None else 1


def _met_before_it_can_be_back(row: dict[str, Any]) -> None:
    """Set the drone's recovery to start 30 s before its landing, with all else unchanged."""
    task = max((t for t in row["driver"] if t["what"] == "recover"), key=lambda t: t["end_s"])
    task["start_s"] -= 30.0


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (_sooner, "all are back at"),
        (_skipped_customer, "each of 1 to 8 once"),
        (_faster_truck, "too early"),
        (_two_things_at_once, "two things"),
        (_hasty_launch, "takes"),
        (_one_drone_for_all, "drone 1"),
        (_met_before_it_can_be_back, "takes"),
    ],
)
def test_the_checker_finds_what_is_wrong_with_a_spoilt_row(
    solved: tuple[Any, dict[str, Any]], spoil: Any, said: str
):
    problem, row = solved
    assert schedule_violations(problem, row) == []
    spoilt = copy.deepcopy(row)
    spoil(spoilt)
    assert said in "; ".join(schedule_violations(problem, spoilt))


def test_the_checker_refuses_a_parcel_too_heavy_and_a_battery_too_small(
    solved: tuple[Any, dict[str, Any]],
):
    problem, row = solved
    flown = row["sorties"][0]["customer"]
    heavy = [100.0 if node == flown else lb for node, lb in enumerate(problem.parcels_lb)]
    assert "carries 5" in "; ".join(schedule_violations(replace(problem, parcels_lb=heavy), row))
    weak = replace(problem, drone=replace(problem.drone, battery_j=100_000.0))
    assert "after its launch" in "; ".join(schedule_violations(weak, row))


def mixed_problem(seed: int) -> TruckAndDrones:
    """Two kinds of drones, a location without a road, customers only for the truck or one kind."""
    rng = np.random.default_rng(seed)
    nodes = 22
    place = rng.uniform(-3000.0, 3000.0, (nodes, 2))
    place[-1] = place[0] = 0.0
    far_m = np.linalg.norm(place[:, None] - place[None, :], axis=2)
    is_customer = np.ones(nodes, dtype=np.bool_)
    is_customer[[0, -1]] = False
    by_road = is_customer.copy()
    by_road[7] = False
    quick, slow = is_customer.copy(), is_customer.copy()
    quick[[3, 4]], slow[[3, 5]] = False, False
    legs = tuple(
        LegTables(far_m / mps + 90.0, far_m / mps + 30.0, far_m / 10.0 + 60.0, far_m / 11.0, 900.0)
        for mps in (15.0, 9.0)
    )
    return TruckAndDrones(
        travel_s=1.3 * far_m / 9.0,
        deliver_s=np.where(is_customer, 60.0, 0.0),
        kinds=(DroneKind(2, 60.0, 30.0, quick), DroneKind(1, 20.0, 10.0, slow)),
        leg_tables=legs,
        truck_can_serve=by_road,
    )


def assert_everyone_is_served_once(problem: TruckAndDrones, schedule: Schedule) -> None:
    flown = [sortie.customer for sortie in schedule.sorties]
    driven = list(schedule.truck_route[1:-1])
    assert sorted(driven + flown) == list(range(1, problem.end_node))
    assert all(problem.truck_can_serve[node] for node in driven)
    for sortie in schedule.sorties:
        kind = 0 if sortie.drone < problem.kinds[0].count else 1
        assert problem.kinds[kind].can_serve[sortie.customer]
    for drone in range(sum(kind.count for kind in problem.kinds)):
        own = [task.what for task in schedule.driver if task.drone == drone]
        assert own == ["launch", "recover"] * (len(own) // 2)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_policy_serves_each_customer_once_by_whom_can(seed: int):
    problem = mixed_problem(seed)
    for policy in (DynamicAssignment(), SearchPolicy(trials=50_000)):
        plan = policy.plan(problem, np.random.default_rng(seed))
        assert_everyone_is_served_once(problem, simulate_schedule(problem, plan))


def test_the_search_ends_the_day_sooner_than_the_papers_assignment():
    problem = mixed_problem(0)
    rng = np.random.default_rng(0)
    ours_s = simulate_schedule(problem, SearchPolicy(trials=100_000).plan(problem, rng)).makespan_s
    theirs_s = simulate_schedule(problem, DynamicAssignment().plan(problem, rng)).makespan_s
    assert ours_s < 0.9 * theirs_s


def test_the_same_seed_and_trials_give_the_same_plan_and_another_seed_another():
    problem = mixed_problem(1)
    plans = [
        SearchPolicy(trials=20_000).plan(problem, np.random.default_rng(seed)) for seed in (3, 3, 4)
    ]
    assert (plans[0] == plans[1]).all()
    assert (plans[0] != plans[2]).any()


def test_customers_whom_nobody_can_serve_are_named():
    problem = mixed_problem(0)
    nobody = problem.truck_can_serve.copy()
    nobody[[3, 9]] = False  # no drone serves 3; one serves 9
    lost = TruckAndDrones(
        problem.travel_s, problem.deliver_s, problem.kinds, problem.leg_tables, nobody
    )
    with pytest.raises(LeewayError, match=r"customers \[3\]"):
        SearchPolicy(trials=10).plan(lost, np.random.default_rng(0))


def test_a_tour_along_a_circle_is_the_circle():
    """The shortest closed tour of points on a convex curve follows the curve."""
    count = 40
    angle = 2.0 * math.pi * np.random.default_rng(2).permutation(count) / count
    place = np.column_stack([np.cos(angle), np.sin(angle)])
    place = np.vstack([place, place[:1]])
    far = np.linalg.norm(place[:, None] - place[None, :], axis=2)
    no_legs = LegTables(far, far, far, far, 0.0)
    nobody = np.zeros(count + 1, dtype=np.bool_)
    problem = TruckAndDrones(
        far, np.zeros(count + 1), (DroneKind(1, 0.0, 0.0, nobody),), (no_legs,), ~nobody
    )
    tour = short_tour_over_customers(tables_of(problem), list(range(1, count)))
    driven = sum(far[a, b] for a, b in pairwise(tour))
    assert driven == pytest.approx(2.0 * count * math.sin(math.pi / count))


def test_the_command_writes_the_rows_of_the_contract_and_takes_up_what_was_done(tmp_path: Path):
    """The driver rules of the published problems (docs/reference/benchmarks.md)."""
    problem_folder(tmp_path)
    out = tmp_path / "out.json"
    asked = ["mfstsp", str(tmp_path), "--vehicles", "101", "--drones", "1,2", "--seconds", "0.1"]
    rows = rows_to_plan([tmp_path / "p1"], ["101"], [1, 2])
    done = solve_row(rows[0], BenchParams(0.1, 0)) | {"seconds": 77.0}
    journal = row_progress_log(out, inputs_and_planner_source_digest(rows, BenchParams(0.1, 0)))
    assert journal is not None
    with journal.rewrite_and_open_writer({0: done}):
        pass
    result = CliRunner().invoke(benchmark, [*asked, "--json", str(out)])
    assert result.exit_code == 0, result.output
    written = json.loads(out.read_text())["rows"]
    assert [row["drones"] for row in written] == [1, 2]
    assert written[0]["seconds"] == 77.0  # read from the journal, not planned again
    assert not (tmp_path / "out.json.journal").exists()
    keys = "problem vehicles drones makespan_s seconds truck_route sorties driver truck"
    assert set(written[1]) == set(keys.split())
    assert set(written[1]["sorties"][0]) == {"drone", "launch", "customer", "rendezvous"}
    assert set(written[1]["driver"][0]) == {"what", "node", "drone", "start_s", "end_s"}
    assert set(written[1]["truck"][0]) == {"node", "arrive_s", "depart_s"}


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("tbl_locations.csv", "\n3, 1", "\n4, 1", "tbl_locations.csv:5: node 4, expected 3"),
        ("tbl_locations.csv", "100.0", "heavy", "tbl_locations.csv:4: 'heavy' is not a number"),
        ("tbl_truck_travel_data_PG.csv", "\n0, 1,", "\n0, 99,", "from 0 to 99: nodes are 0 to 8"),
        ("tbl_truck_travel_data_PG.csv", "\n2, 1,", "\n2, 0,", "no time from 2 to 1"),
    ],
)
def test_a_mistake_in_a_problem_file_is_told_with_its_place(
    tmp_path: Path, file: str, old: str, new: str, said: str
):
    path = problem_folder(tmp_path) / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(LeewayError, match=said):
        read_problem(path.parent)
