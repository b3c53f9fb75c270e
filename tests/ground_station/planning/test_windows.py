"""Plans honour delivery windows and priorities as far as they can, and state what they cannot."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import initial_state
from ground_station.core.schema.order_window import late_text
from ground_station.core.schema.orders import Priority

HARBOUR = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
START_US = 1_777_629_600 * 1_000_000
MARGIN_S = 1.0


def planned(**fields_by_order: dict) -> DayPlan:
    """Plan the harbour's day with these fields; windows are in seconds of the day."""
    orders = []
    for order in HARBOUR.orders:
        fields = dict(fields_by_order.get(order.id.replace("-", "_"), {}))
        for key in ("earliest_us", "latest_us"):
            if key in fields:
                fields[key] = START_US + round(1e6 * fields[key])
        orders.append(msgspec.structs.replace(order, **fields))
    data = replace(HARBOUR, orders=orders, start_us=START_US)
    return plan_day(data, initial_state(data), PlanParams(trials=2000))


@cache
def without_windows() -> DayPlan:
    return plan_day(HARBOUR, initial_state(HARBOUR), PlanParams(trials=2000))


def at_s(plan: DayPlan, order: str) -> float:
    return plan.delivery_times_s()[order][0]


def by_drone_and_truck() -> tuple[str, str]:
    plan = without_windows()
    served = [order for stop in plan.stops for order in stop.serves]
    return plan.sorties[0].order, served[0]


def test_a_day_without_windows_has_the_same_plan_with_and_without_its_time():
    assert planned() == without_windows()


@pytest.mark.parametrize("kind", ["drone", "truck"])
def test_nothing_is_delivered_before_its_window(kind: str):
    order = by_drone_and_truck()[kind == "truck"]
    opens_s = at_s(without_windows(), order) + 500.0
    plan = planned(**{order.replace("-", "_"): {"earliest_us": opens_s}})
    times = plan.delivery_times_s()
    stops = {order_id: stop for stop in plan.stops for order_id in stop.serves}
    if order in stops:  # the driver waits at the customer
        assert stops[order].depart_s >= opens_s
    else:
        assert times[order][0] >= opens_s - MARGIN_S
    assert len(times) == len(without_windows().delivery_times_s())


def test_a_late_order_moves_before_the_end_of_its_window():
    times = without_windows().delivery_times_s()
    order = max(times, key=lambda one: times[one][0])
    closes_s = 0.6 * times[order][0]
    plan = planned(**{order.replace("-", "_"): {"latest_us": closes_s}})
    assert at_s(plan, order) <= closes_s < times[order][0]


def test_an_urgent_order_is_delivered_earlier():
    times = without_windows().delivery_times_s()
    order = max(times, key=lambda one: times[one][0])
    plan = planned(**{order.replace("-", "_"): {"priority": Priority.URGENT}})
    assert at_s(plan, order) < times[order][0] - 60.0


def test_a_window_that_cannot_be_kept_is_stated_and_the_order_is_delivered():
    order = by_drone_and_truck()[0]
    plan = planned(**{order.replace("-", "_"): {"latest_us": 1.0}})
    drop_s, how = plan.delivery_times_s()[order]
    latest_us = START_US + 1_000_000
    words = late_text((None, latest_us), START_US + round(1e6 * drop_s), how)
    assert words is not None
    assert words.startswith(f"arrives {-(-(drop_s - 1.0) // 60):.0f} min after its window")
    assert late_text((None, latest_us), latest_us, how) is None
