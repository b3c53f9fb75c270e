"""The value tables against full enumeration, a closed form, and the independent frontier."""

import math
from functools import cache

import msgspec
import numpy as np
import pytest

from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.campaign.frontier import frontier
from sim_bridge.research.campaign.scenario_generator import (
    GeneratorParams,
    WindRose,
    random_scenario,
)
from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.bounded_loss_policy import (
    PolicySearch,
    find_policy,
    forecast,
)
from sim_bridge.research.planners.dynamic_program import solve_delivery, solve_home
from sim_bridge.research.planners.edge_transitions import Rounding, build_step_model
from sim_bridge.research.planners.markov_chain import WindChain, sight_of
from sim_bridge.research.planners.mission_model import ChainWinds, fly_missions
from sim_bridge.research.planners.scenario import (
    ChainWind,
    Power,
    Scenario,
    build_energy_graph,
    chain_from_scenario,
)
from sim_bridge.research.planners.tuning import PolicyTuner

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


def enumerated(model, stop_worth):
    """Expectimax by plain recursion over every choice: the value from the depot."""
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
            duration = float(graph.duration_s(chain.states_en_mps)[e, state])
            row = chain.transition(duration)[state]
            then = delivered or head == graph.target
            chances = (row[s] * best(head, s, level - cost, then) for s in range(chain.state_count))
            value = max(value, sum(chances))
        return value

    return sum(
        chain.initial[s] * best(graph.depot, s, model.levels, False)
        for s in range(chain.state_count)
    )


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("stop_worth", [0.0, 0.5, 0.9])
def test_the_table_is_worth_what_full_enumeration_finds(seed, stop_worth):
    graph, chain = tiny(seed)
    model = build_step_model(graph, chain, 18.0, 12, Rounding.UP, np.float64)
    home = solve_home(model)
    table = solve_delivery(model, home, np.array([stop_worth]))[0]
    value = float(chain.initial @ table.value[-1, graph.depot])
    assert value == pytest.approx(enumerated(model, stop_worth), abs=3e-5)  # thrift


def two_vertices(rate, wind=6.0, budget_wh=10.0):
    """Depot and target 1 km apart, east; wind east or west, starting east."""
    place = np.array([[0, 0, 0], [1000, 0, 0]], dtype=float)
    graph = EnergyGraph(place, np.array([0, 1]), np.array([1, 0]), 0, 1, 15.0, (300.0, 300.0))
    states = np.array([[wind, 0.0], [-wind, 0.0]])
    chain = WindChain(states, np.array([[-rate, rate], [rate, -rate]]), np.array([1.0, 0.0]))
    return graph, chain


def test_there_and_back_has_the_closed_form_of_a_two_state_chain():
    rate = 0.01
    graph, chain = two_vertices(rate)
    out_s, back_slow_s, back_fast_s = 1000 / 21, 1000 / 9, 1000 / 21
    # Enough for a way home with the wind turned, not for one against it.
    budget = 300.0 / 3600.0 * (out_s + (back_slow_s + back_fast_s) / 2)
    model = build_step_model(graph, chain, budget, 1000, Rounding.UP, np.float64)
    home = solve_home(model)
    table = solve_delivery(model, home, np.array([0.0]))[0]
    turned = (1.0 - math.exp(-2.0 * rate * out_s)) / 2.0  # P(other state) after out_s
    assert forecast(model, table).success == pytest.approx(turned, abs=1e-4)


def test_a_bound_is_met_exactly_by_mixing_two_policies_and_never_broken():
    rate = 0.01
    graph, chain = two_vertices(rate)
    budget = 300.0 / 3600.0 * (1000 / 21 + 80.0)
    turned = (1.0 - math.exp(-2.0 * rate * 1000 / 21)) / 2.0
    model = build_step_model(graph, chain, budget, 500, Rounding.UP, np.float64)
    policy = find_policy(model, solve_home(model), 0.3)
    # Going or not is all there is to decide: the share that goes has P(loss) = 1 - turned.
    assert policy.forecast.loss == pytest.approx(0.3, abs=1e-4)
    assert policy.forecast.success == pytest.approx(0.3 * turned / (1.0 - turned), abs=1e-3)


def test_a_bound_that_nothing_can_meet_keeps_the_vehicle_at_the_depot():
    graph, chain = two_vertices(0.01)
    model = build_step_model(graph, chain, 300.0 / 3600.0 * (1000 / 21 + 80.0), 300)
    policy = find_policy(model, solve_home(model), 0.0)
    assert policy.stays
    assert policy.forecast.loss == 0.0


