"""P(home) at the last decision to go on outward, held against what came of it, by group."""

from collections.abc import Sequence

import msgspec
import numpy as np

from sim_bridge.app.faults.fault_row import FaultRow

EDGES = (0.0, 0.9, 0.97, 0.99, 1.0)
"""Of what was said; the last class is what counts as a promise."""

LEAST_HOME = 0.95
"""Of flights that were promised 0.99 or more so many have to come home, in each group."""


class Reliability(msgspec.Struct, frozen=True, kw_only=True):
    """Of flights that were promised `from_p` to `to_p`: the mean of that, and the share home."""

    from_p: float
    to_p: float
    flights: int
    p_home: float
    home: float


class GroupPromises(msgspec.Struct, frozen=True, kw_only=True):
    """One group. `brier`: the mean square difference of what was said and what came of it."""

    group: str
    flights: int
    p_home: float
    home: float
    brier: float
    reliability: list[Reliability]

    @property
    def sure(self) -> tuple[int, int]:
        """How many came home of those that were promised 0.99 or more, and how many those are."""
        last = [each for each in self.reliability if each.to_p == EDGES[-1]]
        return sum(round(each.home * each.flights) for each in last), sum(e.flights for e in last)

    @property
    def is_kept(self) -> bool:
        """No promise of 0.99 or more kept in less than 0.95."""
        home, of = self.sure
        return home >= LEAST_HOME * of


def by_group(rows: Sequence[FaultRow]) -> list[GroupPromises]:
    """What P(home) was worth in each group. Left out is what a person has landed."""
    return _by(rows, "group")


def by_fault(rows: Sequence[FaultRow]) -> list[GroupPromises]:
    """The same for each fault."""
    return _by(rows, "fault")


def reliability(rows: Sequence[FaultRow]) -> list[Reliability]:
    """The same of all flights together, by what was said."""
    said = _said(rows)
    return _of("", said).reliability if said else []


def _said(rows: Sequence[FaultRow]) -> list[FaultRow]:
    return [row for row in rows if row.p_home_last_go is not None and row.outcome != "TAKEN"]


def _by(rows: Sequence[FaultRow], key: str) -> list[GroupPromises]:
    said = _said(rows)
    names = dict.fromkeys(getattr(row, key) for row in said)
    return [_of(name, [row for row in said if getattr(row, key) == name]) for name in names]


def _of(group: str, rows: Sequence[FaultRow]) -> GroupPromises:
    p_home = np.array([row.p_home_last_go for row in rows], float)
    home = np.array([row.home for row in rows], float)
    return GroupPromises(
        group=group,
        flights=len(rows),
        p_home=float(p_home.mean()),
        home=float(home.mean()),
        brier=float(np.mean((p_home - home) ** 2)),
        reliability=_classes(p_home, home),
    )


def _classes(p_home: np.ndarray, home: np.ndarray) -> list[Reliability]:
    number = np.digitize(p_home, EDGES[1:-1])
    return [
        Reliability(
            from_p=EDGES[k],
            to_p=EDGES[k + 1],
            flights=int(np.sum(number == k)),
            p_home=float(p_home[number == k].mean()),
            home=float(home[number == k].mean()),
        )
        for k in range(len(EDGES) - 1)
        if np.any(number == k)
    ]
