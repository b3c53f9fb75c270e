"""Speed and size of planners and campaigns, each beside its plain alternative."""

import resource
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import networkx as nx
import numpy as np
from scipy.spatial import KDTree

from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import Look
from companion.core.routing.shortest_paths import RouteFinder
from ground_station.adapters.workers.side_by_side import Workers
from sim_bridge.adapters.wall_clock import cpu_s
from sim_bridge.research.benchmarks.timing import (
    Samples,
    cpu_time_s,
    repeated,
    wall_time_s,
)
from sim_bridge.research.campaign.campaign import CampaignParams, Workbench, run_campaign
from sim_bridge.research.campaign.campaign_runner import run
from sim_bridge.research.campaign.scenario_generator import (
    GeneratorParams,
    WindRose,
    random_scenario,
)
from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.bounded_loss_policy import PolicySearch, ValuePolicy
from sim_bridge.research.planners.dynamic_program import solve_delivery, solve_home
from sim_bridge.research.planners.edge_transitions import build_step_model
from sim_bridge.research.planners.markov_chain import WindChain, sight_of
from sim_bridge.research.planners.mission_model import fly_missions
from sim_bridge.research.planners.scenario import LogWind, Scenario
from sim_bridge.research.results.sheet import Sheet

BENCH_SEED = 6
REPEATS = 3  # of the plain loop and of the campaign alike; medians count
RECORDED_MISSIONS = 10_000  # at most: recorded winds never come again, so nothing is remembered
ARM_SLOWER = 4.0  # a Raspberry Pi 4's core against this one in numpy; an estimate, not measured


@dataclass(frozen=True)
class Line:
    """One measured thing."""

    what: str
    figure: str
    bound: str = "-"


def large_problem(
    vertices: int, out_degree: int, states: int = 24, side_m: float = 4000.0
) -> tuple[EnergyGraph, WindChain]:
    """Nearest-neighbour graph with `out_degree` edges a vertex under 8 directions x 3 speeds."""
    random = np.random.default_rng([BENCH_SEED, vertices])
    place = np.column_stack([random.uniform(0, side_m, (vertices, 2)), np.zeros(vertices)])
    near = KDTree(place[:, :2]).query(place[:, :2], out_degree + 1)[1]
    near = np.asarray(near)[:, 1:]
    tail = np.repeat(np.arange(vertices), out_degree)
    edges = np.unique(np.column_stack([tail, near.ravel()]), axis=0)
    centre = np.argsort(np.sum((place[:, :2] - side_m / 2) ** 2, axis=1))
    target = int(np.argmin(np.abs(np.hypot(*(place[:, :2] - place[centre[0], :2]).T) - side_m / 4)))
    graph = EnergyGraph(
        place, edges[:, 0], edges[:, 1], int(centre[0]), target, 15.0, (1900.0, 1100.0)
    )
    rose = WindRose(
        directions=states // 3, offset=False, speeds_mps=(2.0, 6.0, 10.0), jumps="neighbour"
    )
    return graph, WindChain(rose.states_en_mps(), rose.rate_per_s(), np.full(states, 1.0 / states))


def table_lines(
    vertices: int, levels: int, budget_wh: float, side_m: float, search: bool
) -> tuple[list[Line], ValuePolicy | None]:
    """Time of the value table: home, one weight, and the whole search for a bound of 1 %."""
    graph, chain = large_problem(vertices, 8, side_m=side_m)
    size = f"{vertices:,} vertices, {graph.edge_count:,} edges, 24 states, {levels} levels"
    begin = cpu_s()
    model = build_step_model(graph, chain, budget_wh, levels)
    built = cpu_s()
    home = solve_home(model)
    homed = cpu_s()
    solve_delivery(model, home, np.array([0.9]))
    done = cpu_s()
    bound = "5 s" if vertices == 1000 else "60 s"
    lines = [
        Line(f"value table, {size}: edges and chain", f"{built - begin:.2f} s"),
        Line("- the way home, once", f"{homed - built:.2f} s", bound),
        Line("- the way out, a weight", f"{done - homed:.2f} s", bound),
        Line("- the same on an ARM board (estimate, x4)", f"{ARM_SLOWER * (done - homed):.0f} s"),
    ]
    policy = None
    if search:
        begin = cpu_s()
        policy = PolicySearch(model, home).policy(0.01)
        lines.append(Line("- with the search for max loss 1 %", f"{cpu_s() - built:.1f} s", "30 s"))
        flies = policy.home.choice.nbytes + policy.bold.choice.nbytes + policy.careful.choice.nbytes
        lines.append(Line("- choices that fly", f"{flies / 1e6:.1f} MB", "250 MB"))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0 / 1024.0
    lines.append(
        Line("- peak memory of this process", f"{peak:.2f} GB", "0.6" if vertices == 1000 else "2")
    )
    return lines, policy


