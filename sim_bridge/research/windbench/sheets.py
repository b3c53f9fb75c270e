"""The leader board as a table."""

from collections.abc import Sequence

from sim_bridge.research.results.sheet import Sheet
from sim_bridge.research.windbench.score import Standing


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
