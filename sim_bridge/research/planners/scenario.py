"""The `delivery-scenario/1` file: one mission on a graph, with its budget, vehicle and wind.

docs/reference/outcomes.md describes it.
"""

import json
import math
from collections.abc import Iterable
from typing import Any, Literal

import msgspec
import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.planners.markov_chain import WindChain

FORMAT = "delivery-scenario/1"
ROW_SUM_TOLERANCE = 1e-6  # relative to the row's largest rate; files are written with 12 digits
PROBABILITY_TOLERANCE = 1e-6


class Power(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Electrical power in level flight at the scenario's airspeed, W, with and without parcel."""

    loaded: float
    """Power with the parcel, W."""
    empty: float
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

    states_en_mps: list[tuple[float, float]]
    """East and north part of the wind in each state."""
    rate_per_s: list[list[float]]
    """Rates from state to state; each row sums to 0."""
    initial: list[float]
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

    t_s: list[float]
    """Times of the samples, rising."""
    wind_en_mps: list[tuple[float, float]]
    """East and north part of the wind at each of `t_s`."""
    start_s: tuple[float, float]
    """First and last time at which a mission may start."""


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `delivery-scenario/1` file: one mission to plan on a graph; checked by `parse_scenario`."""

    format: Literal["delivery-scenario/1"]
    """The kind of file and its version."""
    name: str
    """The scenario's name."""
    vertices_m: list[tuple[float, float, float]]
    """East, north and up of each waypoint."""
    edges: list[tuple[int, int]]
    """Directed edges, each from one vertex's number to another's."""
    depot: int
    """The vertex where missions start and end."""
    target: int
    """The vertex of the customer."""
    budget_wh: float
    """Usable energy at the start."""
    airspeed_mps: float
    """Airspeed on every edge."""
    power_w: Power
    """Power in level flight."""
    wind: ChainWind | LogWind
    """A Markov chain, or a recording."""


def parse_scenario(text: str | bytes, source: str = "scenario") -> Scenario:
    """The scenario that `text` (JSON) describes; LeewayError in one line naming what is wrong."""
    try:
        tree = json.loads(text, object_pairs_hook=_unique_keys)
        scenario = msgspec.convert(tree, Scenario)
    except msgspec.ValidationError as error:
        raise LeewayError(f"{source}: {_named_place(str(error))}") from None
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
        check_scenario(scenario)
    except LeewayError as error:
        raise LeewayError(f"{source}: {error}") from None
    return scenario


def scenario_json(scenario: Scenario) -> bytes:
    """The scenario as the bytes of a file that `parse_scenario` reads back to an equal one."""
    return msgspec.json.encode(scenario)


def chain_from_scenario(wind: ChainWind) -> WindChain:
    """The chain that a scenario file states; `initial` is scaled to sum to 1 exactly."""
    initial = np.array(wind.initial, dtype=float)
    rate = np.array(wind.rate_per_s, dtype=float).reshape(len(initial), len(initial))
    return WindChain(
        states_en_mps=np.array(wind.states_en_mps, dtype=float).reshape(-1, 2),
        rate_per_s=rate,
        initial=initial / initial.sum(),
    )


def check_scenario(scenario: Scenario) -> None:
    """Raise LeewayError naming the first place where the scenario contradicts its format."""
    _check_graph(scenario)
    _number("budget_wh", scenario.budget_wh, low=0.0)
    _number("airspeed_mps", scenario.airspeed_mps, low=0.0, above=True)
    _number("power_w.loaded", scenario.power_w.loaded, low=0.0, above=True)
    _number("power_w.empty", scenario.power_w.empty, low=0.0, above=True)
    if isinstance(scenario.wind, ChainWind):
        _check_chain(scenario.wind)
    else:
        _check_log(scenario.wind)


def _check_graph(scenario: Scenario) -> None:
    count = len(scenario.vertices_m)
    if count < 2:
        raise LeewayError(f"vertices_m: {count} vertices, expected at least 2")
    for i, vertex in enumerate(scenario.vertices_m):
        _finite(f"vertices_m[{i}]", vertex)
    for i, edge in enumerate(scenario.edges):
        for end, vertex in zip(("tail", "head"), edge, strict=True):
            if not 0 <= vertex < count:
                raise LeewayError(
                    f"edges[{i}]: {end} {vertex} is not a vertex, expected 0 to {count - 1}"
                )
    for key, vertex in (("depot", scenario.depot), ("target", scenario.target)):
        if not 0 <= vertex < count:
            raise LeewayError(f"{key}: {vertex} is not a vertex, expected 0 to {count - 1}")
    if scenario.depot == scenario.target:
        raise LeewayError(f"target: {scenario.target} is the depot, expected another vertex")
    if scenario.target not in _reachable(scenario.edges, scenario.depot):
        raise LeewayError(
            f"target: vertex {scenario.target} cannot be reached from depot {scenario.depot}"
        )


def _reachable(edges: Iterable[tuple[int, int]], start: int) -> set[int]:
    heads: dict[int, list[int]] = {}
    for tail, head in edges:
        heads.setdefault(tail, []).append(head)
    seen, stack = {start}, [start]
    while stack:
        for head in heads.get(stack.pop(), ()):
            if head not in seen:
                seen.add(head)
                stack.append(head)
    return seen


def _check_chain(wind: ChainWind) -> None:
    count = len(wind.states_en_mps)
    if count == 0:
        raise LeewayError("wind.states_en_mps: empty, expected at least 1 state")
    for i, state in enumerate(wind.states_en_mps):
        _finite(f"wind.states_en_mps[{i}]", state)
    if len(wind.rate_per_s) != count:
        raise LeewayError(f"wind.rate_per_s: {len(wind.rate_per_s)} rows, expected {count}")
    for i, row in enumerate(wind.rate_per_s):
        _check_rates(f"wind.rate_per_s[{i}]", row, i, count)
    if len(wind.initial) != count:
        raise LeewayError(f"wind.initial: {len(wind.initial)} entries, expected {count}")
    for i, share in enumerate(wind.initial):
        _number(f"wind.initial[{i}]", share, low=0.0)
    total = math.fsum(wind.initial)
    if abs(total - 1.0) > PROBABILITY_TOLERANCE:
        raise LeewayError(f"wind.initial: sums to {total:.9g}, expected 1")


def _check_rates(where: str, row: list[float], own: int, count: int) -> None:
    if len(row) != count:
        raise LeewayError(f"{where}: {len(row)} entries, expected {count}")
    _finite(where, row)
    for j, rate in enumerate(row):
        if j != own and rate < 0.0:
            raise LeewayError(f"{where}[{j}] = {rate!r}: expected a rate of 0 or more")
    total = math.fsum(row)
    if abs(total) > ROW_SUM_TOLERANCE * max(abs(rate) for rate in row):
        raise LeewayError(f"{where}: sums to {total:.9g}, expected 0")


def _check_log(wind: LogWind) -> None:
    if not wind.t_s:
        raise LeewayError("wind.t_s: empty, expected at least 1 time")
    _finite("wind.t_s", wind.t_s)
    for i, (before, after) in enumerate(zip(wind.t_s, wind.t_s[1:], strict=False), start=1):
        if after <= before:
            raise LeewayError(f"wind.t_s[{i}] = {after!r}: expected more than {before!r}")
    if len(wind.wind_en_mps) != len(wind.t_s):
        raise LeewayError(
            f"wind.wind_en_mps: {len(wind.wind_en_mps)} entries, expected {len(wind.t_s)}"
        )
    for i, vector in enumerate(wind.wind_en_mps):
        _finite(f"wind.wind_en_mps[{i}]", vector)
    _finite("wind.start_s", wind.start_s)
    first, last = wind.start_s
    if not wind.t_s[0] <= first <= last <= wind.t_s[-1]:
        raise LeewayError(
            f"wind.start_s = [{first!r}, {last!r}]: expected an interval within"
            f" [{wind.t_s[0]!r}, {wind.t_s[-1]!r}]"
        )


def _finite(where: str, values: Iterable[float]) -> None:
    for i, value in enumerate(values):
        if not math.isfinite(value):
            raise LeewayError(f"{where}[{i}] = {value!r}: expected a finite number")


def _number(where: str, value: float, low: float, above: bool = False) -> None:
    if not math.isfinite(value) or value < low or (above and value == low):
        bound = f"above {low:g}" if above else f"of {low:g} or more"
        raise LeewayError(f"{where} = {value!r}: expected a finite number {bound}")


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys: dict[str, Any] = {}
    for key, value in pairs:
        if key in keys:
            raise ValueError(f"key `{key}` appears twice")
        keys[key] = value
    return keys


def _named_place(message: str) -> str:
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
