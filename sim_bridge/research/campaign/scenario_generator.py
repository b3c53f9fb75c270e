"""Random delivery scenarios: Erdos-Renyi graphs over a square, wind as a chain of vectors.

The paper gives no graph size, edge probability, wind process or airframe numbers. The settings
here are ours, chosen once on seeds of their own (`FITTING_SEED`) so that the
BASELINES come close to the paper's rows.
"""

from dataclasses import dataclass, replace

import msgspec
import networkx as nx
import numpy as np

from companion.core.base.arrays import Floats
from sim_bridge.research.planners.scenario import ChainWind, Power, Scenario

GOLDEN = 0.6180339887498949
FITTING_SEED = 2604_13441  # settings were chosen on scenarios of this seed; tables use others


@dataclass(frozen=True)
class WindRose:
    """A chain over directions x speeds whose states hold for `dwell_s` on average.

    Directions are `directions` equal steps, the first half a step off east where `offset`. From a
    state the wind goes to a neighbouring direction or speed ("neighbour") or to any other ("any").
    """

    directions: int = 16
    offset: bool = True
    speeds_mps: tuple[float, ...] = (2.0, 6.0, 10.0)
    dwell_s: float = 600.0
    jumps: str = "any"

    def states_en_mps(self) -> Floats:
        """Wind vectors, speed by speed; shape (speeds x directions, 2)."""
        angle = (np.arange(self.directions) + 0.5 * self.offset) * 2.0 * np.pi / self.directions
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.concatenate([speed * unit for speed in self.speeds_mps])

    def rate_per_s(self) -> Floats:
        """The generator; shape (S, S)."""
        count = self.directions * len(self.speeds_mps)
        speed, direction = np.divmod(np.arange(count), self.directions)
        if self.jumps == "any":
            near = ~np.eye(count, dtype=bool)
        else:
            turn = np.abs(direction[:, None] - direction[None, :])
            turn = np.minimum(turn, self.directions - turn)
            change = np.abs(speed[:, None] - speed[None, :])
            near = turn + change == 1
        rate = near / np.maximum(near.sum(axis=1, keepdims=True), 1) / self.dwell_s
        np.fill_diagonal(rate, -rate.sum(axis=1))
        return rate

    def wind(self) -> ChainWind:
        """The chain as a scenario states it, with a uniform start."""
        states = self.states_en_mps()
        return ChainWind(
            states_en_mps=[(float(e), float(n)) for e, n in states],
            rate_per_s=self.rate_per_s().tolist(),
            initial=[1.0 / len(states)] * len(states),
        )


@dataclass(frozen=True)
class GeneratorParams:
    """An Erdos-Renyi graph: vertices uniform in a square, edges both ways; and who flies it.

    `sides_m` are (side, share of graphs): the share of small squares sets how many missions are
    within reach.
    """

    vertices: int = 40
    mean_degree: float = 6.0
    sides_m: tuple[tuple[float, float], ...] = ((530.0, 0.5), (1200.0, 0.5))
    budget_wh: float = 100.0
    airspeed_mps: float = 15.0
    loaded_w: float = 1450.0
    empty_w: float = 1450.0
    rose: WindRose = WindRose()


# Wind near the airspeed that turns within an edge: ours, not the paper's; planning matters most.
GUSTY = WindRose(directions=8, offset=False, speeds_mps=(4.0, 9.0, 14.0), dwell_s=5.0)


def random_scenario(
    name: str,
    params: GeneratorParams,
    random: np.random.Generator,
    side: float | None = None,
) -> Scenario:
    """A connected random scenario; a graph that is not connected is drawn again."""
    if side is None:
        sides, shares = zip(*params.sides_m, strict=True)
        side = float(random.choice(sides, p=np.asarray(shares) / sum(shares)))
    while True:
        place = random.uniform(0.0, side, size=(params.vertices, 2))
        pairs = _random_pairs(params.vertices, params.mean_degree, random)
        if nx.is_connected(_undirected(params.vertices, pairs)):
            break
    depot, target = (int(v) for v in random.choice(params.vertices, size=2, replace=False))
    edges = sorted([(a, b) for a, b in pairs] + [(b, a) for a, b in pairs])
    return Scenario(
        format="delivery-scenario/1",
        name=name,
        vertices_m=[(float(e), float(n), 0.0) for e, n in np.round(place, 3)],
        edges=edges,
        depot=depot,
        target=target,
        budget_wh=params.budget_wh,
        airspeed_mps=params.airspeed_mps,
        power_w=Power(loaded=params.loaded_w, empty=params.empty_w),
        wind=params.rose.wind(),
    )


def _random_pairs(
    vertices: int, mean_degree: float, random: np.random.Generator
) -> list[tuple[int, int]]:
    first, second = np.triu_indices(vertices, 1)
    chosen = random.random(len(first)) < mean_degree / (vertices - 1)
    return [(int(a), int(b)) for a, b in zip(first[chosen], second[chosen], strict=True)]


def _undirected(vertices: int, pairs: list[tuple[int, int]]) -> nx.Graph:
    graph = nx.Graph()
    graph.add_nodes_from(range(vertices))
    graph.add_edges_from(pairs)
    return graph


def scenario_set(
    count: int, params: GeneratorParams, seed: int, targets: int = 1
) -> list[Scenario]:
    """`count` graphs with `targets` customers each; the same seed gives the same set.

    Sizes and distances come in turn, not by lot, so that sets of ten graphs differ less.
    """
    scenarios = []
    drawn: dict[float, int] = {}  # customers so far by side
    for g in range(count):
        random = np.random.default_rng([seed, g])
        side = _side_in_turn(params, g)
        base = random_scenario(f"er-{params.vertices}-{seed}-{g}", params, random, side)
        for t in range(targets):
            drawn[side] = drawn.get(side, 0) + 1
            target = _target_in_turn(base, drawn[side], seed)
            scenarios.append(msgspec.structs.replace(base, name=f"{base.name}-{t}", target=target))
    return scenarios


def _target_in_turn(scenario: Scenario, turn: int, seed: int) -> int:
    """A customer by rank of the way from the depot; ranks come evenly, by the golden ratio."""
    place = np.array(scenario.vertices_m)
    graph = nx.Graph()
    for a, b in scenario.edges:
        graph.add_edge(a, b, m=float(np.linalg.norm(place[a] - place[b])))
    way_m = nx.single_source_dijkstra_path_length(graph, scenario.depot, weight="m")
    order = sorted(way_m, key=lambda v: (way_m[v], v))[1:]
    share = (turn * GOLDEN + seed * GOLDEN**2) % 1.0
    return int(order[int(share * len(order))])


def _side_in_turn(params: GeneratorParams, graph: int) -> float:
    """The side of the graph-th square: every ten in a row have the stated shares of sides."""
    turn = (graph % 10 + 0.5) / 10.0
    share = 0.0
    for side, part in params.sides_m:
        share += part
        if turn < share:
            return side
    return params.sides_m[-1][0]


def with_budget(params: GeneratorParams, budget_wh: float) -> GeneratorParams:
    return replace(params, budget_wh=budget_wh)
