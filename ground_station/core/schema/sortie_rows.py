"""Sorties from a truck and visits of the truck, as the store keeps them: what binds the truck."""

from dataclasses import dataclass

from companion.core.base.place import Place
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, AssignmentState


@dataclass(frozen=True, slots=True)
class SortieRow:
    """One sortie. `pads`: where it could land, by stop, its launch pad among them.

    `promised`: the stop where it ends (safety rule 3). `asked`: a stop that it was asked to move
    to and has not confirmed; both bind the truck. `placed`: the driver has put it on its launch
    pad. `recovered`: the driver has taken it aboard again. `away`: it is down where the truck
    does not come. `lapsed`: it is overdue, not heard for longer than it can fly. `launching`: a
    launch command waits for its answer. `refused`: launches that it refused. `recovering`: its
    recovery was ordered. `home_refused_us`: when it last refused to end at another stop.
    """

    row: AssignmentRow
    sortie: PlannedSortie
    pads: dict[str, Place]
    promised: str
    asked: str | None = None
    placed: bool = False
    recovered: bool = False
    away: bool = False
    lapsed: bool = False
    launched_us: int | None = None
    landed_us: int | None = None
    used_wh: float | None = None
    launching: bool = False
    refused: int = 0
    recovering: bool = False
    home_refused_us: int | None = None

    @property
    def id(self) -> str:
        """The id of its assignment."""
        return self.row.id

    @property
    def vehicle(self) -> str:
        """The drone."""
        return self.row.vehicle

    @property
    def over(self) -> bool:
        """Its outcome is known, or it never flew."""
        return self.row.state not in IN_FORCE

    @property
    def in_air(self) -> bool:
        """It may be in the air, for all that is known."""
        flying = self.launching or self.row.state is AssignmentState.FLYING
        return not self.over and flying and not self.lapsed

    @property
    def aboard(self) -> bool:
        """Its drone is on the truck again, or never left it."""
        return self.over and (self.recovered or not self.placed)

    @property
    def gone(self) -> bool:
        """Its drone cannot be used again today."""
        lost = self.row.state is AssignmentState.LOST
        return lost or self.away or self.lapsed

    def binds(self, stop: str) -> str | None:
        """Why it keeps the truck at this stop; None: it does not."""
        if self.gone or self.aboard:
            return None
        here = f"{self.vehicle} ({self.id})"
        if stop in (self.promised, self.asked):
            return f"{here} is promised this stop"
        stands_here = self.launched_us is None or self.recovering  # else it is where it landed
        if self.sortie.launch == stop and self.over and stands_here:
            return f"{here} is not aboard again"
        flying = self.row.state is AssignmentState.FLYING
        if self.sortie.launch == stop and not (self.over or flying):
            return f"{here} is not launched"
        return None


@dataclass(frozen=True, slots=True)
class Visit:
    """A visit of the truck to a stop, by the desk's clock."""

    stop: str
    arrived_us: int
    left_us: int | None
