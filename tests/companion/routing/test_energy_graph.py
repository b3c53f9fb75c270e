"""Edge energies, wind lengths, uncertainty of a route."""

import math

import numpy as np
import pytest

from companion.core.routing.energy_graph import EnergyGraph, prune_edges_unusable_within_budget


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
    speeds = graph.edge_ground_speed_mps([[5.0, 0.0], [-5.0, 0.0], [0.0, 9.0]])[east]
    assert speeds == pytest.approx([20.0, 10.0, 12.0])


def test_wind_across_beyond_the_airspeed_or_against_it_makes_an_edge_infeasible():
    graph = square()
    energy = graph.edge_energy_wh([[0.0, 15.1], [-15.0, 0.0], [-14.9, 0.0]], delivered=False)
    assert np.isinf(energy[edge(graph, 0, 1), :2]).all()
    assert np.isfinite(energy[edge(graph, 0, 1), 2])


def test_energy_is_power_times_length_over_ground_speed():
    graph = square()
    energy = graph.edge_energy_wh([5.0, 0.0], delivered=True)
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
    duration = graph.edge_duration_s([[9.0, 0.0], [0.0, 16.0]])
    assert duration[0] == pytest.approx([0.0, 0.0])
    assert duration[1, 0] == pytest.approx(30.0 / 12.0)
    assert np.isinf(duration[1, 1])


def test_wind_length_is_never_negative_and_the_synthetic_length_grows_with_lambda():
    graph = square()
    for wind in ([5.0, 0.0], [-5.0, 0.0], [3.0, 4.0]):
        assert (graph.edge_excess_length_from_wind_m(wind) >= 0.0).all()
    against = edge(graph, 0, 1)
    # E(w)/E(calm) = 15/10 against 5 m/s of headwind: half the length more.
    assert graph.edge_excess_length_from_wind_m([-5.0, 0.0])[against] == pytest.approx(50.0)
    assert graph.edge_synthetic_length_m([-5.0, 0.0], 2.0)[against] == pytest.approx(200.0)


@pytest.mark.parametrize("wind", [(0.0, 0.0), (3.0, -4.0), (-6.0, 2.0)])
@pytest.mark.parametrize("delivered", [False, True])
def test_the_energy_gradient_is_the_slope_of_the_energy(wind, delivered):
    graph = square()
    gradient = graph.edge_energy_gradient_wh_per_mps(wind, delivered)
    step = 1e-4
    for axis in (0, 1):
        ahead, behind = np.array(wind), np.array(wind)
        ahead[axis] += step
        behind[axis] -= step
        slope = (
            graph.edge_energy_wh(ahead, delivered) - graph.edge_energy_wh(behind, delivered)
        ) / (2 * step)
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
    energy = [graph.edge_energy_wh(winds, load) for load in (False, True)]
    total = sum(energy[int(load)][e] for e, load in zip(route, loads, strict=True))
    predicted = graph.route_energy_std_wh(route, [2.0, 1.0], covariance, loads)
    assert predicted == pytest.approx(total.std(), rel=0.05)  # linear in a small wind error


def test_pruning_leaves_out_only_edges_beyond_the_budget():
    graph = square((900.0, 900.0))
    calm = np.stack([graph.edge_energy_wh([[0.0, 0.0]], load) for load in (False, True)])
    side = calm[0, 0, 0]
    assert prune_edges_unusable_within_budget(graph, calm, 4.0 * side).graph.edge_count == 8
    assert (
        prune_edges_unusable_within_budget(graph, calm, 1.9 * side).graph.edge_count == 1
    )  # never quite empty
