"""Results of `promise`: outcome counts of the rules, reliability of P(home), intervals, tables.

Half an hour of wind holds few independent samples, regardless of the number of missions. The
intervals are therefore a block bootstrap: whole units (300 s of a recording, a simulated day) are
drawn with replacement.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints
from sim_bridge.research.promise.gate_evaluation import (
    FittedPlanner,
    FoldWork,
    fit_planner_for_fold,
    fly_missions,
    split_missions_into_work_items,
)
from sim_bridge.research.promise.losses import Loss, find_losses
from sim_bridge.research.promise.planner import MissionDecisions
from sim_bridge.research.promise.rules import (
    MissionOutcomes,
    outcomes_by_rule,
    outcomes_of_turn_times,
)
from sim_bridge.research.promise.world import (
    BLOCK_S,
    PromiseSetting,
    PromiseWorld,
    cached_promise_world,
)
from sim_bridge.research.study.intervals import bootstrap_share_interval95, poisson_mean_upper95
from sim_bridge.research.study.run import Experiment, ExperimentRun, Report
from sim_bridge.research.study.sheet import Column, Figures, Sheet, format_optional, low_to_high

MIN_BIN_MISSIONS = 100  # in a reliability bin
BIN_EDGES = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0)
_BOOTSTRAP_SEED = 6


class RuleRow(msgspec.Struct, frozen=True):
    """Counts of one rule. `margin_wh_mean`: mean over returned vehicles; None without one."""

    missions: int
    go: int
    home: int
    delivered: int
    SUC: int
    margin_wh_mean: float | None

    @classmethod
    def from_outcomes(cls, outcomes: MissionOutcomes) -> "RuleRow":
        """Count the outcomes of one rule."""
        home = outcomes.returned_home
        return cls(
            missions=int(outcomes.go.size),
            go=int(outcomes.go.sum()),
            home=int(home.sum()),
            delivered=int((outcomes.delivered & outcomes.go).sum()),
            SUC=int(outcomes.delivered_and_returned_home.sum()),
            margin_wh_mean=float(outcomes.margin_wh[home].mean()) if home.any() else None,
        )

    @property
    def loss(self) -> float:
        """Share of the departed vehicles that did not return home."""
        return (self.go - self.home) / max(self.go, 1)


class LossRate(msgspec.Struct, frozen=True):
    """Losses of one rule per flight hour, taken as independent, and their 95 % upper bound."""

    lost: int
    flight_h: float
    per_flight_h: float
    upper95_per_flight_h: float

    @classmethod
    def from_outcomes(cls, outcomes: MissionOutcomes) -> "LossRate":
        """Count the losses and flight hours of one rule."""
        lost, hours = outcomes.losses_and_flight_hours
        divisor = max(hours, 1e-9)
        return cls(lost, hours, lost / divisor, poisson_mean_upper95(lost) / divisor)


class Bin(msgspec.Struct, frozen=True):
    """Predictions with P(home) from `p_low` to `p_high`, their mean, and the count that returned
    home.
    """

    p_low: float
    p_high: float
    p_home_mean: float
    count: int
    home: int
    lower95: float
    upper95: float


@dataclass(frozen=True, slots=True)
class Predictions:
    """Predicted P(home), actual return, mission number and bootstrap unit; arrays (n,)."""

    p_home: Floats
    home: Bools
    mission: Ints
    unit: Ints


def collect_predictions(
    predictions: Floats, outcomes: MissionOutcomes, bootstrap_unit: Ints
) -> Predictions:
    """Return one prediction per departed mission and reached phase; `predictions` (n, 3)."""
    has_prediction = np.isfinite(predictions) & outcomes.go[:, None]
    mission, _ = np.nonzero(has_prediction)
    return Predictions(
        predictions[has_prediction],
        outcomes.returned_home[mission],
        mission,
        bootstrap_unit[mission],
    )


def reliability_bins(predictions: Predictions, rng: np.random.Generator) -> list[Bin]:
    """Return reliability bins of at least MIN_BIN_MISSIONS missions, merged downwards as needed.

    Predictions below the lowest full bin join it. If no bin is full, one bin holds all.
    """
    if predictions.p_home.size == 0:
        return []
    bounds: list[tuple[float, float]] = []
    high = BIN_EDGES[-1]
    for low in reversed(BIN_EDGES[:-1]):
        inside = _is_in_bin(predictions.p_home, low, high)
        if np.unique(predictions.mission[inside]).size >= MIN_BIN_MISSIONS:
            bounds.append((low, high))
            high = low
    if not bounds:
        bounds = [(BIN_EDGES[0], BIN_EDGES[-1])]
    elif bounds[-1][0] > 0.0 and _is_in_bin(predictions.p_home, 0.0, bounds[-1][0]).any():
        bounds[-1] = (0.0, bounds[-1][1])
    bins: list[Bin] = []
    for low, top in reversed(bounds):
        inside = _is_in_bin(predictions.p_home, low, top)
        home = predictions.home[inside]
        interval95 = share_interval95(home, predictions.unit[inside], rng)
        mean = float(predictions.p_home[inside].mean())
        bins.append(Bin(low, top, mean, int(inside.sum()), int(home.sum()), *interval95))
    return bins


def share_interval95(hit: Bools, unit: Ints, rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % interval of the share of hits, missions of one unit drawn together."""
    _, index = np.unique(unit, return_inverse=True)
    counts = np.bincount(index)
    return bootstrap_share_interval95(np.bincount(index, weights=hit), counts, rng)


