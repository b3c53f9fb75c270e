"""What the store says of the day, read at one moment, for those who watch it."""

from collections.abc import Sequence
from dataclasses import dataclass

from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.holds import Hold
from ground_station.core.schema.orders import AssignmentRow, OrderRow
from ground_station.core.schema.sortie_rows import SortieRow, Visit

NEXT = 5


@dataclass(frozen=True, slots=True)
class DayShown:
    """A day with a truck, for people: the active plan, its sorties, the day's time, the visits."""

    plan: DayPlan
    sorties: list[SortieRow]
    began_us: int | None
    now_us: int
    visits: Sequence[Visit] = ()

    def following(self, open_orders: set[str]) -> list[PlannedSortie]:
        """The next sorties."""
        begun = [row.sortie for row in self.sorties]
        left = [s for s in self.plan.sorties if s.order in open_orders and s not in begun]
        return sorted(left, key=lambda s: s.launch_s)[:NEXT]

    @property
    def title(self) -> str:
        """The plan's number and the day's time."""
        if self.began_us is None:
            return f"plan {self.plan.revision}, not begun"
        now_s = (self.now_us - self.began_us) / 1e6
        planned = minutes(self.plan.makespan_s)
        return f"plan {self.plan.revision}, {minutes(now_s)} of {planned}"

    def sortie(self, vehicle: str) -> SortieRow | None:
        """The sortie of a drone that is put out, in the air, or back and not aboard."""
        mine = (row for row in self.sorties if row.vehicle == vehicle)
        return next((row for row in mine if not (row.aboard or row.gone)), None)

    def binding(self, stop: str) -> list[str]:
        """Which sorties keep the truck at a stop."""
        return [why for row in self.sorties if (why := row.binds(stop)) is not None]


def day_shown(day: DayStore, now_us: int) -> DayShown | None:
    """The day with a truck that the store holds; None: there is none."""
    plan = day.plan()
    if plan is None:
        return None
    return DayShown(plan, day.sorties(), day.began_us(), now_us, day.visits())


@dataclass(frozen=True, slots=True)
class WatchRows:
    """What the store says of the day, read at one moment."""

    assignments: Sequence[AssignmentRow] = ()
    orders: Sequence[OrderRow] = ()
    day: DayShown | None = None
    holds: Sequence[Hold] = ()


def read_rows(store: Store, day: DayStore, now_us: int) -> WatchRows:
    """The rows that are shown."""
    assignments = store.assignments(in_force=True)
    return WatchRows(assignments, store.orders(), day_shown(day, now_us), store.holds())


def minutes(seconds: float) -> str:
    """As 12:05."""
    whole, rest = divmod(max(0, round(seconds)), 60)
    return f"{whole}:{rest:02d}"
