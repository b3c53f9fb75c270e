"""Content of the store on the day, read at one moment, for display."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.shift.days import read_spares
from ground_station.adapters.store.shift.handover import read_handover
from ground_station.adapters.store.shift.pack_store import pack_by_vehicle
from ground_station.adapters.store.tables import CONFIRM_KEY, IDLE_KEY, LATE_KEY
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, format_minutes_and_seconds
from ground_station.core.schema.holds import Handover, Hold
from ground_station.core.schema.orders import AssignmentRow, OrderRow
from ground_station.core.schema.sortie_rows import SortieRow, StopTimes

MAX_NEXT_SORTIES = 5


@dataclass(frozen=True, slots=True)
class DayShown:
    """Displayed day with a truck: the active plan, its sorties, the day's time, the visits."""

    plan: DayPlan
    sorties: list[SortieRow]
    start_us: int | None
    now_us: int
    visits: Sequence[StopTimes] = ()

    def next_unassigned_sorties(self, open_orders: set[str]) -> list[PlannedSortie]:
        """Return the next sorties."""
        assigned = [row.sortie for row in self.sorties]
        remaining = [s for s in self.plan.sorties if s.order in open_orders and s not in assigned]
        return sorted(remaining, key=lambda s: s.launch_s)[:MAX_NEXT_SORTIES]

    @property
    def plan_and_time_title(self) -> str:
        """Plan number and time of the day."""
        if self.start_us is None:
            return f"plan {self.plan.revision}, not started"
        now_s = (self.now_us - self.start_us) / 1e6
        planned = format_minutes_and_seconds(self.plan.makespan_s)
        return f"plan {self.plan.revision}, {format_minutes_and_seconds(now_s)} of {planned}"

    def active_sortie_of(self, vehicle: str) -> SortieRow | None:
        """Return the sortie of a drone that is on a pad, in flight, or landed and not recovered."""
        own_rows = (row for row in self.sorties if row.vehicle == vehicle)
        return next(
            (
                row
                for row in own_rows
                if not (row.is_drone_on_truck or row.is_drone_lost_off_site_or_overdue)
            ),
            None,
        )

    def binding_sortie_texts(self, stop: str) -> list[str]:
        """Return the sorties that keep the truck at a stop, as text."""
        return [reason for row in self.sorties if (reason := row.binding_reason(stop)) is not None]


@dataclass(frozen=True, slots=True)
class DisplayRows:
    """Rows of the store on the day, read at one moment."""

    assignments: Sequence[AssignmentRow] = ()
    orders: Sequence[OrderRow] = ()
    day: DayShown | None = None
    hold_list: Sequence[Hold] = ()
    idle_reasons: Mapping[str, str] = field(default_factory=dict)
    late_orders: Mapping[str, str] = field(default_factory=dict)
    """Orders that cannot keep their window, with the reason."""
    spares: Mapping[str, str] = field(default_factory=dict)
    """Spare drones, each with the drone whose place it has."""
    packs: Mapping[str, str] = field(default_factory=dict)
    """The fitted pack of each drone."""
    handover: Handover | None = None
    launch_requests: Sequence[str] = ()
    """Assignments that wait for a confirmed launch."""


def read_display_rows(store: Store, day: DayStore, now_us: int) -> DisplayRows:
    """Read the displayed rows."""
    assignments, plan, shown = store.assignments(in_force=True), day.active_plan(), None
    if plan is not None:  # else the store has no day with a truck
        visits = day.truck_stop_visits()
        shown = DayShown(plan, day.sorties(), day.day_start_us(), now_us, visits)
    idle = store.database.about_value(IDLE_KEY, dict[str, str]) if plan is None else None
    requests = store.database.about_value(CONFIRM_KEY, list[str]) if plan is None else None
    holds = store.holds_in_force()
    late = store.database.about_value(LATE_KEY, dict[str, str]) or {}
    spares, packs = read_spares(store.database), pack_by_vehicle(store.database)
    return DisplayRows(
        assignments,
        store.orders(),
        shown,
        holds,
        idle or {},
        late,
        spares,
        packs,
        read_handover(store.database),
        requests or [],
    )
