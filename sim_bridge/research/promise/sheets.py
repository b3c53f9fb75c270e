"""The results of `promise`: tables and the reliability diagram."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Ints
from sim_bridge.research.promise.bound import most_success
from sim_bridge.research.promise.flying import Fitted, GateFlight
from sim_bridge.research.promise.rules import Ends, ends_of
from sim_bridge.research.promise.verdict import (
    HourlyLoss,
    PromiseVerdict,
    RuleRow,
    Statements,
    bins_of,
    go_of,
    hourly_loss,
    rule_row,
    said_by_phase,
    said_in,
    statements_of,
)
from sim_bridge.research.promise.world import PromiseWorld, block_words
from sim_bridge.research.results.sheet import Sheet

RULES = ("px4_time", "threshold_25", "threshold_35", "clairvoyant")
BOUND = "bound: the same information, the true process"
_BOOTSTRAP_SEED = 6


@dataclass(frozen=True, slots=True)
class PromiseResult:
    """All results of one run."""

    verdict: PromiseVerdict
    statements: Statements
    matched: dict[str, RuleRow]
    """The gate at the loss of each fixed rule, by that rule's name."""
    hourly: dict[str, HourlyLoss]
    matched_hourly: dict[str, HourlyLoss]
    phases: list[tuple[str, int, float, float]]
    fitted: list[Fitted]
    most_SUC: float | None
    """The bound's SUC count at the accepted loss; simulated wind only."""


def result_of(
    world: PromiseWorld, fitted: list[Fitted], flights: Iterable[list[GateFlight]]
) -> PromiseResult:
    """Judge the missions flown: all, or those that an interrupted run completed."""
    names = tuple(world.accepted_losses)
    flown = sorted((f for part in flights for f in part), key=lambda f: f.mission)
    numbers = np.array([f.mission for f in flown], np.int64)
    ends = {name: _ends(world, flown, numbers, k) for k, name in enumerate(names)}
    gate = ends["gate"]
    said = np.array([[np.nan if p is None else p for p in f.said[0]] for f in flown])
    unit = world.unit_of_mission[numbers]
    rng = np.random.default_rng([world.setting.seed, _BOOTSTRAP_SEED])
    statements = statements_of(said, gate, unit)
    by_rule = {name: world.rules[name].of(numbers) for name in RULES}
    fixed = {name: rule_row(each) for name, each in by_rule.items()}
    rules = {"gate": rule_row(gate), **fixed}
    verdict = PromiseVerdict(rules, bins_of(statements, rng), go_of(gate, unit, rng))
    matched = {name: rule_row(each) for name, each in ends.items() if name != "gate"}
    best = np.array([f.p_bound for f in flown if f.p_bound is not None])
    most = most_success(best, world.setting.max_loss * float(gate.go.sum())) if best.size else None
    return PromiseResult(
        verdict,
        statements,
        matched,
        {name: hourly_loss(each) for name, each in {"gate": gate, **by_rule}.items()},
        {name: hourly_loss(ends[name]) for name in matched},
        said_by_phase(said, gate),
        fitted,
        most,
    )


def _ends(world: PromiseWorld, flown: list[GateFlight], numbers: Ints, policy: int) -> Ends:
    count = world.setting.missions
    turn_s, go = np.zeros(count), np.zeros(count, np.bool_)
    turn_s[numbers] = [np.inf if f.turn_s[policy] is None else f.turn_s[policy] for f in flown]
    go[numbers] = [f.go[policy] for f in flown]
    return ends_of(world.drawn.flown, turn_s, go).of(numbers)


def title_of(world: PromiseWorld, missions: int) -> str:
    """One-line description of what was flown."""
    setting = world.setting
    where = ", ".join(Path(name).stem for name in setting.wind_logs)
    where = where or f"{setting.simulated_days} simulated days"
    title = (
        f"Is the promise kept? {where}, {setting.tier}, {world.profile.airspeed_mps:.1f} m/s"
        f" (wind/air {world.wind_over_air:.2f}), max loss {setting.max_loss:g}"
    )
    if missions < setting.missions:
        title += f"; STOPPED after {missions} of {setting.missions} missions"
    return title