def decision_lines(policy: ValuePolicy, samples: int = 500) -> list[Line]:
    """A decision by table, by scipy in place, and by networkx, on the large graph."""
    model, graph = policy.model, policy.model.graph
    sight = sight_of(model.chain, None)
    random = np.random.default_rng(BENCH_SEED)
    decider = Ber(policy, sight).begin(np.zeros(1))
    finder, drawn = RouteFinder(graph), _networkx_graph(graph)
    power = graph.power_w[0] / 3600.0
    winds = random.integers(0, sight.count, samples)
    places = random.integers(0, graph.vertex_count, samples)
    left = random.uniform(0, model.budget_wh, samples)

    def by_table(i: int) -> None:
        decider.decide(
            Look(
                np.zeros(1, dtype=np.int64),
                places[i : i + 1],
                np.zeros(1, dtype=bool),
                left[i : i + 1],
                winds[i : i + 1],
                sight.seen_en_mps[winds[i : i + 1]],
            )
        )

    def by_scipy(i: int) -> None:
        energy = graph.duration_s(sight.seen_en_mps[winds[i]])[:, None] * power
        finder.to(graph.target, energy)

    def by_networkx(i: int) -> None:
        energy = graph.duration_s(sight.seen_en_mps[winds[i]]) * power
        for _, _, data in drawn.edges(data=True):
            data["wh"] = energy[data["edge"]]
        reverse = drawn.reverse(copy=False)
        nx.single_source_dijkstra_path_length(reverse, graph.target, weight="wh")

    return [
        Line("decision by table, 1,000 vertices: p50 / p99", _micro(by_table, samples), "1 ms"),
        Line("decision by re-planning, scipy in place", _micro(by_scipy, samples), "10 ms"),
        Line("decision by re-planning, networkx", _micro(by_networkx, 30)),
    ]


def _micro(work: Callable[[int], None], samples: int) -> str:
    work(0)
    each = Samples.of((cpu_time_s(lambda i=i: work(i)) for i in range(samples)), 1e6)
    return f"{each.median:,.0f} / {each.p99:,.0f} us"


def campaign_lines(plain_missions: int = 100) -> list[Line]:
    """Campaigns end to end against a plain loop over networkx, RER, on one core and on two."""
    lines = []
    for kind, scenario in (("chain", bench_scenario()), ("recorded", recorded_scenario())):
        plain = repeated(lambda s=scenario: plain_rer(s, plain_missions), REPEATS)
        rate = Samples.of(plain_missions / seconds for seconds in plain.values)
        lines.append(
            Line(f"plain loop over networkx, RER, {kind} wind", rate.text("missions/s", 0))
        )
        for missions, wanted in ((2_000, "150 x"), (100_000, "1000 x")):
            if kind == "recorded" and missions > RECORDED_MISSIONS:
                continue
            params = CampaignParams(missions=missions, risk_weight=0.0)
            taken = repeated(lambda s=scenario, p=params: run_campaign([s], ["rer"], p), REPEATS)
            faster = Samples.of(missions / seconds for seconds in taken.values).over(rate)
            lines.append(
                Line(
                    f"campaign, RER, {kind} wind, {missions:,} missions",
                    f"{taken.text('s', 3)}, {faster:,.0f} x plain",
                    wanted if kind == "chain" else "-",
                )
            )
    return lines + _two_core_lines()


def _two_core_lines(missions: int = 400_000) -> list[Line]:
    """Wall time of one large campaign in this process and on two others, their start included."""
    scenario = bench_scenario()
    params = CampaignParams(missions=missions, risk_weight=0.0)
    alone = wall_time_s(lambda: run([scenario], ["rer"], params, Workers(1)))
    paired = wall_time_s(lambda: run([scenario], ["rer"], params, Workers(2)))
    return [
        Line(f"campaign, RER, {missions:,} missions, 1 core, by the clock", f"{alone:.2f} s"),
        Line("- 2 cores, the start of both processes included", f"{paired:.2f} s"),
    ]


