"""Go/no-go gate on the probability of returning home. Imports routing and packages below it."""

from typing import TYPE_CHECKING

from companion.core.base.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from companion.core.return_budget.budget import Assessment, Gate, GateDecision, GateParams
    from companion.core.return_budget.remaining_mission import RemainingMission, ReturnRoute, Stage

__all__ = [
    "Assessment",
    "Gate",
    "GateDecision",
    "GateParams",
    "RemainingMission",
    "ReturnRoute",
    "Stage",
]

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "RemainingMission": ".remaining_mission",
        "Assessment": ".budget",
        "Gate": ".budget",
        "GateDecision": ".budget",
        "GateParams": ".budget",
        "Stage": ".remaining_mission",
        "ReturnRoute": ".remaining_mission",
    },
)
