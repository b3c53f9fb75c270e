"""Missions against a plain loop over networkx, one mission and one edge at a time."""

import math

import msgspec
import networkx as nx
import numpy as np
import pytest

from sim_bridge.research.campaign.scenario_generator import (
    DirectionalWindModel,
    GeneratorParams,
    draw_connected_scenario,
)
from sim_bridge.research.campaign.workbench import PLANNERS, CampaignParams, Workbench
from sim_bridge.research.planners.mission_model import LogWinds, Outcome, fly_missions
from sim_bridge.research.planners.scenario import ChainWind, LogWind, Power, Scenario

COUNT = 60


def scenario_of(seed, budget_wh=45.0):
    rose = DirectionalWindModel(directions=8, offset=True, speeds_mps=(4.0, 12.0), dwell_s=30.0)
    params = GeneratorParams(
        vertices=15,
        square_sizes_m=((600.0, 1.0),),
        loaded_w=1900.0,
        empty_w=1100.0,
        wind_model=rose,
    )
    scenario = draw_connected_scenario(f"plain-{seed}", params, np.random.default_rng(seed))
    return msgspec.structs.replace(scenario, budget_wh=budget_wh)


def recorded(scenario, seed):
    random = np.random.default_rng(seed)
    wind = np.cumsum(random.normal(0.0, 0.4, (900, 2)), axis=0) + np.array([5.0, 0.0])
    log = LogWind(
        t_s=[float(t) for t in range(900)],
        wind_en_mps=[(float(e), float(n)) for e, n in wind],
        start_s=(0.0, 600.0),
    )
    return msgspec.structs.replace(scenario, wind=log)


class PlainMission:
    """docs/reference/outcomes.md, implemented independently: one vehicle, networkx, floats."""

    def __init__(self, scenario, wind_seen, fly_edge):
        self.s, self.wind_seen, self.fly_edge = scenario, wind_seen, fly_edge
        self.g = nx.DiGraph()
        self.g.add_nodes_from(range(len(scenario.vertices_m)))
        self.g.add_edges_from(scenario.edges)
        self.energy, self.t, self.at, self.delivered = (
            scenario.budget_wh,
            0.0,
            scenario.depot,
            False,
        )

    def power(self):
        return self.s.power_w.empty if self.delivered else self.s.power_w.loaded

    def cost(self, a, b, wind, power):
        speed, length = ground_speed(self.s, a, b, wind)
        return power * length / speed / 3600.0 if speed > 0.0 else 1e9

    def costs_to(self, goal, wind, power):
        for a, b in self.g.edges:
            self.g.edges[a, b]["wh"] = min(max(self.cost(a, b, wind, power), 1e-9), 1e9)
        reverse = self.g.reverse(copy=False)
        return nx.single_source_dijkstra_path_length(reverse, goal, weight="wh")

    def step(self, goal, wind):
        total = self.costs_to(goal, wind, self.power())
        options = [
            (self.g.edges[self.at, b]["wh"] + total[b], b)
            for b in self.g.successors(self.at)
            if b in total
        ]
        return min(options)[1] if options else None

    def run(self, choose):
        for _ in range(4 * len(self.s.vertices_m)):
            head = choose(self)
            if head == "stay":
                return Outcome.ABRT
            took, used = self.fly_edge(self, head) if head is not None else (0.0, math.inf)
            if used > self.energy:
                return Outcome.DEL if self.delivered else Outcome.FAIL
            self.energy -= used
            self.t += took
            self.at = head
            self.delivered = self.delivered or head == self.s.target
            if self.delivered and head == self.s.depot:
                return Outcome.SUC
        return Outcome.DEL if self.delivered else Outcome.FAIL


def ground_speed(scenario, a, b, wind):
    span = np.subtract(scenario.vertices_m[b], scenario.vertices_m[a])
    flat = math.hypot(span[0], span[1])
    along = (wind[0] * span[0] + wind[1] * span[1]) / flat
    across = (wind[1] * span[0] - wind[0] * span[1]) / flat
    length = float(np.linalg.norm(span))
    if abs(across) > scenario.airspeed_mps:
        return -1.0, length
    return math.sqrt(scenario.airspeed_mps**2 - across**2) + along, length


def rer(mission):
    goal = mission.s.depot if mission.delivered else mission.s.target
    return mission.step(goal, mission.wind_seen(mission.t))


def ger(mission):
    wind = mission.wind_seen(mission.t)
    options = [
        (mission.cost(mission.at, b, wind, mission.power()), b)
        for b in mission.g.successors(mission.at)
    ]
    return min(options)[1] if options else None


