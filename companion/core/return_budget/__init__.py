"""The go/no-go gate: will the vehicle still come home? Imports routing and what is below it."""

from typing import TYPE_CHECKING

from companion.core.base.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from companion.core.return_budget.budget import Assessment, Gate, GateDecision, GateParams
    from companion.core.return_budget.remaining_mission import Ahead, Stage, WayHome

__all__ = [
    "Ahead",
    "Assessment",
    "Gate",
    "GateDecision",
    "GateParams",
    "Stage",
    "WayHome",
]

__getattr__ = lazy_exports(
    __name__,
    {
        "Ahead": "remaining_mission",
        "Assessment": "budget",
        "Gate": "budget",
        "GateDecision": "budget",
        "GateParams": "budget",
        "Stage": "remaining_mission",
        "WayHome": "remaining_mission",
    },
)
