"""Reasons why vehicles at the depot get no order: one line each, at desk, `watch` and map."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.tables import IDLE_KEY, LATE_KEY
from ground_station.core.dispatch.depot_assignment import LOADING_S, DepotAssigner
from ground_station.core.dispatch.dispatch_rules import off_pad_text
from ground_station.core.feasibility.reach import Infeasible
from ground_station.core.fleet.fleet_status import FleetStatus, VehicleStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.holds import Hold, hold_of_vehicle_or_of_all
from ground_station.core.schema.orders import Order, OrderState, Service

UPDATE_INTERVAL_S = 1.0
_NUMBERS = re.compile(r"[\d.]+")


@dataclass(slots=True)
class ReasonLog:
    """Reasons by vehicle or order, logged once per kind and stored for `watch` and map."""

    store: Store
    key: str
    log: Callable[[str], None]
    label: str = ""
    _stored: dict[str, str] | None = None
    _logged: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of_late_orders(cls, store: Store, log: Callable[[str], None]) -> "ReasonLog":
        """Return the log of orders that cannot keep their window."""
        return cls(store, LATE_KEY, log)

    def publish(self, reasons: dict[str, str]) -> None:
        """Log new reasons, and store them if they have changed."""
        for name, reason in reasons.items():
            kind = _NUMBERS.sub("", reason)  # a position or charge that varies is one reason
            if self._logged.get(name) != kind:
                self._logged[name] = kind
                self.log(f"{name}: {self.label}{reason}")
        for name in self._logged.keys() - reasons.keys():
            del self._logged[name]
        if reasons != self._stored:
            self.store.database.replace_about_value(self.key, reasons)
            self._stored = reasons


@dataclass(slots=True)
class IdleReasons:
    """Reasons of one desk."""

    store: Store
    data: DayData
    assigner: DepotAssigner
    log: Callable[[str], None]
    now_us: Callable[[], int] = lambda: 0
    _reason_log: ReasonLog = field(init=False)
    _next_s: float = -math.inf

    def __post_init__(self) -> None:
        self._reason_log = ReasonLog(self.store, IDLE_KEY, self.log, "no order: ")

    def update_if_due(self, status: FleetStatus, now_s: float) -> None:
        """Publish the reasons once per `UPDATE_INTERVAL_S`."""
        if now_s < self._next_s:
            return
        self._next_s = now_s + UPDATE_INTERVAL_S
        self._reason_log.publish(self._reason_by_idle_vehicle(status, now_s))

    def _reason_by_idle_vehicle(self, status: FleetStatus, now_s: float) -> dict[str, str]:
        rows = self.store.orders(OrderState.OPEN)
        now_us = self.now_us()
        waiting = [
            row.order
            for row in rows
            if row.order.service is not Service.TRUCK
            and not self.assigner.is_before_window(row.order, now_us, LOADING_S)
        ]
        if not waiting:
            return {}
        order = min(waiting, key=lambda one: math.hypot(*self.assigner.order_ground_ned(one)[:2]))
        busy = {row.vehicle for row in self.store.assignments(in_force=True)} | {TRUCK}
        holds = self.store.holds_in_force()
        found = {
            name: self._reason_or_empty(status, one, order, holds, now_s)
            for name, one in sorted(status.vehicles.items())
            if name not in busy and one.is_uniquely_online_and_reporting(now_s)
        }
        return {name: reason for name, reason in found.items() if reason}

    def _reason_or_empty(
        self,
        status: FleetStatus,
        vehicle: VehicleStatus,
        order: Order,
        holds: Sequence[Hold],
        now_s: float,
    ) -> str:
        """Return the reason, by the nearest order; empty: it is about to get one."""
        state, hold = vehicle.state, hold_of_vehicle_or_of_all(holds, vehicle.vehicle)
        if state is None or hold is not None:
            return "" if hold is None else hold.text
        if not vehicle.can_take_assignment(now_s):
            return "; ".join(vehicle.doubts) or ("armed" if state.armed else f"in {state.phase}")
        off_pad = off_pad_text(state.lat_deg, state.lon_deg, self.data.day.depot.location)
        if off_pad:
            return off_pad
        charge_frac = status.charge_frac_at_rest(vehicle.vehicle)
        found = self.assigner.check_delivery(order, vehicle.vehicle, charge_frac)
        return f"{order.id}: {found.reason}" if isinstance(found, Infeasible) else ""
