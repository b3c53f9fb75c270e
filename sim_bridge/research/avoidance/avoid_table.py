"""Tables of the flights that `sim-bridge research avoid --keep` has kept, each policy a row."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError
from sim_bridge.research.avoidance.evaluation import Flights, by_episode, upper95
from sim_bridge.research.avoidance.kept_flights import read_flights
from sim_bridge.research.results.sheet import Sheet

POLICIES = ("none", "none_filtered", "orca", "orca_filtered", "maddpg_bare", "maddpg")
LEARNED, AGAINST = "maddpg", ("orca_filtered", "none_filtered")
HORIZONTAL_M = 5.0
NAME = re.compile(
    r"(?P<policy>\w+?)(-(?P<weights>[0-9a-f]{12}))?-(?P<agents>\d+)-(?P<air>wind|still)"
    r"-(?P<seed>\d+)-(?P<first>\d+)\+(?P<count>\d+)\.npz"
)


@dataclass(frozen=True)
class PolicyRow:
    """All flights of a policy with so many drones, from the first episode on without a gap."""

    policy: str
    agents: int
    episodes: int
    flights: Flights


def rows_of(folder: Path) -> list[PolicyRow]:
    """What is kept in a folder of one seed, one air and one actor."""
    chunks: dict[tuple[str, int], dict[int, tuple[int, Path]]] = {}
    kinds: set[tuple[str, str]] = set()
    actors: set[str] = set()
    for path in sorted(folder.glob("*.npz")):
        said = NAME.fullmatch(path.name)
        if said is None:
            raise LeewayError(f"{path}: not a file of `sim-bridge avoid --keep`")
        kinds.add((said["air"], said["seed"]))
        actors |= {said["weights"]} - {None}
        of = chunks.setdefault((said["policy"], int(said["agents"])), {})
        of[int(said["first"])] = int(said["count"]), path
    if not chunks:
        raise LeewayError(f"{folder}: holds no flights; sim-bridge avoid --keep writes them")
    if len(kinds) > 1 or len(actors) > 1:
        raise LeewayError(f"{folder}: flights of several seeds, airs or actors; expected one each")
    ordered = sorted(chunks, key=lambda key: (key[1], POLICIES.index(key[0])))
    return [row for key in ordered if (row := _joined(*key, chunks[key])) is not None]


def _joined(policy: str, agents: int, chunks: dict[int, tuple[int, Path]]) -> PolicyRow | None:
    flights, episodes = None, 0
    while episodes in chunks:
        count, path = chunks[episodes]
        part = read_flights(path)
        flights = part if flights is None else flights.joined(part)
        episodes += count
    return None if flights is None else PolicyRow(policy, agents, episodes, flights)


def results(rows: list[PolicyRow]) -> Sheet:
    """Counts and means of each policy."""
    head = ["drones, episodes", "policy", "goals", "met a drone (bound, 95 %)", "met a building"]
    head += ["time ratio", "energy ratio", "least separation"]
    cells = []
    for row in rows:
        flown, flights = row.flights, len(row.flights.arrived)
        drones = int(flown.hit_drone.sum())
        cells.append(
            [
                f"{row.agents}, {row.episodes}",
                f"`{row.policy}`",
                f"{flown.arrived.mean():.1%}",
                f"{drones} of {flights} (< {_rounded_up(upper95(drones, flights)):.2%})",
                str(int(flown.hit_building.sum())),
                _shown(*by_episode(flown.time_ratio, row.agents)),
                _shown(*by_episode(flown.energy_ratio, row.agents)),
                f"{HORIZONTAL_M * float(flown.apart.min()):.1f} m",
            ]
        )
    return Sheet("Policies on the same episodes", head, cells, "Intervals by episode, 95 %.")


def compared(rows: list[PolicyRow]) -> Sheet:
    """The learned policy less each other, of flights where both arrived; below zero is better."""
    of = {(row.policy, row.agents): row for row in rows}
    cells = []
    for agents in sorted({row.agents for row in rows}):
        for other in AGAINST:
            if (LEARNED, agents) in of and (other, agents) in of:
                cells.append(_pair(of[LEARNED, agents], of[other, agents]))
    head = ["drones, episodes", "against", "time", "energy", "arrivals"]
    return Sheet(f"{LEARNED} against the others", head, cells, "Intervals by episode, 95 %.")


def _pair(ours: PolicyRow, theirs: PolicyRow) -> list[str]:
    episodes = min(ours.episodes, theirs.episodes)
    count = episodes * ours.agents
    a, b = ours.flights, theirs.flights
    time = a.time_ratio[:count] - b.time_ratio[:count]
    energy = a.energy_ratio[:count] - b.energy_ratio[:count]
    arrived = 100.0 * (a.arrived[:count].astype(float) - b.arrived[:count])
    more, half = by_episode(arrived, ours.agents)
    return [
        f"{ours.agents}, {episodes}",
        f"`{theirs.policy}`",
        _shown(*by_episode(time, ours.agents), signed=True),
        _shown(*by_episode(energy, ours.agents), signed=True),
        f"{more or 0.0:+.1f} ± {half or 0.0:.1f} points",
    ]


def _rounded_up(bound: float) -> float:
    return math.ceil(1e4 * bound) / 1e4


def _shown(mean: float | None, half: float | None, signed: bool = False) -> str:
    if mean is None:
        return "-"
    return f"{mean:{'+' if signed else ''}.3f} ± {half or 0.0:.3f}"
