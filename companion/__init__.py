"""The program on the companion computer: estimates the wind, keeps the return budget, flies.

The names of `__all__` are the public interface (docs/reference/api.md), loaded at first use.
"""

from companion.core.base.lazy_exports import lazy_exports

TYPE_CHECKING = False  # `typing` alone takes longer to import than this package

if TYPE_CHECKING:
    from companion.app.api import (
        WindSeries,
        assess_flight,
        can_return,
        estimate_wind,
        read_airframe,
        read_log,
    )
    from companion.core.base.errors import LeewayError
    from companion.core.return_budget.budget import Assessment, Gate
    from companion.core.vehicle.airframe import Airframe
    from companion.core.wind.estimator import WindEstimator
    from companion.core.wind.observation import WindBelief, WindFilter, WindObservation

__all__ = [
    "Airframe",
    "Assessment",
    "Gate",
    "LeewayError",
    "WindBelief",
    "WindEstimator",
    "WindFilter",
    "WindObservation",
    "WindSeries",
    "assess_flight",
    "can_return",
    "estimate_wind",
    "read_airframe",
    "read_log",
]

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "Airframe": ".core.vehicle.airframe",
        "Assessment": ".core.return_budget.budget",
        "Gate": ".core.return_budget.budget",
        "LeewayError": ".core.base.errors",
        "WindBelief": ".core.wind.observation",
        "WindEstimator": ".core.wind.estimator",
        "WindFilter": ".core.wind.observation",
        "WindObservation": ".core.wind.observation",
        "WindSeries": ".app.api",
        "assess_flight": ".app.api",
        "can_return": ".app.api",
        "estimate_wind": ".app.api",
        "read_airframe": ".app.api",
        "read_log": ".app.api",
    },
)
