"""The `delivery-scenario/1` file: one mission on a graph, with its budget, vehicle and wind.

docs/reference/outcomes.md describes it.
"""

import json
import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

import msgspec
import networkx as nx
import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.planners.markov_chain import WindChain

ROW_SUM_TOLERANCE = 1e-6  # relative to the row's largest rate; files have 12 digits
PROBABILITY_TOLERANCE = 1e-6

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Vectors = list[tuple[float, float]]
_AT_LEAST_1 = msgspec.Meta(min_length=1)


class Power(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Electrical power in level flight at the scenario's airspeed, W, with and without parcel."""

    loaded: Positive
    """Power with the parcel, W."""
    empty: Positive
    """Power without the parcel, W."""


class ChainWind(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="chain",
):
    """Wind as a continuous-time Markov chain; vectors point where the air moves to."""

    states_en_mps: Annotated[Vectors, _AT_LEAST_1]
    """East and north part of the wind in each state."""
    rate_per_s: list[list[float]]
    """Rates from state to state; each row sums to 0."""
    initial: list[NotNegative]
    """Probability of each state at the start; sums to 1."""


class LogWind(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="log",
):
    """A recorded wind, linearly interpolated; missions start uniformly in `start_s`."""

    t_s: Annotated[list[float], _AT_LEAST_1]
    """Times of the samples, rising."""
    wind_en_mps: Vectors
    """East and north part of the wind at each of `t_s`."""
    start_s: tuple[float, float]
    """First and last time at which a mission may start."""


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `delivery-scenario/1` file: one mission to plan on a graph; checked by `parse_scenario`."""

    format: Literal["delivery-scenario/1"]
    """The kind of file and its version."""
    name: str
    """The scenario's name."""
    vertices_m: Annotated[list[tuple[float, float, float]], msgspec.Meta(min_length=2)]
    """East, north and up of each waypoint."""
    edges: list[tuple[int, int]]
    """Directed edges, each from one vertex's number to another's."""
    depot: int
    """The vertex where missions start and end."""
    target: int
    """The vertex of the customer."""
    budget_wh: NotNegative
    """Usable energy at the start."""
    airspeed_mps: Positive
    """Airspeed on every edge."""
    power_w: Power
    """Power in level flight."""
    wind: ChainWind | LogWind
    """A Markov chain, or a recording."""


def parse_scenario(text: str | bytes, source: str = "scenario") -> Scenario:
    """Parse the scenario in `text` (JSON). Raises LeewayError with one line on the first error."""
    try:
        tree = json.loads(text, object_pairs_hook=_reject_duplicate_keys)
        for place, value in _numbers_that_are_not_finite(tree):
            raise ValueError(f"{place} = {value!r}: expected a finite number")
        scenario = msgspec.convert(tree, Scenario)
    except msgspec.ValidationError as error:
        raise LeewayError(f"{source}: {_format_validation_error(str(error))}") from None
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise LeewayError(f"{source}: not JSON at {where}: {error.msg}") from None
    except UnicodeDecodeError as error:
        raise LeewayError(f"{source}: not UTF-8 text at byte {error.start}") from None
    except RecursionError:
        raise LeewayError(f"{source}: nested too deeply to be a scenario") from None
    except (ValueError, OverflowError) as error:
        raise LeewayError(f"{source}: {' '.join(str(error).split())}") from None
    try:
        validate_scenario(scenario)
    except LeewayError as error:
        raise LeewayError(f"{source}: {error}") from None
    return scenario


def scenario_json(scenario: Scenario) -> bytes:
    """Encode the scenario as JSON that `parse_scenario` decodes to an equal one."""
    return msgspec.json.encode(scenario)


def chain_from_scenario(wind: ChainWind) -> WindChain:
    """Return the chain of a scenario file. `initial` is scaled to sum to 1 exactly."""
    initial = np.array(wind.initial, dtype=float)
    rate = np.array(wind.rate_per_s, dtype=float).reshape(len(initial), len(initial))
    return WindChain(
        states_en_mps=np.array(wind.states_en_mps, dtype=float).reshape(-1, 2),
        rate_per_s=rate,
        initial=initial / initial.sum(),
    )


def validate_scenario(scenario: Scenario) -> None:
    """Raise LeewayError with the first key whose value contradicts another one's."""
    count = len(scenario.vertices_m)
    for i, edge in enumerate(scenario.edges):
        for end, vertex in zip(("tail", "head"), edge, strict=True):
            _raise_if_no_vertex(f"edges[{i}]: {end}", vertex, count)
    _raise_if_no_vertex("depot:", scenario.depot, count)
    _raise_if_no_vertex("target:", scenario.target, count)
    if scenario.depot == scenario.target:
        raise LeewayError(f"target: {scenario.target} is the depot, expected another vertex")
    graph = nx.DiGraph(scenario.edges)
    graph.add_nodes_from(range(count))
    if not nx.has_path(graph, scenario.depot, scenario.target):
        raise LeewayError(
            f"target: vertex {scenario.target} cannot be reached from depot {scenario.depot}"
        )
    if isinstance(scenario.wind, ChainWind):
        _validate_chain_wind(scenario.wind)
    else:
        _validate_log_wind(scenario.wind)


def _raise_if_no_vertex(place: str, vertex: int, count: int) -> None:
    if not 0 <= vertex < count:
        raise LeewayError(f"{place} {vertex} is not a vertex, expected 0 to {count - 1}")


def _raise_if_length_differs(place: str, values: list[Any], count: int) -> None:
    if len(values) != count:
        raise LeewayError(f"{place}: {len(values)} entries, expected {count}")


def _validate_chain_wind(wind: ChainWind) -> None:
    count = len(wind.states_en_mps)
    _raise_if_length_differs("wind.rate_per_s", wind.rate_per_s, count)
    for i, row in enumerate(wind.rate_per_s):
        place = f"wind.rate_per_s[{i}]"
        _raise_if_length_differs(place, row, count)
        for j, rate in enumerate(row):
            if j != i and rate < 0.0:
                raise LeewayError(f"{place}[{j}] = {rate!r}: expected a rate of 0 or more")
        total = math.fsum(row)
        if abs(total) > ROW_SUM_TOLERANCE * max(abs(rate) for rate in row):
            raise LeewayError(f"{place}: sums to {total:.9g}, expected 0")
    _raise_if_length_differs("wind.initial", wind.initial, count)
    total = math.fsum(wind.initial)
    if abs(total - 1.0) > PROBABILITY_TOLERANCE:
        raise LeewayError(f"wind.initial: sums to {total:.9g}, expected 1")


def _validate_log_wind(wind: LogWind) -> None:
    for i, (before, after) in enumerate(zip(wind.t_s, wind.t_s[1:], strict=False), start=1):
        if after <= before:
            raise LeewayError(f"wind.t_s[{i}] = {after!r}: expected more than {before!r}")
    _raise_if_length_differs("wind.wind_en_mps", wind.wind_en_mps, len(wind.t_s))
    first, last = wind.start_s
    if not wind.t_s[0] <= first <= last <= wind.t_s[-1]:
        raise LeewayError(
            f"wind.start_s = [{first!r}, {last!r}]: expected an interval within"
            f" [{wind.t_s[0]!r}, {wind.t_s[-1]!r}]"
        )


def _numbers_that_are_not_finite(value: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Yield the places of NaN and infinity in a JSON document, which Python's parser accepts."""
    if isinstance(value, float) and not math.isfinite(value):
        yield place, value
    parts = value.items() if isinstance(value, dict) else ()
    parts = enumerate(value) if isinstance(value, list) else parts
    for key, part in parts:
        name = f"[{key}]" if isinstance(value, list) else f".{key}" if place else f"{key}"
        yield from _numbers_that_are_not_finite(part, place + name)


def _reject_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys: dict[str, Any] = {}
    for key, value in pairs:
        if key in keys:
            raise ValueError(f"key `{key}` appears twice")
        keys[key] = value
    return keys


def _format_validation_error(message: str) -> str:
    """msgspec's "problem - at `$.path`" as "path: problem"."""
    problem, separator, path = message.partition(" - at `$")
    if not separator:
        return problem
    return f"{path.rstrip('`').lstrip('.') or 'file'}: {problem}"


def build_energy_graph(scenario: Scenario) -> EnergyGraph:
    """The scenario's graph as arrays; an edge that is listed twice counts once."""
    edges = np.array(sorted(set(scenario.edges)), dtype=np.int64).reshape(-1, 2)
    return EnergyGraph(
        vertices_m=np.array(scenario.vertices_m, dtype=float),
        tail=edges[:, 0].copy(),
        head=edges[:, 1].copy(),
        depot=scenario.depot,
        target=scenario.target,
        airspeed_mps=scenario.airspeed_mps,
        power_w=(scenario.power_w.loaded, scenario.power_w.empty),
    )
