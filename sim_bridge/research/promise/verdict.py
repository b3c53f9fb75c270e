"""Was the promise kept? Outcome counts of the rules, reliability of the stated P(home), intervals.

Half an hour of wind holds few independent winds, however many missions fly through it. So the
intervals are a block bootstrap: whole units (300 s of a recording, a simulated day) are drawn with
replacement. A bootstrap cannot reflect losses that are absent from the sample. Where it is narrower
than Wilson's interval of the plain counts, Wilson's is used.
"""

from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.stats import binomtest, chi2

from companion.core.base.arrays import Bools, Floats, Ints
from sim_bridge.research.promise.planner import PHASES
from sim_bridge.research.promise.rules import Ends

RESAMPLES = 4000
LEAST_MISSIONS = 100  # in a reliability bin
EDGES = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0)


class RuleRow(msgspec.Struct, frozen=True):
    """Counts of one rule. `margin_wh_mean` is over those that came home; None if none did."""

    missions: int
    go: int
    home: int
    delivered: int
    SUC: int
    margin_wh_mean: float | None

    @property
    def loss(self) -> float:
        """Share of the departed vehicles that did not come home."""
        return (self.go - self.home) / max(self.go, 1)


@dataclass(frozen=True, slots=True)
class HourlyLoss:
    """Lost vehicles over the hours that the departed were in the air."""

    lost: int
    air_h: float

    @property
    def per_hour(self) -> float:
        """Lost per flight hour."""
        return self.lost / max(self.air_h, 1e-9)

    @property
    def most_per_hour(self) -> float:
        """One-sided 95 % limit, losses being independent (Garwood, Biometrika 28, 1936): without a
        loss 3 over the hours."""
        return 0.5 * float(chi2.ppf(0.95, 2 * (self.lost + 1))) / max(self.air_h, 1e-9)


class Bin(msgspec.Struct, frozen=True):
    """Statements with P(home) from `p_low` to `p_high`, and how many came home."""

    p_low: float
    p_high: float
    count: int
    home: int
    lower95: float
    upper95: float


class Go(msgspec.Struct, frozen=True):
    """Decisions to depart, and how many of them came home."""

    count: int
    home: int
    lower95: float


class PromiseVerdict(msgspec.Struct, frozen=True):
    """What `--json` writes (docs/reference/benchmarks.md)."""

    rules: dict[str, RuleRow]
    reliability: list[Bin]
    go: Go


@dataclass(frozen=True, slots=True)
class Statements:
    """Stated P(home), whether it came home, the mission, and its bootstrap unit; arrays (n,)."""

    p_home: Floats
    home: Bools
    mission: Ints
    unit: Ints


def rule_row(ends: Ends) -> RuleRow:
    """One rule's counts."""
    home = ends.home
    return RuleRow(
        missions=int(ends.go.size),
        go=int(ends.go.sum()),
        home=int(home.sum()),
        delivered=int((ends.delivered & ends.go).sum()),
        SUC=int(ends.success.sum()),
        margin_wh_mean=float(ends.margin_wh[home].mean()) if home.any() else None,
    )


def hourly_loss(ends: Ends) -> HourlyLoss:
    """Of one rule."""
    return HourlyLoss(int(ends.lost.sum()), float(ends.air_h[ends.go].sum()))


def statements_of(said: Floats, ends: Ends, unit: Ints) -> Statements:
    """One statement per departed mission and phase that it reached; `said` (n, 3)."""
    there = np.isfinite(said) & ends.go[:, None]
    mission, _ = np.nonzero(there)
    return Statements(said[there], ends.home[mission], mission, unit[mission])


def bins_of(said: Statements, rng: np.random.Generator) -> list[Bin]:
    """Reliability bins of at least LEAST_MISSIONS missions, merged downwards as needed.

    Statements left below the lowest full bin join it. If no bin is full, one bin holds all.
    """
    if said.p_home.size == 0:
        return []
    bounds: list[tuple[float, float]] = []
    high = EDGES[-1]
    for low in reversed(EDGES[:-1]):
        inside = _inside(said.p_home, low, high)
        if np.unique(said.mission[inside]).size >= LEAST_MISSIONS:
            bounds.append((low, high))
            high = low
    if not bounds:
        bounds = [(EDGES[0], EDGES[-1])]
    elif bounds[-1][0] > 0.0 and _inside(said.p_home, 0.0, bounds[-1][0]).any():
        bounds[-1] = (0.0, bounds[-1][1])
    bins: list[Bin] = []
    for low, top in reversed(bounds):
        inside = _inside(said.p_home, low, top)
        lower, upper = interval95(said.home[inside], said.unit[inside], rng)
        count, home = int(inside.sum()), int(said.home[inside].sum())
        bins.append(Bin(low, top, count, home, lower, upper))
    return bins


def said_in(said: Statements, each: Bin) -> float:
    """Mean stated P(home) in a bin."""
    return float(said.p_home[_inside(said.p_home, each.p_low, each.p_high)].mean())


def _inside(p: Floats, low: float, high: float) -> Bools:
    return (p >= low) & ((p < high) | (high >= EDGES[-1]))


def go_of(ends: Ends, unit: Ints, rng: np.random.Generator) -> Go:
    """How many of those that departed came home."""
    home = ends.home[ends.go]
    lower, _ = interval95(home, unit[ends.go], rng)
    return Go(int(home.size), int(home.sum()), lower)


def interval95(hit: Bools, unit: Ints, rng: np.random.Generator) -> tuple[float, float]:
    """95 % interval of the share of hits: bootstrap by units, or Wilson's where that is wider."""
    if hit.size == 0:
        return 0.0, 1.0
    _, index = np.unique(unit, return_inverse=True)
    hits = np.bincount(index, weights=hit.astype(float))
    counts = np.bincount(index).astype(float)
    drawn = rng.integers(0, hits.size, (RESAMPLES, hits.size))
    shares = hits[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    lower, upper = np.quantile(shares, [0.025, 0.975])
    low, high = wilson95(int(hit.sum()), hit.size)
    return min(float(lower), low), max(float(upper), high)


def wilson95(hits: int, count: int) -> tuple[float, float]:
    """Wilson's score interval of a share (E. B. Wilson, JASA 22, 1927)."""
    interval = binomtest(hits, count).proportion_ci(confidence_level=0.95, method="wilson")
    return float(interval.low), float(interval.high)


def said_by_phase(said: Floats, ends: Ends) -> list[tuple[str, int, float, float]]:
    """(phase, statements, mean stated P(home), share home) for the table."""
    rows: list[tuple[str, int, float, float]] = []
    for k, phase in enumerate(PHASES):
        there = np.isfinite(said[:, k]) & ends.go
        if there.any():
            home = float(ends.home[there].mean())
            rows.append((phase, int(there.sum()), float(said[there, k].mean()), home))
    return rows
