"""Sorties from a truck and stops of the truck, as stored: the obligations that bind the truck."""

from dataclasses import dataclass

from companion.core.base.location import Location
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, AssignmentState


@dataclass(frozen=True, slots=True)
class SortieRow:
    """One sortie. `pads`: possible landing pads by stop, including its launch pad.

    `promised_stop`: the stop where it ends (safety rule 3). `requested_stop`: a requested new stop
    that it has not confirmed; both bind the truck. `put_on_pad`: the driver has put it on its
    launch pad. `recovered`: the driver has collected it. `is_off_site`: it has landed where the
    truck does not come. `is_overdue`: it is overdue, silent for longer than it can fly.
    `launch_pending`: a launch command waits for its response. `refused_launches`: number of refused
    launches. `recovery_ordered`: its recovery was ordered. `home_refused_us`: time of the last
    refusal to end at another stop.
    """

    assignment: AssignmentRow
    sortie: PlannedSortie
    pads: dict[str, Location]
    promised_stop: str
    requested_stop: str | None = None
    put_on_pad: bool = False
    recovered: bool = False
    is_off_site: bool = False
    is_overdue: bool = False
    launched_us: int | None = None
    landed_us: int | None = None
    used_wh: float | None = None
    launch_pending: bool = False
    refused_launches: int = 0
    recovery_ordered: bool = False
    home_refused_us: int | None = None

    @property
    def id(self) -> str:
        """Id of its assignment."""
        return self.assignment.id

    @property
    def vehicle(self) -> str:
        """The drone."""
        return self.assignment.vehicle

    @property
    def is_finished(self) -> bool:
        """True if its outcome is known, or it never flew."""
        return self.assignment.state not in IN_FORCE

    @property
    def may_be_airborne(self) -> bool:
        """True if it may be in the air."""
        is_launched = self.launch_pending or self.assignment.state is AssignmentState.IN_FLIGHT
        return not self.is_finished and is_launched and not self.is_overdue

    @property
    def is_drone_on_truck(self) -> bool:
        """True if its drone is on the truck: recovered, or never unloaded."""
        return self.is_finished and (self.recovered or not self.put_on_pad)

    @property
    def is_drone_lost_off_site_or_overdue(self) -> bool:
        """True if its drone is unavailable for the rest of the day."""
        return bool(self.unavailability_reason)

    @property
    def unavailability_reason(self) -> str:
        """Reason that its drone is unavailable for the rest of the day; empty: it is available."""
        if self.is_off_site:
            return "off site" if self.put_on_pad else "not put out by the driver"
        lost = self.assignment.state is AssignmentState.LOST
        return "lost" if lost else "overdue" if self.is_overdue else ""

    def binding_reason(self, stop: str) -> str | None:
        """Return the obligation that keeps the truck at this stop; None: no obligation."""
        if self.is_drone_lost_off_site_or_overdue or self.is_drone_on_truck:
            return None
        sortie_label = f"{self.vehicle} ({self.id})"
        if stop in (self.promised_stop, self.requested_stop):
            return f"{sortie_label} is promised this stop"
        is_at_launch_stop = (
            self.launched_us is None or self.recovery_ordered
        )  # else at its landing position
        if self.sortie.launch == stop and self.is_finished and is_at_launch_stop:
            return f"{sortie_label} is not recovered yet"
        is_launched = self.assignment.state is AssignmentState.IN_FLIGHT
        if self.sortie.launch == stop and not (self.is_finished or is_launched):
            return f"{sortie_label} is not launched yet"
        return None


@dataclass(frozen=True, slots=True)
class StopTimes:
    """Arrival and departure of the truck at a stop, by the desk's clock."""

    stop: str
    arrived_us: int
    departed_us: int | None