def ser():
    plan = {}

    def choose(mission):
        if not plan:
            wind = mission.wind_seen(0.0)
            plan["wind"] = wind
            energy = 0.0
            for goal, start, empty in (
                (mission.s.target, mission.s.depot, False),
                (mission.s.depot, mission.s.target, True),
            ):
                power = mission.s.power_w.empty if empty else mission.s.power_w.loaded
                energy += mission.costs_to(goal, wind, power).get(start, math.inf)
            if energy > mission.s.budget_wh:
                return "stay"
        return mission.step(
            mission.s.depot if mission.delivered else mission.s.target, plan["wind"]
        )

    return choose


def plain_outcomes(scenario, winds, planner, classes):
    outcomes = []
    if isinstance(scenario.wind, LogWind):
        times, vectors = np.array(scenario.wind.t_s), np.array(scenario.wind.wind_en_mps)
    for i in range(winds.mission_count):
        one = np.array([i])

        def seen(t, one=one):
            return winds.observe_wind_index_and_vector(one, np.array([t]))[1][0]

        def fly_chain(mission, head, one=one):
            state = winds.advance_to_states_at(one, np.array([mission.t]))[0]
            wind = scenario.wind.states_en_mps[state]
            speed, length = ground_speed(scenario, mission.at, head, wind)
            if speed <= 0.0:
                return 0.0, math.inf
            return length / speed, mission.power() * length / speed / 3600.0

        def fly_log(mission, head, i=i):
            left, took = None, 0.0
            while True:
                when = winds.start_s[i] + mission.t + took
                wind = [np.interp(when, times, vectors[:, k]) for k in (0, 1)]
                speed, length = ground_speed(scenario, mission.at, head, wind)
                left = length if left is None else left
                speed = max(speed, 0.0)
                if left <= speed:
                    took += left / speed
                    return took, mission.power() * took / 3600.0
                left -= speed
                took += 1.0
                if mission.power() * took / 3600.0 > mission.energy:
                    return took, math.inf

        fly = fly_chain if isinstance(scenario.wind, ChainWind) else fly_log
        choose = ser() if planner == "ser" else {"rer": rer, "ger": ger}[planner]
        outcomes.append(PlainMission(scenario, seen, fly).run(choose))
    return outcomes


@pytest.mark.sample
@pytest.mark.parametrize("planner", ["ser", "rer", "ger"])
@pytest.mark.parametrize("kind", ["chain", "log"])
@pytest.mark.parametrize("classes", [None, 4])
def test_outcomes_are_those_of_a_plain_loop_over_networkx(planner, kind, classes):
    scenario = scenario_of(11)
    if kind == "log":
        scenario = recorded(scenario, 5)
    params = CampaignParams(missions=COUNT, seed=3, wind_classes=classes, risk_weight=0.0)
    bench = Workbench(scenario, params)
    winds = bench.draw_block_winds(0)
    flown = fly_missions(
        bench.graph,
        scenario.budget_wh,
        winds,
        bench.build_planner(planner).start_batch(np.zeros(COUNT)),
    )
    winds.restart_at_departure()
    assert flown.outcome.tolist() == plain_outcomes(scenario, winds, planner, classes)
    assert len(set(flown.outcome.tolist())) > 1 or planner == "ger"


def test_every_planner_meets_the_same_winds():
    bench = Workbench(scenario_of(11), CampaignParams(missions=50, seed=3))
    first, again = bench.draw_block_winds(0), bench.draw_block_winds(0)
    times = np.linspace(0.0, 300.0, 7)
    every = np.arange(50)
    seen = [first.advance_to_states_at(every, np.full(50, t)) for t in times]
    late = [again.advance_to_states_at(every, np.full(50, t)) for t in times[[0, 3, 6]]]
    assert [s.tolist() for s in late] == [seen[0].tolist(), seen[3].tolist(), seen[6].tolist()]


def test_a_chain_of_winds_stays_as_long_as_its_rates_say():
    bench = Workbench(scenario_of(11), CampaignParams(missions=10_000, seed=3))
    winds = bench.draw_block_winds(0)
    every = np.arange(winds.mission_count)
    start = winds.advance_to_states_at(every, np.zeros(winds.mission_count))
    later = winds.advance_to_states_at(every, np.full(winds.mission_count, 20.0))
    transition = bench.chain.transition_matrix(20.0)  # expm: scipy
    same = np.mean(start == later)
    assert same == pytest.approx(np.mean(np.diag(transition)), abs=0.02)


def one_way(**changes):
    base = Scenario(
        format="delivery-scenario/1",
        name="line",
        vertices_m=[(0, 0, 0), (1500, 0, 0)],
        edges=[(0, 1), (1, 0)],
        depot=0,
        target=1,
        budget_wh=200.0,
        airspeed_mps=15.0,
        power_w=Power(loaded=3600.0, empty=1800.0),
        wind=ChainWind(states_en_mps=[(0.0, 0.0)], rate_per_s=[[0.0]], initial=[1.0]),
    )
    return msgspec.structs.replace(base, **changes)