@pytest.mark.parametrize("budget", [0.0, 1e-6, 1e9])
def test_budgets_of_nothing_and_of_plenty_are_decided(budget):
    graph, chain = two_vertices(0.01)
    model = build_step_model(graph, chain, budget, 100)
    policy = find_policy(model, solve_home(model), 0.01)
    assert policy.stays == (budget < 1.0)
    assert policy.forecast.success == pytest.approx(1.0 if budget > 1.0 else 0.0, abs=1e-3)


def small_scenario(seed, budget_wh=60.0):
    rose = WindRose(directions=8, offset=False, speeds_mps=(3.0, 9.0), dwell_s=40.0)
    params = GeneratorParams(
        vertices=14, sides_m=((700.0, 1.0),), loaded_w=1900.0, empty_w=1100.0, rose=rose
    )
    scenario = random_scenario(f"small-{seed}", params, np.random.default_rng(seed))
    return msgspec.structs.replace(scenario, budget_wh=budget_wh)


@pytest.mark.parametrize("seed", [1, 2])
def test_rounded_up_tables_promise_less_and_the_frontier_more_and_both_close_in(seed):
    scenario = small_scenario(seed)
    graph, chain = build_energy_graph(scenario), chain_from_scenario(scenario.wind)
    gaps = []
    for levels in (60, 240):
        model = build_step_model(graph, chain, scenario.budget_wh, levels, Rounding.UP, np.float64)
        policy = find_policy(model, solve_home(model), 0.02)
        limit = float(frontier(scenario, levels, WEIGHTS).success(policy.forecast.loss))
        gaps.append(limit - policy.forecast.success)
    assert min(gaps) >= -1e-4
    assert gaps[1] <= max(0.5 * gaps[0], 0.005)


@pytest.mark.parametrize("max_loss", [0.01, 0.05])
def test_a_tuned_policy_keeps_its_bound_and_stays_near_the_frontier(max_loss):
    scenario = small_scenario(2)
    graph, chain = build_energy_graph(scenario), chain_from_scenario(scenario.wind)
    sight = sight_of(chain, None)
    model = build_step_model(graph, chain, scenario.budget_wh, 300)
    policy = PolicyTuner(PolicySearch(model, solve_home(model)), sight).policy(max_loss)
    count = 20_000
    winds = ChainWinds(graph, chain, sight, count, np.random.default_rng(8))
    coins = np.random.default_rng(9).random(count)
    flown = fly_missions(graph, scenario.budget_wh, winds, Ber(policy, sight).begin(coins))
    shares = np.bincount(flown.outcome, minlength=4) / count
    loss = shares[1] + shares[2]
    assert loss <= max_loss + 3.0 * math.sqrt(max_loss / count)
    assert shares[0] >= float(frontier(scenario, 400, WEIGHTS).success(loss)) - 0.02


def test_edges_that_no_wind_allows_and_vertices_without_edges_are_no_obstacle():
    wind = ChainWind(states_en_mps=[(0.0, 30.0)], rate_per_s=[[0.0]], initial=[1.0])
    scenario = Scenario(
        format="delivery-scenario/1",
        name="gale",
        vertices_m=[(0, 0, 0), (100, 0, 0), (9, 9, 9)],
        edges=[(0, 1), (1, 0)],
        depot=0,
        target=1,
        budget_wh=10.0,
        airspeed_mps=15.0,
        power_w=Power(loaded=100.0, empty=100.0),
        wind=wind,
    )
    graph, chain = build_energy_graph(scenario), chain_from_scenario(wind)
    model = build_step_model(graph, chain, 10.0, 50)
    assert find_policy(model, solve_home(model), 0.5).stays


def test_rounding_in_float32_gives_no_reason_to_fly_in_circles():
    # Found on a small square where every route succeeds: worths a hair over 1 grew with each edge.
    rose = WindRose(directions=16, speeds_mps=(2.0, 6.0, 10.0), dwell_s=600.0)
    params = GeneratorParams(vertices=20, sides_m=((200.0, 1.0),), budget_wh=100.0, rose=rose)
    scenario = random_scenario("circles", params, np.random.default_rng(4))
    graph, chain = build_energy_graph(scenario), chain_from_scenario(scenario.wind)
    model = build_step_model(graph, chain, 100.0, 200)
    home = solve_home(model)
    table = solve_delivery(model, home, np.array([0.0, 1.0]))
    assert float(home.p_home.max()) <= 1.0
    assert float(table[0].value.max()) <= 1.0
    assert forecast(model, table[1]).success == 0.0  # a stop that is worth success: stays
    policy = find_policy(model, home, 0.01)
    sight = sight_of(chain, None)
    winds = ChainWinds(graph, chain, sight, 500, np.random.default_rng(1))
    flown = fly_missions(graph, 100.0, winds, Ber(policy, sight).begin(np.zeros(500)))
    assert (flown.outcome == 0).all()
    assert flown.energy_wh.max() < 40.0  # there and back, not on and on