def _is_in_bin(p: Floats, low: float, high: float) -> Bools:
    return (p >= low) & ((p < high) | (high >= BIN_EDGES[-1]))


def promise_document(
    ends: dict[str, MissionOutcomes],
    statements: Predictions,
    losses: list[Loss],
    bootstrap_unit: Ints,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Return the JSON document (docs/reference/benchmarks.md); `ends`: outcomes by rule, `losses`
    those of the gate.
    """
    gate = ends["gate"]
    bins, home = reliability_bins(statements, rng), gate.returned_home[gate.go]
    lower, _ = share_interval95(home, bootstrap_unit[gate.go], rng)
    return {
        "rules": {name: RuleRow.from_outcomes(each) for name, each in ends.items()},
        "reliability": bins,
        "go": {"count": int(home.size), "home": int(home.sum()), "lower95": lower},
        "rates": {name: LossRate.from_outcomes(each) for name, each in ends.items()},
        "losses": losses,
        "losses_by_cause": Counter(loss.cause for loss in losses),
    }


def evaluate_promise(setting: PromiseSetting, run: ExperimentRun) -> Report:
    """Fit a planner per fold, fly its missions and evaluate them; return tables and JSON."""
    world = cached_promise_world(setting)
    for recording in world.recordings:
        for fault in recording.faults:
            run.print_message(f"sim-bridge promise: {fault}")
    folds = [FoldWork(setting, fold) for fold in range(len(world.block_indices_by_fold))]
    fitted = run.run_cases_and_return_results(
        Experiment("fitting", folds, fit_planner_for_fold, FittedPlanner)
    )
    work = split_missions_into_work_items(world, fitted)
    flown = run.run_cases_and_return_results(
        Experiment("missions", work, fly_missions, list[tuple[int, MissionDecisions]])
    )
    by_mission = dict(one for part in flown for one in part)
    return _build_report(world, fitted, [by_mission[k] for k in range(setting.missions)])


def _build_report(
    world: PromiseWorld, fitted: list[FittedPlanner], flown: Iterable[MissionDecisions]
) -> Report:
    turn_s = np.array([one.turn_s for one in flown])
    gate = outcomes_of_turn_times(world.flown, turn_s, turn_s > 0.0)
    predicted = np.array([one.p_home_by_phase for one in flown], np.float64)
    unit = world.bootstrap_unit_by_mission
    statements = collect_predictions(predicted, gate, unit)
    ends = {"gate": gate, **outcomes_by_rule(world.flown)}
    rng = np.random.default_rng([world.setting.seed, _BOOTSTRAP_SEED])
    losses = find_losses(world.flown, gate, turn_s, predicted)
    document = promise_document(ends, statements, losses, unit, rng)
    sheets = {
        "rules": _rules_sheet(world, fitted, document, ends),
        "reliability": _reliability_sheet(document["reliability"]),
        "losses": _losses_sheet(losses),
    }
    return Report(sheets, document)


def _rules_sheet(
    world: PromiseWorld,
    fitted: list[FittedPlanner],
    document: dict[str, Any],
    ends: dict[str, MissionOutcomes],
) -> Sheet:
    """Return the table that compares the rules."""
    setting, power = world.setting, world.power
    rules, go = document["rules"], document["go"]
    where = ", ".join(Path(name).stem for name in setting.wind_logs)
    title = (
        f"Is the promise kept? {where or f'{setting.simulated_days} simulated days'},"
        f" {setting.tier}, {power.profile.airspeed_mps:.1f} m/s (wind/air"
        f" {world.mean_wind_mps / power.profile.airspeed_mps:.2f}), max loss {setting.max_loss:g}"
    )
    note = (
        f"Stretches: {len(world.stretches)},"
        f" {sum(s.seconds for s in world.stretches) / 60.0:.0f} min; judged blocks of about"
        f" {BLOCK_S // 60} min: {len(world.blocks)}; longest mission"
        f" {math.ceil(power.endurance_s)} s. Budget {power.budget_wh:.1f} Wh,"
        f" {power.loaded_w:.0f} W loaded, {power.empty_w:.0f} W empty."
        f" Go decisions that came home: {100.0 * go['home'] / max(go['count'], 1):.2f} %"
        f" (lower bound {100.0 * go['lower95']:.2f} %)."
        f" Fitted on the other blocks: spread {', '.join(f'{f.spread:.2f}' for f in fitted)};"
        f" a single decision may risk {', '.join(f'{f.accepted:.2f}' for f in fitted)}."
        f" The limits per hour take losses as independent; the gate flew"
        f" {ends['gate'].losses_and_flight_hours[1]:.0f} hours."
    )

    def percent(count: int, name: str) -> float:
        return 100.0 * count / rules[name].missions

    rates: dict[str, LossRate] = document["rates"]
    best = rules["clairvoyant"].SUC
    columns: dict[str, Column] = {
        "rule": lambda name: name,
        "go %": lambda name: f"{percent(rules[name].go, name):.1f}",
        "home % of go": lambda name: f"{100.0 * (1.0 - rules[name].loss):.2f}",
        "loss %": lambda name: f"{100.0 * rules[name].loss:.2f}",
        "lost per flight hour": lambda name: f"{rates[name].per_flight_h:.2g}",
        "at most, 95 %": lambda name: f"{rates[name].upper95_per_flight_h:.2g}",
        "SUC %": lambda name: f"{percent(rules[name].SUC, name):.2f}",
        "below clairvoyant": lambda name: f"{percent(best - rules[name].SUC, name):.2f}",
        "margin Wh": lambda name: format_optional(rules[name].margin_wh_mean, ".1f", "-"),
    }
    return Sheet.from_objects(title, rules, columns, note)


def _reliability_sheet(bins: list[Bin]) -> Sheet:
    """Return the table of predicted P(home) against the share that returned home."""

    def format_interval_agreement(row: Bin) -> Figures:
        if row.lower95 <= row.p_home_mean <= row.upper95:
            return Figures("yes", {"{}": "yes", "points off": ""})
        off = f"{100.0 * abs(row.p_home_mean - row.home / row.count):.2f}"
        return Figures(f"no, {off} points off", {"{}": "no", "points off": off})

    return Sheet.from_objects(
        "Reliability of P(home)",
        bins,
        {
            "P(home) stated": lambda row: low_to_high((row.p_low, row.p_high), "g"),
            "statements": "{0.count}",
            "mean stated": "{0.p_home_mean:.2%}",
            "came home": lambda row: f"{row.home / row.count:.2%}",
            "95 %": lambda row: low_to_high((row.lower95, row.upper95), ".2%"),
            "inside": format_interval_agreement,
        },
        "One statement for each mission and phase: departure, half way out, over the customer.",
    )


def _losses_sheet(losses: list[Loss]) -> Sheet:
    """Return the table of the gate's losses."""

    def stated(row: Loss) -> str:
        return ", ".join("-" if p is None else f"{p:.4f}" for p in row.p_home)

    return Sheet.from_objects(
        "Losses of the gate",
        losses,
        {
            "mission": "{0.mission}",
            "P(home) stated": stated,
            "way home from s": "{0.start_of_return_s:.0f}",
            "short of Wh": lambda row: format_optional(row.shortage_wh, ".1f", "-"),
            "headwind before m/s": "{0.headwind_before_mps:.1f}",
            "after m/s": "{0.headwind_after_mps:.1f}",
            "left in steady wind Wh": "{0.steady_margin_wh:.1f}",
            "cause": "{0.cause}",
        },
        "Stated at departure, half way out, over the customer.",
    )
