"""Simulated vehicles on MAVLink, whole days, faults, and the experiments.

The names of `__all__` are the public interface (docs/reference/api.md), loaded at first use.
"""

from companion.core.base.lazy_exports import lazy_exports

TYPE_CHECKING = False

if TYPE_CHECKING:
    from companion.core.routing.planner_interface import (
        NO_EDGE,
        STOP_AT_DEPOT,
        BatchPlanner,
        MissionPlanner,
        PlannerObservation,
    )
    from sim_bridge.app.flight.api import FlightResult, fly
    from sim_bridge.research.api import campaign, score_wind
    from sim_bridge.research.planners.planner_plugin import PlanningTask
    from sim_bridge.truth.wind_field import MeanWind

__all__ = [
    "NO_EDGE",
    "STOP_AT_DEPOT",
    "BatchPlanner",
    "FlightResult",
    "MeanWind",
    "MissionPlanner",
    "PlannerObservation",
    "PlanningTask",
    "campaign",
    "fly",
    "score_wind",
]

_INTERFACE = "companion.core.routing.planner_interface"

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "BatchPlanner": _INTERFACE,
        "FlightResult": ".app.flight.api",
        "MeanWind": ".truth.wind_field",
        "MissionPlanner": _INTERFACE,
        "NO_EDGE": _INTERFACE,
        "PlannerObservation": _INTERFACE,
        "PlanningTask": ".research.planners.planner_plugin",
        "STOP_AT_DEPOT": _INTERFACE,
        "campaign": ".research.api",
        "fly": ".app.flight.api",
        "score_wind": ".research.api",
    },
)
