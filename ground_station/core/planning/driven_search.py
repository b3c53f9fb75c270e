"""A long search of plans as they are driven: each trial is one small change, carried out whole.

The planner's own search prices plans by its tables, and only the best few are driven. Here the
forward pass itself is the price, with its pads, layers and launches put off, at thousands of times
the cost. It tells how far the planner's choice is from what else could be driven, for example with
other stops of launch and landing. Too slow for a desk.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ground_station.core.planning.asked_day import AskedDay
from ground_station.core.planning.forward_pass import ForwardPass, ForwardSchedule
from ground_station.core.planning.launch_slots import SortieRequest
from ground_station.core.truck_drones.problem import TruckAndDrones

HOT_S, COLD_S = 30.0, 2.0
"""Temperatures, s of makespan: of a wave of launches, and of next to nothing."""
LOST_S = 10_000.0
"""What an order that is not served costs: more than any day."""


def searched_on_the_road(
    drive: ForwardPass,
    problem: TruckAndDrones,
    start: AskedDay,
    rng: np.random.Generator,
    drives: int,
    tell: Callable[[float, float], None] = lambda done_frac, best_s: None,
) -> tuple[AskedDay, ForwardSchedule]:
    """The best plan that simulated annealing finds from `start` in so many drives."""
    now = best = start
    driven = best_driven = drive.driven(start)
    now_s = best_s = cost_s(driven)
    for number in range(drives):
        temperature_s = HOT_S * (COLD_S / HOT_S) ** (number / drives)
        tried = changed(now, problem, rng)
        if tried is None:
            continue
        driven = drive.driven(tried)
        if cost_s(driven) > now_s - temperature_s * math.log(1.0 - rng.random()):
            continue
        now, now_s = tried, cost_s(driven)
        if now_s < best_s:
            best, best_s, best_driven = now, now_s, driven
            tell((number + 1) / drives, best_s)
    return best, best_driven


def cost_s(driven: ForwardSchedule) -> float:
    """The makespan, and far more for each order that is lost; inf where nothing is driven."""
    if not driven.stops:
        return math.inf
    return driven.makespan_s + LOST_S * len(driven.lost)


def changed(plan: AskedDay, problem: TruckAndDrones, rng: np.random.Generator) -> AskedDay | None:
    """One small change; None where the one that was drawn is none."""
    move = MOVES[int(rng.integers(len(MOVES)))]
    return move(plan, problem, rng)


def _other_stops(
    plan: AskedDay, problem: TruckAndDrones, rng: np.random.Generator
) -> AskedDay | None:
    """A sortie is launched at another stop, met at another one, or both at the same other one."""
    if not plan.wishes:
        return None
    at = int(rng.integers(len(plan.wishes)))
    wish = plan.wishes[at]
    place = {node: number for number, node in enumerate(plan.route)}
    node = plan.route[int(rng.integers(len(plan.route)))]
    which = int(rng.integers(3))
    launch = node if which != 1 else wish.launch
    meet = node if which != 0 else wish.meet
    if place[launch] > place[meet] or (launch, meet) == (wish.launch, wish.meet):
        return None
    if not _reaches(problem, wish.kind, launch, wish.customer, meet):
        return None
    moved = replace(wish, launch=launch, meet=meet)
    return replace(plan, wishes=(*plan.wishes[:at], moved, *plan.wishes[at + 1 :]))


def _other_order(
    plan: AskedDay, _problem: TruckAndDrones, rng: np.random.Generator
) -> AskedDay | None:
    """A sortie is launched sooner or later among the others."""
    if len(plan.wishes) < 2:
        return None
    wishes = list(plan.wishes)
    wish = wishes.pop(int(rng.integers(len(wishes))))
    wishes.insert(int(rng.integers(len(wishes) + 1)), wish)
    return replace(plan, wishes=tuple(wishes))


def _other_route(
    plan: AskedDay, problem: TruckAndDrones, rng: np.random.Generator
) -> AskedDay | None:
    """Part of the round is driven the other way about (2-opt), or a stop comes elsewhere."""
    if len(plan.route) < 4:
        return None
    first, last = sorted(rng.integers(1, len(plan.route) - 1, 2).tolist())
    if first == last:
        return None
    inner = list(plan.route)
    if rng.random() < 0.5:
        inner[first : last + 1] = inner[first : last + 1][::-1]
    else:
        inner.insert(last, inner.pop(first))
    place = {node: number for number, node in enumerate(inner)}
    wishes: list[SortieRequest] = []
    for wish in plan.wishes:
        if place[wish.launch] <= place[wish.meet]:
            wishes.append(wish)
            continue
        turned = replace(wish, launch=wish.meet, meet=wish.launch)
        if not _reaches(problem, turned.kind, turned.launch, turned.customer, turned.meet):
            return None
        wishes.append(turned)
    return replace(plan, route=tuple(inner), wishes=tuple(wishes))


def _by_the_other(
    plan: AskedDay, problem: TruckAndDrones, rng: np.random.Generator
) -> AskedDay | None:
    """An order goes from the truck to a drone, or from a drone to the truck."""
    customer = int(rng.integers(1, problem.end))
    if customer in plan.route:
        return _to_a_drone(plan, problem, rng, customer)
    if not problem.truck_can_serve[customer]:
        return None
    wishes = tuple(wish for wish in plan.wishes if wish.customer != customer)
    at = int(rng.integers(1, len(plan.route)))
    return replace(plan, route=(*plan.route[:at], customer, *plan.route[at:]), wishes=wishes)


def _to_a_drone(
    plan: AskedDay, problem: TruckAndDrones, rng: np.random.Generator, customer: int
) -> AskedDay | None:
    """Its stop is left out, so what is launched or met there goes to the stop after it."""
    able = [k for k, kind in enumerate(problem.kinds) if kind.count and kind.can_serve[customer]]
    if not able:
        return None
    after = plan.route[plan.route.index(customer) + 1]
    route = tuple(node for node in plan.route if node != customer)
    wishes = [
        replace(
            wish,
            launch=after if wish.launch == customer else wish.launch,
            meet=after if wish.meet == customer else wish.meet,
        )
        for wish in plan.wishes
    ]
    stop = route[int(rng.integers(len(route)))]
    fresh = SortieRequest(customer, able[int(rng.integers(len(able)))], stop, stop)
    wishes.insert(int(rng.integers(len(wishes) + 1)), fresh)
    if all(_reaches(problem, w.kind, w.launch, w.customer, w.meet) for w in wishes):
        return replace(plan, route=route, wishes=tuple(wishes))
    return None


def _reaches(problem: TruckAndDrones, kind: int, launch: int, customer: int, meet: int) -> bool:
    legs = problem.legs[kind]
    spent_s = legs.out_hover_s[launch, customer] + legs.back_hover_s[customer, meet]
    return bool(spent_s <= legs.endurance_hover_s)


MOVES = (_other_stops, _other_stops, _other_order, _other_route, _by_the_other)
"""Each as often as it stands here."""
