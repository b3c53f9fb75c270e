"""The data of a day: its file, its orders, its plan, and what has become of them."""

from typing import TYPE_CHECKING

from companion.core.base.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from ground_station.core.schema.day import Day, DayFilesError, Depot, Drone, Forecast, Truck
    from ground_station.core.schema.day_data import DayData
    from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop, Unplanned
    from ground_station.core.schema.day_state import DayState, first_state
    from ground_station.core.schema.order_states import OrderState, Service
    from ground_station.core.schema.orders import Order

__all__ = [
    "Day",
    "DayData",
    "DayFilesError",
    "DayPlan",
    "DayState",
    "Depot",
    "Drone",
    "Forecast",
    "Order",
    "OrderState",
    "PlannedSortie",
    "PlannedStop",
    "Service",
    "Truck",
    "Unplanned",
    "first_state",
]

__getattr__ = lazy_exports(
    __name__,
    {
        "Day": "day",
        "DayData": "day_data",
        "DayFilesError": "day",
        "DayPlan": "day_plan",
        "DayState": "day_state",
        "Depot": "day",
        "Drone": "day",
        "Forecast": "day",
        "Order": "orders",
        "OrderState": "order_states",
        "PlannedSortie": "day_plan",
        "PlannedStop": "day_plan",
        "Service": "order_states",
        "Truck": "day",
        "Unplanned": "day_plan",
        "first_state": "day_state",
    },
)