def outcome(scenario, planner, **params):
    bench = Workbench(scenario, CampaignParams(missions=4, **params))
    winds = bench.draw_block_winds(0)
    flown = fly_missions(
        bench.graph,
        scenario.budget_wh,
        winds,
        bench.cached_planner(planner, winds).start_batch(np.zeros(4)),
    )
    assert len(set(flown.outcome.tolist())) == 1
    return Outcome(int(flown.outcome[0])).name, flown


def test_exactly_enough_energy_is_enough():
    # 100 s loaded at 3600 W and 100 s empty at 1800 W: 100 + 50 Wh.
    name, flown = outcome(one_way(budget_wh=150.0), "rer")
    assert name == "SUC"
    assert flown.energy_wh[0] == pytest.approx(150.0)
    assert flown.time_s[0] == pytest.approx(200.0)
    assert flown.decisions[0] == 2


def still(east, north):
    return ChainWind(states_en_mps=[(east, north)], rate_per_s=[[0.0]], initial=[1.0])


@pytest.mark.parametrize(
    ("change", "ends"),
    [
        ({"budget_wh": 149.9}, {"rer": "DEL", "ser": "ABRT", "ber-paper": "ABRT", "ber": "ABRT"}),
        ({"budget_wh": 99.9}, {"rer": "FAIL", "ser": "ABRT", "ber-paper": "ABRT", "ber": "ABRT"}),
        ({"budget_wh": 0.0}, {"rer": "FAIL", "ser": "ABRT", "ber-paper": "ABRT", "ber": "ABRT"}),
        ({"wind": still(0.0, 20.0)}, {"rer": "FAIL", "ser": "ABRT", "ber": "ABRT"}),
        ({"wind": still(16.0, 0.0)}, {"rer": "DEL"}),
        ({"edges": [(0, 1)]}, {"rer": "DEL", "ber-paper": "ABRT", "ber": "ABRT"}),
    ],
    ids=["short of home", "short of target", "empty", "cross gale", "no way back", "one edge"],
)
def test_what_cannot_succeed_is_a_loss_for_who_never_aborts_and_stay_for_who_knows(change, ends):
    assert {planner: outcome(one_way(**change), planner)[0] for planner in ends} == ends


def test_edges_of_no_length_end_after_four_times_the_vertices():
    there = [(0, 0, 0), (1500, 0, 0), (0, 0, 0)]
    scenario = one_way(vertices_m=there, edges=[(0, 1), (1, 0), (0, 2), (2, 0)])
    name, flown = outcome(scenario, "ger")
    assert name == "FAIL"
    assert flown.decisions[0] == 4 * 3 + 1
    assert outcome(scenario, "ber")[0] == "SUC"
    assert outcome(scenario, "rer")[0] == "SUC"


def test_in_a_recording_a_vehicle_makes_no_way_in_a_gale_and_goes_on_after_it():
    log = LogWind(
        t_s=[0.0, 50.0, 50.5, 70.0, 70.5, 500.0],
        wind_en_mps=[(0, 0), (0, 0), (0, 20.0), (0, 20.0), (0, 0), (0, 0)],
        start_s=(0.0, 0.0),
    )
    scenario = one_way(wind=log)
    bench = Workbench(scenario, CampaignParams(missions=1))
    winds = bench.draw_block_winds(0)
    assert isinstance(winds, LogWinds)
    took = winds.edge_durations_s(np.array([0]), np.array([0]), np.zeros(1), np.full(1, 1000.0))
    assert took[0] == pytest.approx(120.0, abs=1.01)  # 100 s of flight and the 20 s of gale
    assert outcome(scenario, "clairvoyant")[0] == "SUC"


@pytest.mark.sample
@pytest.mark.parametrize("classes", [None, 8])
def test_the_clairvoyant_does_at_least_as_well_as_every_planner(classes):
    scenario = recorded(scenario_of(11), 6)
    params = CampaignParams(missions=200, seed=5, log_levels=60, wind_classes=classes)
    bench = Workbench(scenario, params)
    outcomes = {}
    for planner in PLANNERS:
        winds = bench.draw_block_winds(0)
        decider = bench.cached_planner(planner, winds).start_batch(np.zeros(200))
        outcomes[planner] = fly_missions(bench.graph, scenario.budget_wh, winds, decider).outcome
    best = outcomes["clairvoyant"]
    assert set(best.tolist()) <= {Outcome.SUC, Outcome.ABRT}
    for outcome in outcomes.values():
        assert (best[outcome == Outcome.SUC] == Outcome.SUC).all()
