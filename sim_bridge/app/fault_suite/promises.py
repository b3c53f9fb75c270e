"""Calibration of P(home) at the last decision to continue outbound, by group and over all.

Excluded are flights of rows that do not require home (a person keeps control, the motors are
stopped), and flights landed by a person.
"""

from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np
from scipy.stats import binomtest

from sim_bridge.app.fault_suite.catalogue import find_case
from sim_bridge.app.faults.fault import FaultRow
from sim_bridge.app.faults.verdict import check_returned_home

P_HOME_CLASS_EDGES = (0.0, 0.9, 0.97, 0.99, 1.0)
"""Class limits of P(home). The last class counts as a promise."""

MIN_HOME_FRAC = 0.95
"""Required share of returns in each group among flights with P(home) of 0.99 or more."""


BOUND_CONFIDENCE = 0.95
ALL_GROUPS = "all"


class Reliability(msgspec.Struct, frozen=True, kw_only=True):
    """Flights with P(home) from `from_p` to `to_p`: mean P(home), and share that returned."""

    from_p: float
    to_p: float
    flights: int
    p_home: float
    home: float


class GroupPromises(msgspec.Struct, frozen=True, kw_only=True):
    """Calibration of one group, or of all. `brier`: mean squared difference of P(home) and outcome.

    `loss_lower`, `loss_upper`: one-sided 95 % bounds (Clopper and Pearson) of the share of losses
    among flights with P(home) of 0.99 or more; null without such flights.
    """

    group: str
    flights: int
    p_home: float
    home: float
    brier: float
    loss_lower: float | None
    loss_upper: float | None
    reliability: list[Reliability]

    @property
    def returned_and_total_at_high_p_home(self) -> tuple[int, int]:
        """Returned flights and all flights, among those with P(home) of 0.99 or more."""
        top_classes = [each for each in self.reliability if each.to_p == P_HOME_CLASS_EDGES[-1]]
        return sum(round(each.home * each.flights) for each in top_classes), sum(
            e.flights for e in top_classes
        )

    @property
    def is_high_p_home_reliable(self) -> bool:
        """Whether at least 0.95 of the flights with P(home) of 0.99 or more returned."""
        home, of = self.returned_and_total_at_high_p_home
        return home >= MIN_HOME_FRAC * of


def p_home_calibration(
    rows: Sequence[FaultRow], row_field: Literal["group", "fault"] = "group"
) -> list[GroupPromises]:
    """Evaluate P(home) by group or by fault."""
    rated_rows = [
        row
        for row in rows
        if row.p_home_last_go is not None
        and row.outcome != "TAKEN"
        and check_returned_home in find_case(row.fault).rules
    ]
    names = dict.fromkeys(getattr(row, row_field) for row in rated_rows)
    pools = {name: [r for r in rated_rows if getattr(r, row_field) == name] for name in names}
    if len(pools) > 1:
        pools[ALL_GROUPS] = rated_rows
    return [_calibrate_p_home_of_group(name, pool) for name, pool in pools.items()]


def _calibrate_p_home_of_group(group_name: str, rows: Sequence[FaultRow]) -> GroupPromises:
    p_home = np.array([row.p_home_last_go for row in rows], float)
    home = np.array([row.home for row in rows], float)
    promised = home[p_home >= P_HOME_CLASS_EDGES[-2]]
    lower, upper = (
        binomtest(int(np.sum(promised == 0.0)), len(promised), alternative=side).proportion_ci(
            BOUND_CONFIDENCE
        )
        if len(promised)
        else None
        for side in ("greater", "less")
    )
    return GroupPromises(
        group=group_name,
        flights=len(rows),
        p_home=float(p_home.mean()),
        home=float(home.mean()),
        brier=float(np.mean((p_home - home) ** 2)),
        loss_lower=None if lower is None else float(lower.low),
        loss_upper=None if upper is None else float(upper.high),
        reliability=_reliability_by_p_home_class(p_home, home),
    )


def _reliability_by_p_home_class(
    p_home: np.ndarray, returned_home: np.ndarray
) -> list[Reliability]:
    class_indices = np.digitize(p_home, P_HOME_CLASS_EDGES[1:-1])
    return [
        Reliability(
            from_p=P_HOME_CLASS_EDGES[k],
            to_p=P_HOME_CLASS_EDGES[k + 1],
            flights=int(np.sum(class_indices == k)),
            p_home=float(p_home[class_indices == k].mean()),
            home=float(returned_home[class_indices == k].mean()),
        )
        for k in range(len(P_HOME_CLASS_EDGES) - 1)
        if np.any(class_indices == k)
    ]
