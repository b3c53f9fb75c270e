"""A plan on a terminal of 80 columns."""

import io
from itertools import pairwise
from pathlib import Path

from rich.console import Console

from ground_station.adapters.files.day_files import read_day
from ground_station.app.views.plan_view import print_plan_tables
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop

HARBOUR = Path(__file__).parents[3] / "params" / "days" / "harbour.toml"


def plan_with(names: list[str]) -> DayPlan:
    """A plan whose sorties launch and land at every pair of stops of these names."""
    data = read_day(HARBOUR)
    place = data.day.depot.location
    stops = [
        PlannedStop(id=name, location=place, arrive_s=60.0 * k, depart_s=60.0 * k + 30.0, serves=[],
                    pads={}) for k, name in enumerate(names)
    ]  # fmt: skip
    sorties = [
        PlannedSortie(
            order=f"T-10{k}", vehicle="d12", launch=launch, home=home, launch_s=4210.0,
            land_s=5475.0, outbound_height_m=143.0, return_height_m=143.0, energy_wh=101.0,
            required_wh=112.0, usable_wh=118.0, alternative_stops=[],
        )
        for k, (launch, home) in enumerate(pairwise(names))
    ]  # fmt: skip
    return DayPlan(
        format="day-plan/1",
        day="harbour",
        policy="search",
        seed=0,
        trials=1,
        makespan_s=6000.0,
        stops=stops,
        sorties=sorties,
        unplanned=[],
        revision=0,
    )


def shown(plan: DayPlan, columns: int) -> list[str]:
    out = io.StringIO()
    print_plan_tables(Console(file=out, width=columns), read_day(HARBOUR), plan)
    return out.getvalue().splitlines()


def test_the_drivers_time_is_itemised_and_adds_up():
    plan = plan_with(["depot", "stop-1", "depot-end"])
    truck = read_day(HARBOUR).day.truck
    (line,) = (line for line in shown(plan, 120) if line.startswith("driver:"))
    minutes = [text.split()[-1].split(":") for text in line.removeprefix("driver:").split(",")]
    times_s = [60 * int(m) + int(s) for m, s in minutes]
    assert times_s[:4] == [2 * truck.launch_s, 2 * truck.recover_s, 0, 60]
    assert sum(times_s) == plan.makespan_s


def test_names_that_begin_alike_are_told_apart_on_eighty_columns():
    names = ["depot", "r2-stop-1", "r2-stop-10", "r2-depot-end"]
    lines = shown(plan_with(names), 80)
    assert max(map(len, lines)) <= 80
    words = [line.split() for line in lines]
    for k, (launch, home) in enumerate(pairwise(names)):
        assert [f"T-10{k}", "d12", launch, home, "70:10", "91:15"] in [w[:6] for w in words]
    assert all(any(w[:1] == [name] for w in words) for name in names)


def test_start_and_landing_have_columns_of_their_own():
    words = " ".join(shown(plan_with(["depot", "depot-end"]), 80)).split()
    assert {"launched", "lands", "starts"} <= set(words)
