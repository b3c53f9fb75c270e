"""Edge energies, wind lengths, uncertainty of a route, chains, classes and time windows."""

import math

import networkx as nx
import numpy as np
import pytest
from scipy.linalg import expm

from companion.core.routing.energy_graph import EnergyGraph, networkx_graph, prune
from companion.core.wind.markov_chain import (
    OrnsteinUhlenbeckWind,
    Sight,
    WindChain,
    class_centre,
    sight_of,
    time_window_s,
)
from sim_bridge.research.planners.uncertainty import ChainUncertainty, lag_s


def square(powers=(1000.0, 500.0)):
    """Depot 0, corners 1 (east), 2 (north-east), 3 (north); 100 m sides, both ways, round."""
    place = np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]], dtype=float)
    edges = np.array(sorted([(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2), (3, 0), (0, 3)]))
    return EnergyGraph(place, edges[:, 0], edges[:, 1], 0, 2, 15.0, powers)


def edge(graph, tail, head):
    return int(np.flatnonzero((graph.tail == tail) & (graph.head == head))[0])


def test_a_tailwind_adds_to_and_a_crosswind_takes_from_the_ground_speed():
    graph = square()
    east = edge(graph, 0, 1)
    # Closed form of the wind triangle: 15 + 5, 15 - 5, sqrt(15^2 - 9^2) = 12 m/s.
    speeds = graph.ground_speed_mps([[5.0, 0.0], [-5.0, 0.0], [0.0, 9.0]])[east]
    assert speeds == pytest.approx([20.0, 10.0, 12.0])


def test_wind_across_beyond_the_airspeed_or_against_it_makes_an_edge_infeasible():
    graph = square()
    energy = graph.energy_wh([[0.0, 15.1], [-15.0, 0.0], [-14.9, 0.0]], delivered=False)
    assert np.isinf(energy[edge(graph, 0, 1), :2]).all()
    assert np.isfinite(energy[edge(graph, 0, 1), 2])


def test_energy_is_power_times_length_over_ground_speed():
    graph = square()
    energy = graph.energy_wh([5.0, 0.0], delivered=True)
    assert energy[edge(graph, 0, 1)] == pytest.approx(500.0 * 100.0 / 20.0 / 3600.0)


def test_an_edge_of_no_length_is_free_and_a_vertical_one_has_all_wind_across():
    graph = EnergyGraph(
        np.array([[0, 0, 0], [0, 0, 0], [0, 0, 30]], dtype=float),
        np.array([0, 1]),
        np.array([1, 2]),
        0,
        2,
        15.0,
        (900.0, 900.0),
    )
    duration = graph.duration_s([[9.0, 0.0], [0.0, 16.0]])
    assert duration[0] == pytest.approx([0.0, 0.0])
    assert duration[1, 0] == pytest.approx(30.0 / 12.0)
    assert np.isinf(duration[1, 1])


def test_wind_length_is_never_negative_and_the_synthetic_length_grows_with_lambda():
    graph = square()
    for wind in ([5.0, 0.0], [-5.0, 0.0], [3.0, 4.0]):
        assert (graph.wind_length_m(wind) >= 0.0).all()
    against = edge(graph, 0, 1)
    # E(w)/E(calm) = 15/10 against 5 m/s of headwind: half the length more.
    assert graph.wind_length_m([-5.0, 0.0])[against] == pytest.approx(50.0)
    assert graph.synthetic_length_m([-5.0, 0.0], 2.0)[against] == pytest.approx(200.0)


@pytest.mark.parametrize("wind", [(0.0, 0.0), (3.0, -4.0), (-6.0, 2.0)])
@pytest.mark.parametrize("delivered", [False, True])
def test_the_energy_gradient_is_the_slope_of_the_energy(wind, delivered):
    graph = square()
    gradient = graph.energy_gradient_wh_per_mps(wind, delivered)
    step = 1e-4
    for axis in (0, 1):
        ahead, behind = np.array(wind), np.array(wind)
        ahead[axis] += step
        behind[axis] -= step
        slope = (graph.energy_wh(ahead, delivered) - graph.energy_wh(behind, delivered)) / (
            2 * step
        )
        assert gradient[:, axis] == pytest.approx(slope, rel=1e-6)


def test_legs_out_and_back_cancel_under_one_wind_error_where_variances_would_add():
    graph = square((700.0, 700.0))
    covariance = np.eye(2) * 0.25
    there_and_back = [edge(graph, 0, 1), edge(graph, 1, 0)]
    joint = graph.route_energy_std_wh(there_and_back, [0.0, 0.0], covariance, [False, True])
    each = [graph.route_energy_std_wh([e], [0.0, 0.0], covariance, [False]) for e in there_and_back]
    assert joint == pytest.approx(0.0, abs=1e-12)
    assert math.hypot(*each) > 0.05


def test_legs_in_one_direction_add_in_full_where_variances_would_add_less():
    graph = square((700.0, 700.0))
    covariance = np.eye(2) * 0.25
    one = graph.route_energy_std_wh([edge(graph, 0, 1)], [0.0, 0.0], covariance, [False])
    east_twice = [edge(graph, 0, 1), edge(graph, 3, 2)]
    both = graph.route_energy_std_wh(east_twice, [0.0, 0.0], covariance, [False, False])
    assert both == pytest.approx(2.0 * one)
    assert both > math.sqrt(2.0) * one


