"""What missions came to, own wind alone against the fleet's, where both lose as much.

A policy's risk is set on other fields than it is judged in: those about the other half of the
recording (about a made field, those of the other parity). It is the risk at which it lost
`max_loss` there; between two of the risks that were flown each mission takes one of both by lot.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints
from sim_bridge.research.fleet_wind.mission_study import (
    ABRT,
    DEL,
    FAIL,
    FLEET,
    FRONT_SHARE,
    LEVELS,
    LIED_TO,
    OWN_ONLY,
    SUC,
    MissionSetting,
    MissionsFlown,
)
from sim_bridge.research.results.sheet import Sheet

CODES = {"SUC": SUC, "DEL": DEL, "FAIL": FAIL, "ABRT": ABRT}
POLICIES = (OWN_ONLY, FLEET)
NAMES = {
    OWN_ONLY: "own wind alone",
    FLEET: "the fleet's wind",
    LIED_TO: "a fleet whose desk lies",
    "clairvoyant": "clairvoyant",
}
LOSSES = (0.005, 0.01, 0.02, 0.05)
"""At which policies are compared besides, each at its own risk."""
_RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class MissionEnds:
    """All missions: codes (n, levels) by policy, of the clairvoyant (n,), the fold that each is
    judged in, whether its hour had a front, and its lot (0 to 1).
    """

    by_policy: dict[str, Ints]
    clairvoyant: Ints
    fold: Ints
    front: Bools
    lot: Floats

    @classmethod
    def of(cls, flown: Sequence[MissionsFlown], seed: int) -> "MissionEnds":
        """Joined in the order of the work."""
        counts = [len(one.clairvoyant) for one in flown]
        cases = {one.case for one in flown}
        folds = [one.case if len(cases) > 1 else one.number % 2 for one in flown]
        return cls(
            {p: np.concatenate([np.array(one.ends[p]) for one in flown]) for p in flown[0].ends},
            np.concatenate([np.array(one.clairvoyant) for one in flown]),
            np.repeat(folds, counts),
            np.repeat([one.front for one in flown], counts),
            np.random.default_rng([seed, 13]).uniform(size=sum(counts)),
        )

    def chosen(self, policy: str, max_loss: float) -> Ints:
        """Each mission's end at the risk that was set on the other folds. Who is lied to does not
        know it: its risk is the one that was set where nobody lied.
        """
        codes = self.by_policy[policy]
        honest = self.by_policy[FLEET if policy == LIED_TO else policy]
        found = np.empty(codes.shape[0], np.int64)
        for fold in np.unique(self.fold):
            here = self.fold == fold
            others = honest[~here] if (~here).any() else honest
            found[here] = _at_risk(codes[here], risk_for(others, max_loss), self.lot[here])
        return found

    def at_equal_loss(self, loss: float) -> dict[str, float]:
        """Share of successes of each policy where it loses so much in these very missions."""
        return {policy: _success_at(codes, loss) for policy, codes in self.by_policy.items()}


def risk_for(codes: Ints, max_loss: float) -> tuple[int, float]:
    """The level below, and the share of missions at the next one, that lose `max_loss`."""
    lost = np.maximum.accumulate(_lost(codes).mean(axis=0))
    if lost[0] >= max_loss:
        return 0, 0.0
    if lost[-1] <= max_loss:
        return lost.size - 1, 0.0
    above = int(np.argmax(lost > max_loss))
    return above - 1, float((max_loss - lost[above - 1]) / (lost[above] - lost[above - 1]))


def _at_risk(codes: Ints, risk: tuple[int, float], lot: Floats) -> Ints:
    level, share = risk
    above = min(level + 1, codes.shape[1] - 1)
    return np.where(lot < share, codes[:, above], codes[:, level])


def _success_at(codes: Ints, loss: float) -> float:
    level, share = risk_for(codes, loss)
    success = (codes == SUC).mean(axis=0)
    above = min(level + 1, success.size - 1)
    return float((1.0 - share) * success[level] + share * success[above])


def _lost(codes: Ints) -> Bools:
    return (codes == DEL) | (codes == FAIL)


def mission_row(ends: MissionEnds, max_loss: float) -> dict[str, dict[str, int]]:
    """The JSON's `missions`: how many ended how."""
    found = {policy: _counts(ends.chosen(policy, max_loss)) for policy in ends.by_policy}
    return found | {"clairvoyant": _counts(ends.clairvoyant)}


def _counts(codes: Ints) -> dict[str, int]:
    return {name: int((codes == code).sum()) for name, code in CODES.items()}


def mission_setting_row(
    ends: MissionEnds, flown: Sequence[MissionsFlown], setting: MissionSetting
) -> dict[str, Any]:
    """The JSON's `missions_flown`: what they were, and the comparison at equal losses."""
    low, high = gain_interval(ends, setting.max_loss)
    return {
        "wind_air": setting.wind_air,
        "tier": setting.tier,
        "max_loss": setting.max_loss,
        "front_share": FRONT_SHARE,
        "fleet_used_share": _used(flown),
        "gain_points_95": [low, high],
        "at_equal_loss": [
            {"loss": loss, **ends.at_equal_loss(loss)}
            for loss in sorted({*LOSSES, setting.max_loss})
        ],
    }


