"""Table 2: corners as flown in the graph's missions, the day's clusters and truck, the table."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import PlannerObservation
from sim_bridge.research.campaign.scenario_generator import GeneratorParams, draw_connected_scenario
from sim_bridge.research.dubins.level_paths import FlightLimits
from sim_bridge.research.planners.markov_chain import WindChain, build_observed_wind_by_state
from sim_bridge.research.planners.mission_model import ChainWinds, Outcome, fly_missions
from sim_bridge.research.planners.scenario import build_energy_graph
from sim_bridge.research.tables import table2
from sim_bridge.research.tables.table2_day import (
    DeliveryDay,
    Sortie,
    build_clustering_problem,
    delivery_energy_by_stop_and_customer_wh,
    plan_day,
    truck_makespan_s,
)
from sim_bridge.research.tables.turn_model import (
    CornerModel,
    CornerWinds,
    PredictedEnergyPlanner,
    graph_with_calm_corner_costs,
)

pytestmark = pytest.mark.usefixtures("compiled_planner")

V, R, A = 15.0, 60.0, 2.5
LIMITS = FlightLimits(V, R)
CALM = WindChain(np.zeros((1, 2)), np.zeros((1, 1)), np.ones(1))


def elbow():
    """Return depot, a corner of 90 degrees, the customer; edges both ways."""
    return EnergyGraph(
        vertices_m=np.array([[0.0, 0.0, 0.0], [600.0, 0.0, 0.0], [600.0, 600.0, 0.0]]),
        tail=np.array([0, 1, 1, 2]),
        head=np.array([1, 0, 2, 1]),
        depot=0,
        target=2,
        airspeed_mps=V,
        power_w=(1000.0, 1000.0),
    )


class There:
    """Out to the customer and back, along the only path."""

    def select_edges(self, look):
        out = np.where(look.vertex == 0, 0, 2)
        back = np.where(look.vertex == 2, 3, 1)
        self.seen_wh = look.energy_wh
        return np.where(look.delivered, back, out)


def winds_over(planned, how, count):
    """Return the winds of missions planned with one corner model and flown with the other."""
    graph = graph_with_calm_corner_costs(elbow(), planned)
    sight, random = build_observed_wind_by_state(CALM, None), np.random.default_rng(1)
    return graph, CornerWinds(ChainWinds(graph, CALM, sight, count, random), graph, CALM, how)


def flown(how):
    graph, winds = winds_over(how, how, 3)
    return fly_missions(graph, 100.0, winds, PredictedEnergyPlanner(There(), winds)), winds


def test_a_rounded_corner_shortens_the_way_by_what_the_circle_saves():
    done, winds = flown(CornerModel(LIMITS, A, rounded=True))
    saved_s = (2.0 - math.pi / 2.0) * R / V  # two tangents less a quarter of a circle
    assert (done.outcome == Outcome.SUC).all()
    assert done.time_s == pytest.approx(4 * 600.0 / V - 2 * saved_s, abs=1e-6)
    assert winds.turn_rad == pytest.approx(2.0 * V / R)
    assert winds.off_m == pytest.approx((math.sqrt(2.0) - 1.0) * R, rel=1e-6)


def test_a_corner_that_is_not_rounded_costs_half_a_stop_and_turns_at_once():
    done, winds = flown(CornerModel(LIMITS, A, rounded=False))
    assert done.time_s == pytest.approx(4 * 600.0 / V + 2 * 0.5 * V / A, abs=1e-6)
    assert np.degrees(winds.turn_rad) == pytest.approx(90.0)


def test_planners_never_see_more_energy_than_there_is():
    how = CornerModel(LIMITS, A, rounded=False)
    graph, winds = winds_over(replace(how, accel_mps2=1e9), how, 1)  # planned without cost
    there = There()
    shown = PredictedEnergyPlanner(there, winds)
    true_wh, time_s = np.array([100.0]), np.zeros(1)
    mission, edges = np.zeros(1, dtype=np.int64), (0, 2, 3, 1)
    for edge in edges:
        delivered = np.array([edge in (3, 1)])
        vertex = graph.tail[[edge]]
        shown.select_edges(
            PlannerObservation(mission, vertex, delivered, true_wh, mission, np.zeros((1, 2)))
        )
        assert there.seen_wh <= true_wh
        took_s, used_wh = winds.edge_durations_s_and_energies_wh(
            mission, np.array([edge]), time_s, true_wh, delivered
        )
        time_s, true_wh = time_s + took_s, true_wh - used_wh


def town():
    params = GeneratorParams(vertices=20, square_sizes_m=((1500.0, 1.0),), budget_wh=60.0)
    return build_energy_graph(draw_connected_scenario("town", params, np.random.default_rng(6)))


@pytest.mark.parametrize("method", ["ours", "k-means", "none"])
def test_a_day_serves_every_customer_once(method):
    graph = town()
    customers = [v for v in range(20) if v != graph.depot][:10]
    energy = delivery_energy_by_stop_and_customer_wh(
        graph, customers, np.array([[4.0, 0.0], [0.0, -4.0]]), 60.0
    )
    day = plan_day(graph, build_clustering_problem(graph, customers, energy), method, None)
    flown_to = [s.customer for at_stop in day.sorties for s in at_stop]
    assert sorted([*day.stops, *flown_to]) == sorted(customers)
    assert all(s.stop == stop for stop, at in zip(day.stops, day.sorties, strict=True) for s in at)
    if method != "none":
        reach = {(s.stop, s.customer) for at_stop in day.sorties for s in at_stop}
        assert all(np.isfinite(energy[customers.index(a), customers.index(b)]) for a, b in reach)


def test_a_delivery_costs_the_cheapest_way_out_and_back():
    graph, calm = elbow(), np.zeros((1, 2))
    energy = delivery_energy_by_stop_and_customer_wh(graph, [0, 2], calm, 100.0)
    # 4 legs of 600 m at 15 m/s and 1 kW; out of reach where it leaves less than a tenth.
    assert energy[0, 1] == pytest.approx(4 * 600.0 / 15.0 / 3.6)
    assert math.isinf(delivery_energy_by_stop_and_customer_wh(graph, [0, 2], calm, 45.0)[0, 1])


def test_the_truck_waits_for_the_last_of_four_drones():
    graph = elbow()
    sorties = tuple(Sortie(1, c) for c in range(10, 15))
    day = DeliveryDay((1,), (sorties,), "ours")
    flights = dict(zip(sorties, (100.0, 80.0, 60.0, 40.0, 50.0), strict=True))
    # 600 m there and back at 8 m/s; the fifth flies when the 40 s are over: 90 s; the first: 100.
    assert truck_makespan_s(graph, day, flights) == pytest.approx(2 * 600.0 / 8.0 + 100.0)


def test_the_llms_row_says_that_no_server_is_configured():
    one = table2.TrialResult(90.0, 5.0, 5.0, 60.0, 10.0, 140.0, 11.0, 15, 1200.0, 30.0, "ours")
    rows = {trial.variant: [one, one] for trial in table2.build_trials(1)}
    sheet = table2.table2_sheet(rows)
    cells = {row[0]: row[1:8] for row in sheet.rows}
    assert set(cells.pop(table2.LLM)) == {"not configured"}
    assert len(cells) == 7
    assert all(str(cell) == "90.0 ± 0.0" for cell, *_ in cells.values())
    assert "own method" not in sheet.note
    fallen = table2.table2_sheet({**rows, table2.LLM: [one, replace_method(one, "llm")]})
    assert "LLM replaced by own method on 1 of 2 days." in fallen.note


def replace_method(one, method):
    return msgspec.structs.replace(one, method=method)


def test_the_bank_limit_was_fixed_by_the_papers_max_turn():
    limits = FlightLimits.from_bank(table2.SETTING.airspeed_mps, table2.BANK_LIMIT_RAD)
    # arXiv 2604.13441, Table 2: 11.3 +- 2.1 deg.
    assert math.degrees(2.0 * limits.turn_rate_rps) == pytest.approx(11.3, abs=0.2)
