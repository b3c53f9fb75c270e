"""Simulated annealing over tour and sorties: the search, in steps of a stated number of trials."""

import math

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.edits import index_route
from ground_station.core.truck_drones.moves import any_move
from ground_station.core.truck_drones.random_stream import uniform
from ground_station.core.truck_drones.simulate import simulate


@compiled
def _copy(source, target):
    for row in range(source.shape[0]):
        for column in range(source.shape[1]):
            target[row, column] = source[row, column]


@compiled
def anneal(
    t, w, plan, best, place, spare_plan, spare_place, costs_s, stream, trials, hot_s, cold_s
):
    """Try `trials` moves while the temperature falls from `hot_s` to `cold_s`, s of makespan.

    Changes `plan`, `best`, `place` and `costs_s` (of plan and best). A move is taken when the
    makespan rises by no more than temperature x Exp(1), so that hopeless simulations stop early.
    """
    cooling = (cold_s / hot_s) ** (1.0 / trials)
    temperature_s = hot_s
    for _ in range(trials):
        temperature_s *= cooling
        _copy(plan, spare_plan)
        for node in range(len(place)):
            spare_place[node] = place[node]
        if not any_move(t, spare_plan, spare_place, stream):
            continue
        give_up_s = costs_s[0] - temperature_s * math.log(1.0 - uniform(stream))
        makespan_s = simulate(t, spare_plan, w, give_up_s)
        if makespan_s > give_up_s:
            continue
        _copy(spare_plan, plan)
        index_route(plan, place)
        costs_s[0] = makespan_s
        if makespan_s < costs_s[1] - 1e-9:
            costs_s[1] = makespan_s
            _copy(plan, best)