def test_a_route_std_agrees_with_sampled_winds():
    graph = square()
    route = [edge(graph, 0, 1), edge(graph, 1, 2), edge(graph, 2, 3), edge(graph, 3, 0)]
    loads = [False, False, True, True]
    covariance = np.array([[0.04, 0.01], [0.01, 0.02]])
    random = np.random.default_rng(3)
    winds = random.multivariate_normal([2.0, 1.0], covariance, size=20_000)
    energy = [graph.energy_wh(winds, load) for load in (False, True)]
    total = sum(energy[int(load)][e] for e, load in zip(route, loads, strict=True))
    predicted = graph.route_energy_std_wh(route, [2.0, 1.0], covariance, loads)
    assert predicted == pytest.approx(total.std(), rel=0.05)  # linear in a small wind error


def test_networkx_gets_the_same_graph():
    drawn = networkx_graph(square())
    assert nx.is_strongly_connected(drawn)
    assert drawn.edges[0, 1]["length_m"] == pytest.approx(100.0)


def test_transition_rows_are_those_of_the_matrix_exponential():
    random = np.random.default_rng(0)
    rate = random.random((5, 5))
    np.fill_diagonal(rate, 0.0)
    np.fill_diagonal(rate, -rate.sum(axis=1))
    chain = WindChain(np.zeros((5, 2)), rate, np.full(5, 0.2))
    times = np.array([0.0, 0.3, 2.0, 40.0])
    rows = chain.transition_rows(np.arange(5)[:, None], times[None, :])
    for j, t in enumerate(times):
        assert rows[:, j] == pytest.approx(expm(rate * t), abs=1e-10)


def test_a_chain_without_enough_eigenvectors_is_uniformised():
    rate = np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 0.0]])
    chain = WindChain(np.zeros((3, 2)), rate, np.array([1.0, 0.0, 0.0]))
    rows = chain.transition_rows([0, 0], [0.5, 30.0])
    assert rows[0] == pytest.approx(expm(rate * 0.5)[0], abs=1e-12)
    assert rows[1] == pytest.approx(expm(rate * 30.0)[0], abs=1e-12)


def test_four_classes_centre_on_east_north_west_south_and_keep_the_speed():
    seen = class_centre([[5.0, 1.0], [1.0, 5.0], [-5.0, -1.0], [0.5, -5.0]], 4)
    speed = np.hypot(5.0, 1.0)
    assert seen[0] == pytest.approx([speed, 0.0])
    assert seen[1] == pytest.approx([0.0, speed])
    assert seen[2] == pytest.approx([-speed, 0.0], abs=1e-12)
    assert seen[3] == pytest.approx([0.0, -np.hypot(0.5, 5.0)], abs=1e-12)


def test_states_that_look_alike_through_classes_are_one_sight():
    angle = (np.arange(16) + 0.5) * np.pi / 8
    states = 6.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    chain = WindChain(states, np.zeros((16, 16)), np.full(16, 1 / 16))
    assert sight_of(chain, None).reveals_state()
    assert np.bincount(sight_of(chain, 4).of_state).tolist() == [4, 4, 4, 4]
    assert np.bincount(sight_of(chain, 8).of_state).tolist() == [2] * 8


def test_a_time_window_is_the_mean_stay_in_a_class():
    # Two states that look alike, each left for good at 0.1 per s: 10 s, however they alternate.
    rate = np.array([[-0.6, 0.5, 0.1], [0.5, -0.6, 0.1], [0.0, 0.0, 0.0]])
    chain = WindChain(np.zeros((3, 2)), rate, np.array([0.5, 0.5, 0.0]))
    sight = Sight(np.array([0, 0, 1]), np.zeros((2, 2)))
    assert time_window_s(chain, sight)[0] == pytest.approx(10.0)
    assert np.isinf(time_window_s(chain, sight)[1])


def test_the_process_chain_drifts_and_spreads_as_ornstein_and_uhlenbeck_say():
    process = OrnsteinUhlenbeckWind(std_mps=3.0, time_constant_s=600.0, spacing_mps=1.0)
    chain = process.chain()
    start = int(np.flatnonzero((chain.states_en_mps == [4.0, 0.0]).all(axis=1))[0])
    row = chain.transition(120.0)[start]
    mean = row @ chain.states_en_mps
    std = np.sqrt(row @ (chain.states_en_mps[:, 0] - mean[0]) ** 2)
    # Uhlenbeck & Ornstein 1930: mean x0 exp(-t/tau), variance s^2 (1 - exp(-2 t/tau)).
    assert mean[0] == pytest.approx(4.0 * math.exp(-0.2), abs=0.1)
    assert std == pytest.approx(math.sqrt(process.predictive_cov_m2ps2(120.0)[0, 0]), rel=0.05)


def test_what_is_seen_now_is_certain_now_and_less_so_later():
    graph = square()
    states = np.array([[6.0, 0.0], [-6.0, 0.0]])
    chain = WindChain(states, np.array([[-0.05, 0.05], [0.05, -0.05]]), np.array([0.5, 0.5]))
    spread = ChainUncertainty(graph, chain, sight_of(chain, None), 600.0)
    origin, seen = np.array([0]), np.array([1])
    std = spread.duration_std_s(origin, seen, states[:1])[:, 0]
    here = graph.tail == 0
    assert (std[here] == 0.0).all()
    assert std[edge(graph, 3, 2)] > 0.1
    assert lag_s(graph, origin)[edge(graph, 3, 2), 0] == pytest.approx(100.0 / 15.0)


def test_pruning_leaves_out_only_edges_beyond_the_budget():
    graph = square((900.0, 900.0))
    calm = np.stack([graph.energy_wh([[0.0, 0.0]], load) for load in (False, True)])
    side = calm[0, 0, 0]
    assert prune(graph, calm, 4.0 * side).graph.edge_count == 8
    assert prune(graph, calm, 1.9 * side).graph.edge_count == 1  # never quite empty
