"""The data of a day: its file, its orders, its plan, and their states."""

from typing import TYPE_CHECKING

from companion.core.base.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from ground_station.core.schema.day import Day, DayFilesError, Depot, Drone, Forecast, Truck
    from ground_station.core.schema.day_data import DayData
    from ground_station.core.schema.day_plan import (
        DayPlan,
        PlannedSortie,
        PlannedStop,
        UnplannedOrder,
    )
    from ground_station.core.schema.day_state import DayState, initial_state
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
    "UnplannedOrder",
    "initial_state",
]

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "Day": ".day",
        "DayData": ".day_data",
        "DayFilesError": ".day",
        "DayPlan": ".day_plan",
        "DayState": ".day_state",
        "Depot": ".day",
        "Drone": ".day",
        "Forecast": ".day",
        "Order": ".orders",
        "OrderState": ".order_states",
        "PlannedSortie": ".day_plan",
        "PlannedStop": ".day_plan",
        "Service": ".order_states",
        "Truck": ".day",
        "UnplannedOrder": ".day_plan",
        "initial_state": ".day_state",
    },
)