def bench_scenario() -> Scenario:
    """A sparse graph whose customer is as many edges away as any vertex is."""
    params = GeneratorParams(mean_degree=4.0, sides_m=((600.0, 1.0),), budget_wh=200.0)
    scenario = random_scenario("bench", params, np.random.default_rng(BENCH_SEED))
    hops = nx.single_source_shortest_path_length(nx.DiGraph(scenario.edges), scenario.depot)
    return msgspec.structs.replace(scenario, target=max(hops, key=lambda v: (hops[v], v)))


def recorded_scenario() -> Scenario:
    """The same graph under an hour's wind at 1 Hz that wanders as it might."""
    random = np.random.default_rng([BENCH_SEED, 1])
    wind = np.empty((3600, 2))
    wind[0] = (4.0, 2.0)
    for t in range(1, len(wind)):
        wind[t] = 0.999 * wind[t - 1] + random.normal([0.004, 0.002], 0.12)
    recording = LogWind(
        t_s=np.arange(len(wind), dtype=float).tolist(),
        wind_en_mps=[(float(e), float(n)) for e, n in wind],
        start_s=(0.0, 3000.0),
    )
    return msgspec.structs.replace(bench_scenario(), name="bench-log", wind=recording)


def _networkx_graph(graph: EnergyGraph) -> nx.DiGraph:
    """The same graph as networkx has it: `length_m` and `edge` on edges."""
    drawn = nx.DiGraph(depot=graph.depot, target=graph.target)
    drawn.add_nodes_from(range(graph.vertex_count))
    lengths = graph.length_m.tolist()
    for e, (tail, head) in enumerate(zip(graph.tail.tolist(), graph.head.tolist(), strict=True)):
        drawn.add_edge(tail, head, length_m=lengths[e], edge=e)
    return drawn


def plain_rer(scenario: Scenario, missions: int) -> list[int]:
    """RER as one would write it first: a networkx search at each vertex of each mission."""
    bench = Workbench(scenario, CampaignParams(missions=missions, risk_weight=0.0))
    winds = bench.winds(0)
    graph = bench.graph
    drawn = _networkx_graph(graph)
    known: dict[int, np.ndarray] = {}
    outcomes = []
    for mission in range(missions):
        one, no_load = np.array([mission]), np.array([False])
        at, left, time_s, delivered, outcome = graph.depot, scenario.budget_wh, 0.0, False, None
        for _ in range(4 * graph.vertex_count):
            seen, wind = winds.look(one, np.array([time_s]))
            durations = known.get(int(seen[0]))
            if durations is None:
                durations = graph.duration_s(wind[0])
                if seen[0] >= 0:  # one of a chain's few winds
                    known[int(seen[0])] = durations
            power = graph.power_w[int(delivered)] / 3600.0
            for _, _, data in drawn.edges(data=True):
                data["wh"] = min(power * durations[data["edge"]], 1e9)
            goal = graph.depot if delivered else graph.target
            head = nx.dijkstra_path(drawn, at, goal, weight="wh")[1]
            edge = np.array([drawn.edges[at, head]["edge"]])
            now, rest = np.array([time_s]), np.array([left])
            load = ~no_load if delivered else no_load
            seconds, used = (float(x[0]) for x in winds.fly(one, edge, now, rest, load))
            if used > left:
                break
            left, time_s, at = left - used, time_s + seconds, head
            delivered = delivered or at == graph.target
            if delivered and at == graph.depot:
                outcome = 0
                break
        outcomes.append(outcome if outcome is not None else 1 if delivered else 2)
    return outcomes


def same_as_plain(scenario: Scenario, missions: int = 100) -> bool:
    """True when the campaign's outcomes are the plain loop's, mission by mission."""
    bench = Workbench(scenario, CampaignParams(missions=missions, risk_weight=0.0))
    winds = bench.winds(0)
    flown = fly_missions(
        bench.graph, scenario.budget_wh, winds, bench.build("rer").begin(np.zeros(missions))
    )
    return flown.outcome.tolist() == plain_rer(scenario, missions)


def sheet(large: bool = False) -> Sheet:
    """The whole benchmark; `large` adds the 10,000-vertex table (minutes)."""
    lines = campaign_lines()
    table, policy = table_lines(1000, 200, 300.0, 4000.0, search=True)
    lines += table
    assert policy is not None
    lines += decision_lines(policy)
    if large:
        lines += table_lines(10_000, 200, 900.0, 12_600.0, search=False)[0]
    rows = [[line.what, line.figure, line.bound] for line in lines]
    note = (
        "Seconds of CPU on one core, so that other work on the machine matters less, but where a "
        "line says otherwise."
    )
    return Sheet("Planner speed and size, one core", ["what", "figure", "wanted"], rows, note)
