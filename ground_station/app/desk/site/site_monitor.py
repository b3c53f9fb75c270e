"""Monitors the site for the dispatcher: wind field, fronts, stations, forecast and geo-zones.

Logs the current wind field, and derives the launch holds that are due from each source.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from companion.fleet.messages import State
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.site.forecast_watch import ForecastMonitor
from ground_station.app.desk.site.front_reports import FrontReports
from ground_station.app.desk.site.launch_holds import LaunchHoldControl
from ground_station.app.desk.site.launch_routes import LaunchRoutes
from ground_station.app.desk.site.station_desk import StationMonitor
from ground_station.core.dispatch.hold_source import HoldKey, HoldSource
from ground_station.core.dispatch.wind_holds import PlannedLaunch, WindHoldRules
from ground_station.core.dispatch.zone_holds import ZoneHoldRules
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import AssignmentRow, AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_texts import format_site_wind

WIND_LOG_INTERVAL_S = 300.0
"""Interval between wind log entries. Exclusion or readmission of a member is logged immediately."""

PRE_LAUNCH_STATES = (AssignmentState.ORDERED, AssignmentState.UPLOADED)


@dataclass(slots=True)
class SiteMonitor:
    """Monitor of one desk. `find_sorties`: those of a day with a truck. `forecast_monitor`,
    `stations`: None if the day has none.
    """

    store: Store
    data: DayData
    wind_hold_rules: WindHoldRules
    clock: Clock
    log: Callable[[str], None]
    find_sorties: Callable[[], Sequence[SortieRow]] = lambda: ()
    forecast_monitor: ForecastMonitor | None = None
    stations: StationMonitor | None = None
    hold_control: LaunchHoldControl = field(init=False)
    routes: LaunchRoutes = field(init=False)
    fronts: FrontReports = field(init=False)
    zone_rules: ZoneHoldRules = field(init=False)
    _logged_s: float = -math.inf
    _excluded: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self.hold_control = LaunchHoldControl(self.store, self.clock, self.log)
        self.routes = LaunchRoutes(
            self.store, self.data, self.wind.position_ne_m, self.find_sorties
        )
        self.fronts = FrontReports(self.data, self.routes, self.log)
        self.zone_rules = ZoneHoldRules(self.data)

    @property
    def wind(self) -> SiteWind:
        """The wind field."""
        return self.wind_hold_rules.wind

    def on_state(self, state: State) -> None:
        """Process a state that a member has published."""
        front = self.wind.update_from_state(state, self.clock.monotonic_s())
        if front is not None:
            self.fronts.queue.append(front)

    def on_station_report(self, report: StationWind) -> None:
        """Process a report of a wind station."""
        if self.stations is not None:
            self.fronts.queue += self.stations.process_station_report(report)

    def update_and_report_hold_change(self, status: FleetStatus) -> bool:
        """Run one cycle; True if a hold was placed or cleared. Raises StoreError."""
        now_s = self.clock.monotonic_s()
        self.hold_control.adopt_existing_holds(now_s)
        if self.stations is not None:
            self.fronts.queue += self.stations.poll_files_for_front_updates(now_s)
        self._log_wind_if_due(now_s)
        if self.forecast_monitor is not None:
            self.forecast_monitor.update_forecast_and_check_orders(now_s)
        needs_assignments = (
            self.forecast_monitor is not None
            or self.zone_rules
            or self.wind.drop_expired_and_get_fronts(now_s)
        )
        rows = self.routes.refresh_assignments_in_force() if needs_assignments else []
        changed = self.hold_control.place_and_clear_holds(
            self._reason_by_due_hold(rows, status, now_s), now_s
        )
        self.fronts.report_queued_fronts(rows, status, now_s)
        return changed

    def close(self) -> None:
        """Stop the forecast reader."""
        if self.forecast_monitor is not None and self.forecast_monitor.file_monitor is not None:
            self.forecast_monitor.file_monitor.close()

    def _reason_by_due_hold(
        self, rows: Sequence[AssignmentRow], status: FleetStatus, now_s: float
    ) -> dict[HoldKey, str]:
        """Return the holds that are due, with their reasons; wind before geo-zones and forecast."""
        waiting = [row for row in rows if row.state in PRE_LAUNCH_STATES]
        launches = [self.routes.planned_launch_of(row, status) for row in waiting]
        due = self.wind_hold_rules.update_reason_by_due_hold(now_s, launches)
        due |= self._reason_by_due_zone_hold(waiting, launches, status)
        if self.forecast_monitor is not None:
            closed = self.forecast_monitor.evaluate_hold_reason_by_vehicle(
                waiting, self.routes.orders, self.routes.sorties, now_s
            )
            due |= {(vehicle, HoldSource.FORECAST): reason for vehicle, reason in closed.items()}
        return due

    def _reason_by_due_zone_hold(
        self, rows: Sequence[AssignmentRow], launches: Sequence[PlannedLaunch], status: FleetStatus
    ) -> dict[HoldKey, str]:
        """Return holds for geo-zones that come into force before the flight may have ended."""
        if not self.zone_rules:
            return {}
        now_s, found = self.clock.epoch_us() / 1e6, dict[HoldKey, str]()
        for row, launch in zip(rows, launches, strict=True):
            route = self.routes.reported_route_ne_m(row, status) or launch.positions_ne_m
            max_height_m = self.routes.max_height_above_depot_m(row)
            zone_hold = self.zone_rules.find_zone_hold(
                route, max_height_m, launch.max_duration_s, now_s
            )
            if zone_hold is not None:
                found[row.vehicle, HoldSource.ZONE] = zone_hold.reason_text
        return found

    def _log_wind_if_due(self, now_s: float) -> None:
        excluded = frozenset(self.wind.exclusion_reason_by_member(now_s))
        changed = excluded != self._excluded
        if not changed and now_s - self._logged_s < WIND_LOG_INTERVAL_S:
            return
        wind_text = (
            format_site_wind(self.wind, now_s)
            if changed or self.wind.is_wind_known_by_drones(now_s)
            else ""
        )
        if wind_text or changed:
            self._logged_s, self._excluded = now_s, excluded
            self.log(wind_text or "wind: no accepted member reports it")
