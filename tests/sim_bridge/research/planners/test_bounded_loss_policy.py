"""BER's search and the frontier against the exact optimum of a constrained Markov decision process.

The linear program over occupation measures (Altman, Constrained Markov Decision Processes, 1999,
ch. 3) knows neither Lagrange weights nor mixtures: one variable for each state and action, flow in
equals flow out, and what is lost stays within the bound. scipy's HiGHS solves it; transition
probabilities are scipy's matrix exponential. Nothing is shared with the tables but the scenario.
"""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog
from scipy.sparse import coo_array

from sim_bridge.research.campaign.frontier import compute_frontier
from sim_bridge.research.planners.bounded_loss_policy import PolicySearch
from sim_bridge.research.planners.dynamic_program import solve_return_table
from sim_bridge.research.planners.edge_transitions import Rounding, build_edge_transition_model
from sim_bridge.research.planners.scenario import (
    ChainWind,
    Power,
    Scenario,
    build_energy_graph,
    chain_from_scenario,
)

LEVELS = 24


def scenario_of(seed, vertices=4, states=2, budget_wh=18.0):
    random = np.random.default_rng(seed)
    rate = random.uniform(0.002, 0.05, (states, states))
    np.fill_diagonal(rate, 0.0)
    np.fill_diagonal(rate, -rate.sum(axis=1))
    return Scenario(
        format="delivery-scenario/1",
        name=f"lp-{seed}",
        vertices_m=[(*random.uniform(0, 300, 2).tolist(), 0.0) for _ in range(vertices)],
        edges=[(a, b) for a in range(vertices) for b in range(vertices) if a != b],
        depot=0,
        target=vertices - 1,
        budget_wh=budget_wh,
        airspeed_mps=12.0,
        power_w=Power(loaded=900.0, empty=600.0),
        wind=ChainWind(
            states_en_mps=[tuple(w) for w in random.uniform(-9, 9, (states, 2)).tolist()],
            rate_per_s=rate.tolist(),
            initial=[1.0 / states] * states,
        ),
    )


def edge_seconds(scenario, edge, wind):
    """The wind triangle by hand; infinite where infeasible."""
    start, end = (np.array(scenario.vertices_m[v][:2]) for v in edge)
    length = float(np.linalg.norm(end - start))
    along = float(np.dot(wind, end - start)) / length
    across = math.sqrt(max(float(np.dot(wind, wind)) - along**2, 0.0))
    if across > scenario.airspeed_mps:
        return math.inf
    speed = math.sqrt(scenario.airspeed_mps**2 - across**2) + along
    return length / speed if speed > 0.0 else math.inf


def best_success(scenario, max_loss, rounded):
    """P(SUC) of the linear program on LEVELS steps of energy, edges' costs `rounded`."""
    wind, count = scenario.wind, len(scenario.wind.initial)
    step_wh = scenario.budget_wh / LEVELS
    rate = np.array(wind.rate_per_s)
    actions, flow, success, loss, start = [], [], [], [], {}
    place = {}

    def number(state):
        return place.setdefault(state, len(place))

    def add(state, following, wins=0.0, loses=0.0):
        actions.append(number(state))
        flow.append(following)
        success.append(wins)
        loss.append(loses)

    waiting = [(scenario.depot, s, LEVELS, False) for s in range(count)]
    for s, state in enumerate(waiting):
        start[number(state)] = wind.initial[s]
    seen = set(waiting)
    while waiting:
        state = waiting.pop()
        vertex, s, level, delivered = state
        add(state, [], loses=1.0)
        if vertex == scenario.depot and not delivered:
            add(state, [])  # stays: neither
        for edge in scenario.edges:
            seconds = edge_seconds(scenario, edge, np.array(wind.states_en_mps[s]))
            if edge[0] != vertex or math.isinf(seconds):
                continue
            watts = scenario.power_w.empty if delivered else scenario.power_w.loaded
            cost = max(1, int(rounded(seconds * watts / 3600.0 / step_wh)))
            if cost > level:
                continue
            then = delivered or edge[1] == scenario.target
            if then and edge[1] == scenario.depot:
                add(state, [], wins=1.0)
                continue
            following = []
            for after, chance in enumerate(expm(rate * seconds)[s]):
                reached = (edge[1], after, level - cost, then)
                following.append((number(reached), float(chance)))
                if reached not in seen:
                    seen.add(reached)
                    waiting.append(reached)
            add(state, following)
    rows, columns, values = [], [], []
    for a, (origin, following) in enumerate(zip(actions, flow, strict=True)):
        for row, value in [(origin, 1.0), *((to, -chance) for to, chance in following)]:
            rows.append(row)
            columns.append(a)
            values.append(value)
    balance = coo_array((values, (rows, columns)), shape=(len(place), len(actions)))
    inflow = np.array([start.get(state, 0.0) for state in range(len(place))])
    solved = linprog(
        -np.array(success), A_ub=[loss], b_ub=[max_loss], A_eq=balance.tocsr(), b_eq=inflow
    )
    assert solved.status == 0
    return -solved.fun


def rounded_up(cost):
    return math.ceil(cost - 1e-9)


def rounded_down(cost):
    return math.floor(cost + 1e-9)


@pytest.mark.night
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("max_loss", [0.02, 0.1, 0.3])
def test_the_mixture_of_two_policies_is_the_optimum_of_the_linear_program(seed, max_loss):
    scenario = scenario_of(seed)
    chain = chain_from_scenario(scenario.wind)
    graph = build_energy_graph(scenario)
    model = build_edge_transition_model(
        graph, chain, scenario.budget_wh, LEVELS, Rounding.UP, np.float64
    )
    found = (
        PolicySearch(model, solve_return_table(model)).best_policy_within_loss(max_loss).forecast
    )
    best = best_success(scenario, max_loss, rounded_up)
    assert found.loss <= max_loss + 1e-9
    assert found.success <= best + 1e-6
    assert found.success >= best - 0.01


@pytest.mark.night
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("max_loss", [0.02, 0.3])
def test_the_frontier_bounds_the_linear_program_closely(seed, max_loss):
    scenario = scenario_of(seed)
    best = best_success(scenario, max_loss, rounded_down)
    weights = (0.0, *np.geomspace(0.03, 300.0, 40).tolist())
    frontier = compute_frontier(scenario, LEVELS, weights)
    limit = float(frontier.max_success_within_loss_probability(max_loss))
    assert limit >= best - 1e-6
    assert limit <= best + 0.02  # the weights are a grid
