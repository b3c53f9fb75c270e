"""What must hold of any day, whatever is put into it: by truth, from the row of its end."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from sim_bridge.app.faults.verdict import TRACEBACK

NEAREST_M = 5.0
"""Of any two in the air, by truth. The plan keeps layers 12 m apart; both may be off theirs by a
barometer's drift and a gust, some 3 m each."""

STUCK = "stuck"
"""The desk's state of an order that waits for a person, with the reason."""

Ask = Callable[[dict[str, Any]], list[str]]
"""What is wrong with a day by one rule, in words, from the row of its end."""


def is_over(row: dict[str, Any]) -> list[str]:
    """The desk came to its end by itself."""
    return [] if row["ended"] else [f"not over after {row['duration_s']:.0f} s"]


def loses_no_vehicle(row: dict[str, Any]) -> list[str]:
    """Each flight ended at home with the reserve, or whole where a person wanted it."""
    return [f"not home: {words}" for words in row["lost"]]


def brings_nothing_twice(row: dict[str, Any]) -> list[str]:
    """No order was flown or handed over again after it had been brought."""
    return [f"twice: {order}" for order in row["flown_twice"]]


def loses_no_order(row: dict[str, Any]) -> list[str]:
    """What could be brought was brought, or waits for a person with a reason that is told."""
    return [
        f"lost: {line['order']}: {line['why']}"
        for line in row["undelivered"]
        if line["feasible"] and not line["why"].startswith(f"{STUCK} ")
    ]


def keeps_true_books(row: dict[str, Any]) -> list[str]:
    """The store says delivered of what was, and of nothing else."""
    return [f"the store is wrong about {order}" for order in row["believed_otherwise"]]


def keeps_promises(row: dict[str, Any]) -> list[str]:
    """The truck waited where a vehicle in the air had its home."""
    return row["promises_broken"]


def keeps_apart(row: dict[str, Any]) -> list[str]:
    """No two came near in the air; a vehicle that a person flies is not the plan's."""
    near, taken = row["nearest"], any(flight["taken"] for flight in row["flights"])
    if near is None or taken or near["distance_m"] >= NEAREST_M:
        return []
    pair = " and ".join(near["vehicles"])
    return [f"{pair} came to {near['distance_m']:.1f} m at {near['t_s']:.0f} s"]


def keeps_hands_off(row: dict[str, Any]) -> list[str]:
    """Not one command after the companion could know that a person had taken over."""
    return row["commands_after_take_over"]


def nobody_falls(row: dict[str, Any]) -> list[str]:
    """No companion ends that nobody had killed."""
    return [f"ended by itself: {words}" for words in row["ended_by_themselves"]]


ASKS: tuple[Ask, ...] = (
    is_over,
    loses_no_vehicle,
    brings_nothing_twice,
    loses_no_order,
    keeps_true_books,
    keeps_promises,
    keeps_apart,
    keeps_hands_off,
    nobody_falls,
)


def raises_nothing(folder: Path) -> list[str]:
    """No exception in anything that desk, companions and truck wrote."""
    texts = sorted([*folder.rglob("*.log"), *folder.rglob("*.txt")])
    return [
        f"an exception: {path.relative_to(folder)}"
        for path in texts
        if TRACEBACK in path.read_text(errors="replace")
    ]
