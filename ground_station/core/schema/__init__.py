"""The data of a day: its file, its orders, its plan, and what has become of them."""

from ground_station.core.schema.day import Day, DayFilesError, Depot, Drone, Forecast, Truck
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop, Unplanned
from ground_station.core.schema.day_state import DayState, first_state
from ground_station.core.schema.orders import Order, OrderState, Service

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
