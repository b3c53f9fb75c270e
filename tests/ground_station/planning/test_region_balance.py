"""Regions whose trucks come back together: less work for who is late, the best division kept."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.adapters.files.params import params_dir
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.workers.side_by_side import Workers
from ground_station.app.planning import region_balance
from ground_station.app.planning.region_balance import (
    BalanceRound,
    ShortPlans,
    balanced,
    next_share,
)
from ground_station.app.planning.region_days import PlanWork, RegionDay, RegionPlanned, divided
from ground_station.core.schema.day_plan import DayPlan, Unplanned

TOWN = params_dir() / "days" / "town.toml"


def ids_of(regions: Sequence[RegionDay]) -> list[set[str]]:
    return [{order.id for order in region.data.orders} for region in regions]


def short_plans(folder: Path) -> ShortPlans:
    return ShortPlans(400, 0, Workers(1, None), folder, [TOWN] * 2)


def test_who_is_back_late_gets_less_and_later_rounds_change_less() -> None:
    even = np.full(4, 0.25)
    back_s = np.array([3000.0, 2000.0, 2500.0, 2500.0])
    first, fifth = next_share(even, back_s, 1), next_share(even, back_s, 5)
    for found in (first, fifth):
        assert math.isclose(found.sum(), 1.0)
        assert found[0] < found[2] == found[3] < found[1]
    assert 0.25 - first[0] > 1.5 * (0.25 - fifth[0]) > 0.0


def test_a_little_other_share_moves_few_orders_over_the_border() -> None:
    """From the division before, though another has the same work: the trucks changed over."""
    data = read_day(TOWN)
    west, east = ids_of(before := divided([data], [2]))
    for now, then in zip(
        ids_of(divided([data], [2], None, before[::-1])), (east, west), strict=True
    ):
        assert len(now ^ then) <= 4 < len(now)
    fewer, more = ids_of(divided([data], [2], np.array([0.4, 0.6]), before[::-1]))
    assert fewer < east
    assert more > west
    assert len(east - fewer) <= 8


def test_the_division_whose_plans_end_first_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With real plans, short ones."""
    monkeypatch.setattr(region_balance, "ROUNDS", 3)
    data = read_day(TOWN)
    regions = divided([data], [2])
    told: list[BalanceRound] = []
    short = short_plans(tmp_path)
    found = balanced([data], [2], regions, short, told.append)
    assert list(tmp_path.iterdir()) == []
    assert 1 <= len(told) <= 3
    ids = [id_ for region in found for id_ in sorted(ids_of([region])[0])]
    assert sorted(ids) == sorted(order.id for order in data.orders)
    plans = [one.plan for one in short.made(found)]
    last_s = max(plan.makespan_s for plan in plans if plan is not None)
    assert math.isclose(last_s, min(one.last_s for one in told))


def answering(
    back_s: Callable[[RegionDay], float | None],
    plan: DayPlan,
    nobody: Callable[[RegionDay], int] = lambda region: 0,
) -> object:
    """In place of the planner: a plan that takes so long and leaves so many orders to nobody; None:
    its process was killed twice.
    """

    def planned(
        regions: Sequence[RegionDay], work: Sequence[PlanWork], *rest: object
    ) -> list[RegionPlanned]:
        assert [Path(one.path).exists() for one in work] == [True] * len(regions)
        made: list[RegionPlanned] = []
        for region in regions:
            took_s = back_s(region)
            if took_s is None:
                made.append(RegionPlanned(region, None, 0.0, "killed twice"))
            else:
                left = [
                    Unplanned(order=f"left-{k}", why="no slot", remedy="none")
                    for k in range(nobody(region))
                ]
                changed = msgspec.structs.replace(plan, makespan_s=took_s, unplanned=left)
                made.append(RegionPlanned(region, changed, 1.0))
        return made

    return planned


@pytest.fixture(scope="module")
def a_plan() -> DayPlan:
    from ground_station.core.planning.day_planner import PlanParams, plan_day
    from ground_station.core.schema.day_state import first_state

    data = read_day(TOWN)
    data = replace(data, orders=data.orders[:3])
    return plan_day(data, first_state(data), PlanParams(trials=20))


def test_trucks_come_back_together_where_half_of_the_town_is_slow(
    a_plan: DayPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An order east of the middle takes three times as long, which no measure of work says."""
    data = read_day(TOWN)
    middle_deg = float(np.median([order.lon_deg for order in data.orders]))

    def takes_s(region: RegionDay) -> float:
        return sum(300.0 if o.lon_deg > middle_deg else 100.0 for o in region.data.orders)

    monkeypatch.setattr(region_balance, "planned", answering(takes_s, a_plan))
    regions = divided([data], [2])
    before = np.array([takes_s(region) for region in regions])
    told: list[BalanceRound] = []
    found = balanced([data], [2], regions, short_plans(tmp_path), told.append)
    after = np.array([takes_s(region) for region in found])
    assert math.isclose(told[0].last_s, before.max())
    assert math.isclose(told[0].cpu_s, 2.0)
    assert before.max() > 1.2 * before.mean(), "the town is uneven, or nothing is shown"
    assert after.max() < 1.06 * after.mean(), "within an order of 300 s"


def test_where_a_plan_is_lost_the_best_so_far_stands(
    a_plan: DayPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []

    def takes_s(region: RegionDay) -> float | None:
        calls.append(region.name)
        return None if len(calls) == 4 else 100.0 * len(region.data.orders) * len(calls)

    monkeypatch.setattr(region_balance, "planned", answering(takes_s, a_plan))
    data = read_day(TOWN)
    regions = divided([data], [2])
    told: list[BalanceRound] = []
    assert balanced([data], [2], regions, short_plans(tmp_path), told.append) is regions
    assert [one.number for one in told] == [1]


def test_who_leaves_orders_to_nobody_is_not_back_early(
    a_plan: DayPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trucks that hold 22 orders: what is more stays behind, and the truck is back at once."""

    def left(region: RegionDay) -> int:
        return max(0, len(region.data.orders) - 22)

    def takes_s(region: RegionDay) -> float:
        if left(region):
            return 10.0
        return 100.0 * len(region.data.orders) * (1.5 if region.name.endswith("1") else 1.0)

    monkeypatch.setattr(region_balance, "planned", answering(takes_s, a_plan, left))
    data = read_day(TOWN)
    regions = divided([data], [2])
    told: list[BalanceRound] = []
    found = balanced([data], [2], regions, short_plans(tmp_path), told.append)
    assert told[0].nobody == 0
    assert max(one.nobody for one in told) > 0, "a division was tried that is none"
    assert [left(region) for region in found] == [0, 0]
    assert max(map(takes_s, found)) <= told[0].last_s


@pytest.mark.parametrize("back_s", [(0.0, 0.0, 0.0), (0.0, 3000.0, 2000.0), (1.0, 1e6, 1.0)])
def test_shares_stay_shares_whatever_a_plan_says(back_s: tuple[float, ...]) -> None:
    share = np.full(3, 1.0 / 3.0)
    for number in range(1, 20):
        share = next_share(share, np.array(back_s), number)
        assert math.isclose(share.sum(), 1.0)
        assert share.min() > 0.05