def rules_sheet(world: PromiseWorld, result: PromiseResult) -> Sheet:
    """The rules side by side, and the gate at each fixed rule's own loss."""
    rules = result.verdict.rules
    best = rules["clairvoyant"].SUC
    rows = [_cells(name, row, result.hourly[name], best) for name, row in rules.items()]
    rows += [
        _cells(
            f"gate, accepting {world.accepted_losses[name]:.3f} ({name}'s own)",
            row,
            result.matched_hourly[name],
            best,
        )
        for name, row in result.matched.items()
    ]
    if result.most_SUC is not None:
        missions = rules["gate"].missions
        share = 100.0 * result.most_SUC / missions
        below = 100.0 * best / missions - share
        rows.append(
            (
                BOUND,
                "-",
                "-",
                f"{100.0 * world.setting.max_loss:.2f}",
                "-",
                f"{share:.2f}",
                f"{below:.2f}",
                "-",
            )
        )
    go = result.verdict.go
    share = go.home / max(go.count, 1)
    phases = "; ".join(
        f"{phase}: {count} said {said:.4f}, {home:.4f} came home"
        for phase, count, said, home in result.phases
    )
    memories = "; ".join(
        ", ".join(f"{m:.0f}" for m in f.process.memory_s) + f" s, t {f.process.tail_dof}"
        for f in result.fitted
    )
    spreads = ", ".join(f"{f.spread:.2f}" for f in result.fitted)
    accepted = ", ".join(f"{f.accepted['gate']:.2f}" for f in result.fitted)
    note = (
        f"{block_words(world)}. Budget {world.power.budget_wh:.1f} Wh,"
        f" {world.power.loaded_w:.0f} W loaded, {world.power.empty_w:.0f} W empty."
        f" Go decisions that came home: {100.0 * share:.2f} %"
        f" (lower bound {100.0 * go.lower95:.2f} %). {phases}."
        f" Fitted on the other blocks: memories and tails {memories}; spread {spreads};"
        f" a single decision may risk {accepted}. The limits per hour take losses as independent;"
        f" the gate flew {result.hourly['gate'].air_h:.0f} hours."
    )
    head = ("rule", "go %", "home % of go", "loss %", "lost per flight hour (at most, 95 %)",
            "SUC %", "below clairvoyant", "margin Wh")  # fmt: skip
    return Sheet(title_of(world, rules["gate"].missions), head, rows, note)


def _cells(name: str, row: RuleRow, hourly: HourlyLoss, best: int) -> tuple[str, ...]:
    margin = "-" if row.margin_wh_mean is None else f"{row.margin_wh_mean:.1f}"
    return (
        name,
        f"{100.0 * row.go / row.missions:.1f}",
        f"{100.0 * row.home / max(row.go, 1):.2f}",
        f"{100.0 * row.loss:.2f}",
        f"{hourly.per_hour:.2g} ({hourly.most_per_hour:.2g})" if row.go else "-",
        f"{100.0 * row.SUC / row.missions:.2f}",
        f"{100.0 * (best - row.SUC) / row.missions:.2f}",
        margin,
    )


def reliability_sheet(result: PromiseResult) -> Sheet:
    """Stated P(home) against the share that came home."""
    rows: list[tuple[str, ...]] = []
    for each in result.verdict.reliability:
        said = said_in(result.statements, each)
        share = each.home / each.count
        inside = each.lower95 <= said <= each.upper95
        within = "yes" if inside else f"no, {100.0 * abs(said - share):.2f} points off"
        rows.append(
            (
                f"{each.p_low:g} to {each.p_high:g}",
                str(each.count),
                f"{100.0 * said:.2f}",
                f"{100.0 * share:.2f}",
                f"{100.0 * each.lower95:.2f} to {100.0 * each.upper95:.2f}",
                within,
            )
        )
    head = ("P(home) said", "statements", "mean said %", "came home %", "95 % interval", "inside")
    note = "One statement for each mission and phase: departure, half way out, over the customer."
    return Sheet("Reliability of P(home)", head, rows, note)


def draw(result: PromiseResult, title: str, path: Path) -> None:
    """Draw the reliability diagram and a histogram of the stated P(home)."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    bins = result.verdict.reliability
    said = np.array([said_in(result.statements, each) for each in bins])
    share = np.array([each.home / each.count for each in bins])
    low = np.array([each.lower95 for each in bins])
    high = np.array([each.upper95 for each in bins])
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(6.4, 7.0), height_ratios=(3, 1), layout="constrained"
    )
    least = min(0.9, *low.tolist(), *said.tolist()) - 0.02 if bins else 0.9
    top.plot([least, 1.0], [least, 1.0], color="0.6", lw=1, label="kept exactly")
    top.errorbar(
        said,
        share,
        yerr=np.maximum([share - low, high - share], 0.0),
        fmt="o",
        capsize=3,
        label="came home, 95 % interval by blocks",
    )
    for x, y, each in zip(said, share, bins, strict=True):
        top.annotate(f"{each.count}", (x, y), (-6, 6), textcoords="offset points", ha="right")
    top.set(xlim=(least, 1.005), ylim=(least, 1.005), ylabel="share that came home")
    top.set_title(title, fontsize=9, wrap=True)
    top.legend(loc="upper left", frameon=False)
    bottom.hist(result.statements.p_home, bins=np.linspace(max(least, 0.0), 1.0, 41), color="0.5")
    bottom.set(xlim=(least, 1.005), xlabel="P(home) as said", ylabel="statements", yscale="log")
    figure.savefig(path, dpi=130)
    plt.close(figure)
