"""The leader board as a table."""

from collections.abc import Mapping, Sequence

import numpy as np

from sim_bridge.research.results.sheet import Sheet
from sim_bridge.research.windbench.score import (
    LEAST_DAYS,
    Scored,
    ScoreDifference,
    Standing,
    difference,
    flight_errors_mps,
    standing,
)


def leader_board(standings: Sequence[Standing], windows: int, days: int) -> Sheet:
    """Best first; each folder in a column."""
    folders = sorted({name for one in standings for name in one.folders})
    ranked = sorted(standings, key=lambda one: one.score_mps)
    rows = [
        [
            str(place),
            one.estimator,
            f"{one.score_mps:.2f}",
            f"{one.low_mps:.2f} to {one.high_mps:.2f}",
            "" if one.nees is None else f"{one.nees:.1f}",
            *(f"{one.folders[name]:.2f}" if name in one.folders else "" for name in folders),
            "" if one.vector_mps is None else f"{one.vector_mps:.2f}",
        ]
        for place, one in enumerate(ranked, start=1)
    ]
    head = ("", "estimator", "score, m/s", "95 % by days", "NEES (1-D, ideal 1)")
    return Sheet(
        "Wind estimators on real flights",
        (*head, *(f"{name}, m/s" for name in folders), "wind's vector, m/s"),
        rows,
        f"{windows} windows of 10 s on {days} days. RMS error of the airspeed over a window, days"
        " alike. The wind's vector is judged where a reference tells it.",
    )


def states_sheet(rows: Mapping[str, Sequence[Scored]], whole: str) -> Sheet:
    """What the estimator loses without each of its states; `whole` is the name with all."""
    cells = []
    for name, own in rows.items():
        one = standing(name, own)
        apart = difference(own, rows[whole])
        cells.append(
            [
                name,
                f"{one.score_mps:.3f}",
                "" if one.nees is None else f"{one.nees:.2f}",
                "" if one.vector_mps is None else f"{one.vector_mps:.2f}",
                "" if name == whole else f"{apart.mean_mps:+.3f}",
                "" if name == whole else f"{apart.low_mps:+.3f} to {apart.high_mps:+.3f}",
                "" if name == whole else _verdict(apart),
            ]
        )
    return Sheet(
        "What each state is worth",
        ("estimator", "score, m/s", "NEES (1-D, ideal 1)", "wind's vector, m/s",
         "more error without it, m/s", "95 % by days", "it"),
        cells,
        "The leader board's rule. It earns its place where leaving it out costs error beyond what"
        " days scatter, and harms where leaving it out helps beyond that.",
    )  # fmt: skip


def _verdict(apart: ScoreDifference) -> str:
    if apart.days < LEAST_DAYS:
        return "1 day tells nothing" if apart.days == 1 else f"{apart.days} days tell nothing"
    if apart.low_mps > 0.0:
        return "earns its place"
    return "harms" if apart.high_mps < 0.0 else "makes no difference that shows"


def cold_starts_sheet(rows: Mapping[str, Sequence[Scored]]) -> Sheet:
    """Estimators begun at each full minute in the air."""
    cells = []
    for name, own in rows.items():
        one, errors = standing(name, own), flight_errors_mps(own)
        worst = max(errors, key=lambda key: errors[key])
        cells.append(
            [
                name,
                str(len(errors)),
                f"{one.score_mps:.2f}",
                f"{np.percentile(list(errors.values()), 95.0):.2f}",
                f"{errors[worst]:.2f} ({worst[1]}, {worst[2]})",
                "" if one.nees is None else f"{one.nees:.1f}",
                "" if one.vector_mps is None else f"{one.vector_mps:.2f}",
            ]
        )
    return Sheet(
        "Cold starts in the air",
        ("estimator", "starts", "score, m/s", "19 starts of 20 are under, m/s", "worst start, m/s",
         "NEES (1-D, ideal 1)", "wind's vector, m/s"),
        cells,
        "Begun at each full minute after take-off with no more than the airframe, and judged by the"
        " leader board's rule for the minute that begins 30 s later.",
    )  # fmt: skip
