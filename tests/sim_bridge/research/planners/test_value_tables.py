"""The value tables against full enumeration, a closed form, and the independent frontier."""

import math
from functools import cache

import msgspec
import numpy as np
import pytest

from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.campaign.frontier import compute_frontier
from sim_bridge.research.campaign.scenario_generator import (
    DirectionalWindModel,
    GeneratorParams,
    draw_connected_scenario,
)
from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.bounded_loss_policy import (
    PolicySearch,
    forecast_success_and_loss,
)
from sim_bridge.research.planners.dynamic_program import solve_delivery_tables, solve_return_table
from sim_bridge.research.planners.edge_transitions import Rounding, build_edge_transition_model
from sim_bridge.research.planners.markov_chain import WindChain, build_observed_wind_by_state
from sim_bridge.research.planners.mission_model import ChainWinds, fly_missions
from sim_bridge.research.planners.scenario import (
    ChainWind,
    build_energy_graph,
    chain_from_scenario,
)
from sim_bridge.research.planners.tuning import PolicyTuner

EXACT = (Rounding.UP, np.float64)
WEIGHTS = (0.0, *np.geomspace(0.3, 300.0, 9).tolist())  # of the frontier's dual


def tiny(seed, vertices=4, states=2):
    """A random complete graph of a few vertices whose edges cost whole Wh in every state.

    Speeds come from winds along the edges; energies are rounded to whole levels by the model, so
    that full enumeration on the same levels must agree exactly.
    """
    random = np.random.default_rng(seed)
    place = np.column_stack([random.uniform(0, 300, (vertices, 2)), np.zeros(vertices)])
    edges = np.array([(a, b) for a in range(vertices) for b in range(vertices) if a != b])
    graph = EnergyGraph(place, edges[:, 0], edges[:, 1], 0, vertices - 1, 12.0, (900.0, 600.0))
    wind = random.uniform(-9, 9, (states, 2))
    rate = random.uniform(0.002, 0.05, (states, states))
    np.fill_diagonal(rate, 0.0)
    np.fill_diagonal(rate, -rate.sum(axis=1))
    return graph, WindChain(wind, rate, np.full(states, 1.0 / states))


def best_policy(graph, chain, budget_wh, levels, max_loss, *rounding):
    model = build_edge_transition_model(graph, chain, budget_wh, levels, *rounding)
    return PolicySearch(model, solve_return_table(model)).best_policy_within_loss(max_loss)


def enumerated(model, stop_worth):
    """Compute expectimax by plain recursion over every choice: the value from the depot."""
    graph, chain = model.graph, model.chain

    @cache
    def best(vertex, state, level, delivered):
        if delivered and vertex == graph.depot:
            return 1.0
        value = stop_worth if vertex == graph.depot and not delivered else 0.0
        for e in np.flatnonzero(graph.tail == vertex):
            cost = int(model.cost_levels[int(delivered), e, state])
            if cost > level:
                continue
            head = int(graph.head[e])
            duration = float(graph.edge_duration_s(chain.states_en_mps)[e, state])
            row = chain.transition_matrix(duration)[state]
            then = delivered or head == graph.target
            chances = (row[s] * best(head, s, level - cost, then) for s in range(chain.state_count))
            value = max(value, sum(chances))
        return value

    return sum(
        chain.initial[s] * best(graph.depot, s, model.levels, False)
        for s in range(chain.state_count)
    )


@pytest.mark.sample
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("stop_worth", [0.0, 0.5, 0.9])
def test_the_table_is_worth_what_full_enumeration_finds(seed, stop_worth):
    graph, chain = tiny(seed)
    model = build_edge_transition_model(graph, chain, 18.0, 12, *EXACT)
    home = solve_return_table(model)
    table = solve_delivery_tables(model, home, np.array([stop_worth]))[0]
    value = float(chain.initial @ table.value[-1, graph.depot])
    assert value == pytest.approx(enumerated(model, stop_worth), abs=3e-5)  # thrift


def two_vertices(rate, wind=6.0, budget_wh=10.0):
    """Return depot and target 1 km east of it; wind east or west, starting east."""
    place = np.array([[0, 0, 0], [1000, 0, 0]], dtype=float)
    graph = EnergyGraph(place, np.array([0, 1]), np.array([1, 0]), 0, 1, 15.0, (300.0, 300.0))
    states = np.array([[wind, 0.0], [-wind, 0.0]])
    chain = WindChain(states, np.array([[-rate, rate], [rate, -rate]]), np.array([1.0, 0.0]))
    return graph, chain


def test_there_and_back_has_the_closed_form_of_a_two_state_chain():
    rate = 0.01
    graph, chain = two_vertices(rate)
    out_s, back_slow_s, back_fast_s = 1000 / 21, 1000 / 9, 1000 / 21
    # Enough for a return with the wind turned, not for one against it.
    budget = 300.0 / 3600.0 * (out_s + (back_slow_s + back_fast_s) / 2)
    model = build_edge_transition_model(graph, chain, budget, 1000, *EXACT)
    home = solve_return_table(model)
    table = solve_delivery_tables(model, home, np.array([0.0]))[0]
    turned = (1.0 - math.exp(-2.0 * rate * out_s)) / 2.0  # P(other state) after out_s
    assert forecast_success_and_loss(model, table).success == pytest.approx(turned, abs=1e-4)