def _used(flown: Sequence[MissionsFlown]) -> float:
    return sum(one.used for one in flown) / max(sum(one.asked for one in flown), 1)


def gain_interval(ends: MissionEnds, loss: float) -> tuple[float, float]:
    """95 % interval, by bootstrap of missions, of the fleet's gain in successes at equal loss."""
    count, rng = ends.clairvoyant.size, np.random.default_rng(17)
    gains = np.empty(_RESAMPLES)
    for k in range(_RESAMPLES):
        drawn = rng.integers(0, count, count)
        fleet, own = (_success_at(ends.by_policy[p][drawn], loss) for p in (FLEET, OWN_ONLY))
        gains[k] = 100.0 * (fleet - own)
    low, high = np.quantile(gains, [0.025, 0.975])
    return float(low), float(high)


def mission_sheets(
    ends: MissionEnds, flown: Sequence[MissionsFlown], setting: MissionSetting
) -> dict[str, Sheet]:
    """Two tables: how missions ended, and successes at equal losses."""
    rows: list[list[str]] = []
    count = ends.clairvoyant.size
    every, front = np.ones(count, np.bool_), ends.front
    for words, which in (("all", every), ("hours with a front", front)):
        if not which.any():
            continue
        judged = {p: ends.chosen(p, setting.max_loss)[which] for p in ends.by_policy}
        for policy, codes in (judged | {"clairvoyant": ends.clairvoyant[which]}).items():
            shares = [100.0 * float((codes == code).mean()) for code in CODES.values()]
            rows.append([words, NAMES[policy], f"{codes.size}", *(f"{x:.1f}" for x in shares)])
    head = ["missions", "wind known by", "count", *(f"{name} %" for name in CODES)]
    every_so_many = 1.0 / FRONT_SHARE
    note = (
        f"Wind/air {setting.wind_air:g}, {setting.tier}; loss accepted {100 * setting.max_loss:g} %"
        f" of the missions, each policy's risk set on the other half's fields. {setting.draws}"
        f" fields about each half; one mission in {every_so_many:.0f} in an hour with a front."
        f" The fleet was used at {100 * _used(flown):.0f} % of the looks."
    )
    shares_at: list[list[str]] = []
    for loss in LOSSES:
        at, (low, high) = ends.at_equal_loss(loss), gain_interval(ends, loss)
        own, fleet = 100.0 * at[OWN_ONLY], 100.0 * at[FLEET]
        cells = [f"{100 * loss:g}", f"{own:.1f}", f"{fleet:.1f}", f"{fleet - own:+.1f}"]
        shares_at.append([*cells, f"{low:+.1f} to {high:+.1f}"])
    equal = Sheet(
        "Successes where both lose the same",
        ["lost %", "own wind alone, SUC %", "the fleet's wind, SUC %", "points", "95 %"],
        shares_at,
        "Each policy at the risk at which it loses so much in these very missions. Interval of the"
        " points by bootstrap of missions; fields are few.",
    )
    sheets = {"missions": Sheet("Missions", head, rows, note), "equal-loss": equal}
    return sheets | {"equal-risk": _risk_sheet(ends)}


def _risk_sheet(ends: MissionEnds) -> Sheet:
    """Every risk that was flown: successes and losses of both, decision by decision alike."""
    rows: list[list[str]] = []
    own, fleet = ends.by_policy[OWN_ONLY], ends.by_policy[FLEET]
    rng, count = np.random.default_rng(17), ends.clairvoyant.size
    drawn = rng.integers(0, count, (_RESAMPLES, count))
    for level, risk in enumerate(LEVELS):
        more = 100.0 * ((fleet[:, level] == SUC).astype(float) - (own[:, level] == SUC))
        low, high = np.quantile(more[drawn].mean(axis=1), [0.025, 0.975])
        cells = [f"{100 * risk:.1f}"]
        for codes in (own, fleet):
            each = codes[:, level]
            cells += [f"{100 * (each == SUC).mean():.1f}", f"{int(_lost(each).sum())}"]
        cells += [f"{more.mean():+.1f}", f"{low:+.1f} to {high:+.1f}"]
        if LIED_TO in ends.by_policy:
            each = ends.by_policy[LIED_TO][:, level]
            cells += [f"{100 * (each == SUC).mean():.1f}", f"{int(_lost(each).sum())}"]
        rows.append(cells)
    head = ["risk of one decision %", "own wind alone, SUC %", "lost", "the fleet's wind, SUC %",
            "lost", "points", "95 %"]  # fmt: skip
    head += ["the desk lies, SUC %", "lost"] if LIED_TO in ends.by_policy else []
    note = (
        f"The same {count} missions; lost: how many. A flight that accepts a loss of 1 % takes"
        " risks of 1 to 3 % at a single decision."
    )
    return Sheet("Successes where both take the same risk", head, rows, note)
