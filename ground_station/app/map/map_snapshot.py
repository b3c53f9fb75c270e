"""Data of one moment, from which the map's picture is built."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from ground_station.app.map.day_pictured import orders_shown, plan_shown
from ground_station.app.map.fleet_receiver import VehicleTrack
from ground_station.app.map.flight_decisions import FlightDecisions
from ground_station.app.map.manifest import manifest_rows
from ground_station.app.map.picture import WindShown, to_json_types
from ground_station.app.views.day_content import DisplayRows
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, Order


@dataclass(frozen=True, slots=True)
class StoreSnapshot:
    """Store content at one moment, and the values derived from it."""

    rows: DisplayRows = field(default_factory=DisplayRows)
    wind: Forecast | None = None
    tables: dict[str, Any] = field(default_factory=dict)
    orders: dict[str, Order] = field(default_factory=dict)
    assignments: dict[str, AssignmentRow] = field(default_factory=dict)

    @classmethod
    def from_rows(
        cls, rows: DisplayRows, wind: Forecast | None, released: Collection[str] = ()
    ) -> "StoreSnapshot":
        """Build the parts of the picture that depend on the store only, once per reading.

        `released`: assignments whose parcel is confirmed as released.
        """
        shown, plan = orders_shown(rows, released), plan_shown(rows)
        tables: dict[str, Any] = {
            "orders": {k: to_json_types(v) for k, v in shown.items()},
            "manifest": [to_json_types(row) for row in manifest_rows(plan, shown)],
        }
        if plan is not None:
            tables["plan"] = to_json_types(plan)
        return cls(
            rows=rows,
            wind=wind,
            tables=tables,
            orders={row.order.id: row.order for row in rows.orders},
            assignments={row.vehicle: row for row in rows.assignments if row.state in IN_FORCE},
        )


@dataclass(frozen=True, slots=True)
class MapSnapshot:
    """All data of one moment. `t_s`: on the clock of the statuses' receive times.

    `store_error`: error of the unreachable store; empty: reachable. `expiring_certificates`:
    certificates that expire soon. `roster_alarm`: a refused fork or rollback. `desk_alarm`: a
    silent desk, for `desk_silence_s`. `notes`: further notes. `wind_field`: accepted wind of the
    site, None: unknown. `front_texts`, `station_texts`: approaching fronts and unused stations.
    `attention_since_us`: start of each item of the last list; None: the past. `epoch_us`: now.
    """

    t_s: float
    status: FleetStatus
    tracks: Mapping[str, VehicleTrack]
    decisions: FlightDecisions
    store: StoreSnapshot
    store_error: str = ""
    expiring_certificates: str = ""
    roster_alarm: str = ""
    desk_alarm: str = ""
    notes: tuple[str, ...] = ()
    wind_field: WindShown | None = None
    front_texts: tuple[str, ...] = ()
    station_texts: tuple[str, ...] = ()
    desk_silence_s: float | None = None
    desk_received_us: int | None = None
    attention_since_us: Mapping[str, int] | None = None
    epoch_us: int = 0