def test_a_bound_is_met_exactly_by_mixing_two_policies_and_never_broken():
    rate = 0.01
    graph, chain = two_vertices(rate)
    budget = 300.0 / 3600.0 * (1000 / 21 + 80.0)
    turned = (1.0 - math.exp(-2.0 * rate * 1000 / 21)) / 2.0
    policy = best_policy(graph, chain, budget, 500, 0.3, *EXACT)
    # The only decision is whether to go: the share that goes has P(loss) = 1 - turned.
    assert policy.forecast.loss == pytest.approx(0.3, abs=1e-4)
    assert policy.forecast.success == pytest.approx(0.3 * turned / (1.0 - turned), abs=1e-3)


def test_a_bound_that_nothing_can_meet_keeps_the_vehicle_at_the_depot():
    graph, chain = two_vertices(0.01)
    policy = best_policy(graph, chain, 300.0 / 3600.0 * (1000 / 21 + 80.0), 300, 0.0)
    assert (policy.forecast.success, policy.forecast.loss) == (0.0, 0.0)


@pytest.mark.parametrize("budget", [0.0, 1e-6, 1e9])
def test_budgets_of_nothing_and_of_plenty_are_decided(budget):
    graph, chain = two_vertices(0.01)
    policy = best_policy(graph, chain, budget, 100, 0.01)
    expected = pytest.approx(1.0, abs=1e-3) if budget > 1.0 else 0.0
    assert policy.forecast.success == expected


def small_scenario(seed, budget_wh=60.0):
    rose = DirectionalWindModel(directions=8, offset=False, speeds_mps=(3.0, 9.0), dwell_s=40.0)
    params = GeneratorParams(
        vertices=14,
        square_sizes_m=((700.0, 1.0),),
        loaded_w=1900.0,
        empty_w=1100.0,
        wind_model=rose,
    )
    scenario = draw_connected_scenario(f"small-{seed}", params, np.random.default_rng(seed))
    return msgspec.structs.replace(scenario, budget_wh=budget_wh)


@pytest.mark.night
@pytest.mark.parametrize("seed", [1, 2])
def test_rounded_up_tables_promise_less_and_the_frontier_more_and_both_close_in(seed):
    scenario = small_scenario(seed)
    graph, chain = build_energy_graph(scenario), chain_from_scenario(scenario.wind)
    gaps = []
    for levels in (60, 240):
        found = best_policy(graph, chain, scenario.budget_wh, levels, 0.02, *EXACT).forecast
        frontier = compute_frontier(scenario, levels, WEIGHTS)
        limit = frontier.max_success_at_exact_loss_probability(found.loss)
        gaps.append(float(limit) - found.success)
    assert min(gaps) >= -1e-4
    assert gaps[1] <= max(0.5 * gaps[0], 0.005)


@pytest.mark.sample
@pytest.mark.parametrize("max_loss", [0.01, 0.05])
def test_a_tuned_policy_keeps_its_bound_and_stays_near_the_frontier(max_loss):
    scenario = small_scenario(2)
    graph, chain = build_energy_graph(scenario), chain_from_scenario(scenario.wind)
    sight = build_observed_wind_by_state(chain, None)
    model = build_edge_transition_model(graph, chain, scenario.budget_wh, 300)
    search = PolicySearch(model, solve_return_table(model))
    policy = PolicyTuner(search, sight).tune_policy_to_loss_bound(max_loss)
    count = 20_000
    winds = ChainWinds(graph, chain, sight, count, np.random.default_rng(8))
    coins = np.random.default_rng(9).random(count)
    flown = fly_missions(graph, scenario.budget_wh, winds, Ber(policy, sight).start_batch(coins))
    shares = np.bincount(flown.outcome, minlength=4) / count
    loss = shares[1] + shares[2]
    assert loss <= max_loss + 3.0 * math.sqrt(max_loss / count)
    frontier = compute_frontier(scenario, 400, WEIGHTS)
    limit = float(frontier.max_success_at_exact_loss_probability(loss))
    assert shares[0] >= limit - 0.02


def test_edges_that_no_wind_allows_and_vertices_without_edges_are_no_obstacle():
    wind = ChainWind(states_en_mps=[(0.0, 30.0)], rate_per_s=[[0.0]], initial=[1.0])
    place = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [9.0, 9.0, 9.0]])
    graph = EnergyGraph(place, np.array([0, 1]), np.array([1, 0]), 0, 1, 15.0, (100.0, 100.0))
    assert best_policy(graph, chain_from_scenario(wind), 10.0, 50, 0.5).forecast.success == 0.0


def test_rounding_in_float32_gives_no_reason_to_fly_in_circles():
    # Found on a small square where every route succeeds: values slightly over 1 grew per edge.
    rose = DirectionalWindModel(directions=16, speeds_mps=(2.0, 6.0, 10.0), dwell_s=600.0)
    params = GeneratorParams(
        vertices=20, square_sizes_m=((200.0, 1.0),), budget_wh=100.0, wind_model=rose
    )
    scenario = draw_connected_scenario("circles", params, np.random.default_rng(4))
    graph, chain = build_energy_graph(scenario), chain_from_scenario(scenario.wind)
    model = build_edge_transition_model(graph, chain, 100.0, 200)
    home = solve_return_table(model)
    table = solve_delivery_tables(model, home, np.array([0.0, 1.0]))
    assert float(home.p_home.max()) <= 1.0
    assert float(table[0].value.max()) <= 1.0
    # A stop that is worth success: stays.
    assert forecast_success_and_loss(model, table[1]).success == 0.0
    policy = PolicySearch(model, home).best_policy_within_loss(0.01)
    sight = build_observed_wind_by_state(chain, None)
    winds = ChainWinds(graph, chain, sight, 500, np.random.default_rng(1))
    flown = fly_missions(graph, 100.0, winds, Ber(policy, sight).start_batch(np.zeros(500)))
    assert (flown.outcome == 0).all()
    assert flown.energy_wh.max() < 40.0  # there and back, not in circles
