"""The dispatcher's desk. `core` decides, `adapters` move bytes, `app` puts them together.

The names of `__all__` are the public interface (docs/reference/api.md), loaded at first use.
"""

from companion.core.base.lazy_exports import lazy_exports

TYPE_CHECKING = False

if TYPE_CHECKING:
    from ground_station.app.planning.api import plan_day, read_day
    from ground_station.core.schema.day_data import DayData
    from ground_station.core.schema.day_plan import DayPlan

__all__ = ["DayData", "DayPlan", "plan_day", "read_day"]

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "DayData": ".core.schema.day_data",
        "DayPlan": ".core.schema.day_plan",
        "plan_day": ".app.planning.api",
        "read_day": ".app.planning.api",
    },
)
