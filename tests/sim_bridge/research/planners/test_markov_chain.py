"""Wind as a Markov chain: transitions, classes, time windows, and chains made of a process."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from companion.adapters.files.params import read_wind_process
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.wind.forecast import LEG_AVERAGING_S
from sim_bridge.research.planners.markov_chain import (
    OrnsteinUhlenbeckWind,
    WindChain,
    build_observed_wind_by_state,
    build_prior_wind,
    snap_direction_to_sector_centre,
)
from sim_bridge.research.planners.uncertainty import ChainUncertainty, lag_until_edge_s

COAST = read_wind_process("coast")


def test_transition_rows_are_those_of_the_matrix_exponential():
    random = np.random.default_rng(0)
    rate = random.random((5, 5))
    np.fill_diagonal(rate, 0.0)
    np.fill_diagonal(rate, -rate.sum(axis=1))
    chain = WindChain(np.zeros((5, 2)), rate, np.full(5, 0.2))
    times = np.array([0.0, 0.3, 2.0, 40.0])
    rows = chain.transition_probability_rows(np.arange(5)[:, None], times[None, :])
    for j, t in enumerate(times):
        assert rows[:, j] == pytest.approx(expm(rate * t), abs=1e-10)


def test_a_chain_without_enough_eigenvectors_has_the_same_rows():
    rate = np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 0.0]])
    chain = WindChain(np.zeros((3, 2)), rate, np.array([1.0, 0.0, 0.0]))
    rows = chain.transition_probability_rows([0, 0], [0.5, 30.0])
    assert rows[0] == pytest.approx(expm(rate * 0.5)[0], abs=1e-12)
    assert rows[1] == pytest.approx(expm(rate * 30.0)[0], abs=1e-12)


def test_four_classes_centre_on_east_north_west_south_and_keep_the_speed():
    seen = snap_direction_to_sector_centre([[5.0, 1.0], [1.0, 5.0], [-5.0, -1.0], [0.5, -5.0]], 4)
    speed = np.hypot(5.0, 1.0)
    assert seen[0] == pytest.approx([speed, 0.0])
    assert seen[1] == pytest.approx([0.0, speed])
    assert seen[2] == pytest.approx([-speed, 0.0], abs=1e-12)
    assert seen[3] == pytest.approx([0.0, -np.hypot(0.5, 5.0)], abs=1e-12)


def test_states_that_look_alike_through_classes_are_one_sight():
    angle = (np.arange(16) + 0.5) * np.pi / 8
    states = 6.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    chain = WindChain(states, np.zeros((16, 16)), np.full(16, 1 / 16))
    assert build_observed_wind_by_state(chain, None).reveals_state()
    assert np.bincount(build_observed_wind_by_state(chain, 4).of_state).tolist() == [4, 4, 4, 4]
    assert np.bincount(build_observed_wind_by_state(chain, 8).of_state).tolist() == [2] * 8


def test_the_process_chain_drifts_and_spreads_as_ornstein_and_uhlenbeck_say():
    process = OrnsteinUhlenbeckWind(
        std_mps=3.0, time_constant_s=600.0, spacing_mps=1.0, extent_mps=12.0
    )
    chain = process.build_lattice_chain()
    start = int(np.flatnonzero((chain.states_en_mps == [4.0, 0.0]).all(axis=1))[0])
    row = chain.transition_matrix(120.0)[start]
    mean = row @ chain.states_en_mps
    std = np.sqrt(row @ (chain.states_en_mps[:, 0] - mean[0]) ** 2)
    # Uhlenbeck & Ornstein 1930: mean x0 exp(-t/tau), variance s^2 (1 - exp(-2 t/tau)).
    assert mean[0] == pytest.approx(4.0 * math.exp(-0.2), abs=0.1)
    assert std == pytest.approx(math.sqrt(process.predictive_variance_m2ps2(120.0)), rel=0.05)


def test_what_is_seen_now_is_certain_now_and_less_so_later():
    place = np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]], dtype=float)
    edges = np.array(sorted([(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2), (3, 0), (0, 3)]))
    graph = EnergyGraph(place, edges[:, 0], edges[:, 1], 0, 2, 15.0, (1000.0, 500.0))
    far = int(np.flatnonzero((graph.tail == 3) & (graph.head == 2))[0])
    states = np.array([[6.0, 0.0], [-6.0, 0.0]])
    chain = WindChain(states, np.array([[-0.05, 0.05], [0.05, -0.05]]), np.array([0.5, 0.5]))
    spread = ChainUncertainty(graph, chain, build_observed_wind_by_state(chain, None), 600.0)
    origin, seen = np.array([0]), np.array([1])
    std = spread.duration_std_s(origin, seen, states[:1])[:, 0]
    here = graph.tail == 0
    assert (std[here] == 0.0).all()
    assert std[far] > 0.1
    assert lag_until_edge_s(graph, origin)[far, 0] == pytest.approx(100.0 / 15.0)


def test_the_prior_chain_changes_within_minutes_as_the_process_does() -> None:
    wind = build_prior_wind(COAST)
    chain = wind.build_lattice_chain()
    calm = int(np.flatnonzero((chain.states_en_mps == 0.0).all(axis=1))[0])
    row = chain.transition_matrix(300.0)[calm]
    squared = float(row @ chain.states_en_mps[:, 0] ** 2)
    expected = float(COAST.mean_squared_change_m2ps2(np.array([300.0]), LEG_AVERAGING_S)[0])
    # Of the process, from a wind w: variance(lag) + (w (1 - exp(-lag/T)))^2, w^2 = variance(inf).
    gone = -np.expm1(-300.0 / wind.time_constant_s)
    closed = float(wind.predictive_variance_m2ps2(300.0)) + (wind.std_mps * gone) ** 2
    assert closed == pytest.approx(expected, rel=1e-6)
    # Its lattice of 0.75 standard deviations spreads by a seventh slower.
    assert 0.8 * expected < squared < expected
