"""What the desk does next in a day with a truck: `decide(view) -> deeds`, nothing else.

The promise is the store's (`SortieRow.binds`); here is when each thing is due: drones out to their
pads, launches, recoveries, serving, homes that move, the truck's next stop.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from companion.core.base.geo import offset_m
from companion.core.base.place import Place
from ground_station.core.dispatch.day_view import DayRunParams, DayView
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop
from ground_station.core.schema.orders import AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow

ON_PAD_M = 30.0
"""A drone within this of its pad stands on it: twice what a plain GNSS receiver errs."""

NEAR_PAD_M = 50.0

MayLaunch = Callable[[PlannedSortie, Sequence[PlannedSortie]], str | None]
"""Why a flight must wait for those in the air; None: it may go."""

Charged = Callable[[PlannedSortie, float], bool]
"""Whether a pack so full brings this flight home."""


@dataclass(frozen=True, slots=True)
class PutDroneOut:
    """Assign this flight, and tell the driver to put its drone on the pad."""

    sortie: PlannedSortie


@dataclass(frozen=True, slots=True)
class SendMission:
    """Its drone stands on its pad: send it its mission."""

    assignment: str


@dataclass(frozen=True, slots=True)
class LaunchFlight:
    """Authorise it."""

    assignment: str


@dataclass(frozen=True, slots=True)
class TakeBack:
    """Withdraw it, and why."""

    assignment: str
    why: str


@dataclass(frozen=True, slots=True)
class RecoverDrone:
    """Tell the driver to take it aboard from this pad."""

    assignment: str
    pad: Place


@dataclass(frozen=True, slots=True)
class AskHome:
    """Ask it to end at another stop."""

    assignment: str
    stop: str
    why: str


@dataclass(frozen=True, slots=True)
class HomeIs:
    """It has said that it ends there: the old promise is void."""

    assignment: str
    stop: str


@dataclass(frozen=True, slots=True)
class Lapse:
    """Not heard for longer than it can fly: nothing waits for it any more."""

    assignment: str


@dataclass(frozen=True, slots=True)
class Away:
    """It is down where the truck does not come: people fetch it."""

    assignment: str


@dataclass(frozen=True, slots=True)
class ServeHere:
    """Give this order to the driver."""

    order: str


@dataclass(frozen=True, slots=True)
class DriveOn:
    """From here to the next stop."""

    here: str
    stop: PlannedStop


DayDeed = (
    PutDroneOut
    | SendMission
    | LaunchFlight
    | TakeBack
    | RecoverDrone
    | AskHome
    | HomeIs
    | Lapse
    | Away
    | ServeHere
    | DriveOn
)


@dataclass(frozen=True, slots=True)
class DayRun:
    """The rules of a day, over what the day's data decides (who may fly beside whom, and how full
    a pack must be).
    """

    params: DayRunParams
    may_launch: MayLaunch
    charged: Charged

    def decide(self, view: DayView) -> list[DayDeed]:
        """Everything that is due now."""
        deeds: list[DayDeed] = []
        for row in view.sorties:
            if not (row.aboard or row.gone):
                deeds += self._mind(row, view)
        deeds += self._launches(view)
        if view.here is not None and not view.replanning:
            deeds += self._work(view, view.here)
        if not deeds:
            deeds += self._drive(view)
        return deeds

    # --- one flight ----------------------------------------------------------------------------

    def _mind(self, row: SortieRow, view: DayView) -> list[DayDeed]:
        drone = view.drone(row.vehicle)
        if row.over:
            return self._recover(row, view)
        if row.asked and drone.assignment == row.id and drone.home == row.asked:
            return [HomeIs(row.id, row.asked)]
        waited_s = view.waited_s.get(row.id, 0.0)
        match row.row.state:
            case AssignmentState.ORDERED | AssignmentState.ABOARD if self._stands(waited_s):
                return [TakeBack(row.id, f"not ready {waited_s:.0f} s after it was put out")]
            case AssignmentState.ORDERED if row.placed:
                return self._send(row, view)
            case AssignmentState.WITHDRAWING if row.placed and self._silent(row, view):
                return self._recover(row, view)
            case AssignmentState.FLYING:
                return self._in_flight(row, view)
            case _:
                return []

    def _stands(self, waited_s: float) -> bool:
        return waited_s > self.params.ready_s

    def _silent(self, row: SortieRow, view: DayView) -> bool:
        silent_s = view.drone(row.vehicle).silent_s
        return silent_s is None or silent_s > self.params.silent_s

    def _send(self, row: SortieRow, view: DayView) -> list[DayDeed]:
        """Its mission, once it stands charged on its pad."""
        drone = view.drone(row.vehicle)
        if drone.doubtful:
            return [TakeBack(row.id, f"{row.vehicle} is doubtful")]
        if not (drone.present and drone.idle):
            return []
        away_m = distance_m(drone.lat_deg, drone.lon_deg, row.pads[row.sortie.launch])
        if away_m is None or away_m > ON_PAD_M:
            return []
        if drone.charge_frac is not None and not self.charged(row.sortie, drone.charge_frac):
            return [TakeBack(row.id, f"a pack at {drone.charge_frac:.0%} does not bring it home")]
        return [SendMission(row.id)]

    def _in_flight(self, row: SortieRow, view: DayView) -> list[DayDeed]:
        launched_s = view.now_s if row.launched_us is None else view.day_s(row.launched_us)
        # The launch's stamp may be of a desk before this one, by a clock that was off.
        listened_s = view.now_s - max(launched_s, view.desk_from_s)
        if listened_s > self.params.lapse_s and self._silent(row, view):
            return [Lapse(row.id)]
        return self._move_home(row, view)

    def _move_home(self, row: SortieRow, view: DayView) -> list[DayDeed]:
        """To where the truck stands, when it would come too late to where it was promised: it is
        late already, or others that are longer in the air are to land here first.
        """
        here = view.here
        if here is None or row.asked or here.id == row.promised or here.id not in row.pads:
            return []
        expected = {stop.id: stop.arrive_s for stop in view.plan.stops}
        lands_s = view.lands_s(row)
        delay_s = max(0.0, view.delay_s(), view.held_s())
        comes_s = expected.get(row.promised, view.now_s) + delay_s
        if comes_s <= lands_s + self.params.move_home_s or view.now_s >= lands_s:
            return []
        moved = msgspec.structs.replace(row.sortie, home=here.id)
        others = _in_air([other for other in view.sorties if other != row])
        if self.may_launch(moved, others) is not None:
            return []
        return [AskHome(row.id, here.id, f"the truck comes {comes_s - lands_s:.0f} s too late")]

    def _recover(self, row: SortieRow, view: DayView) -> list[DayDeed]:
        where = landed_at(row, view)
        if where is None:
            return [Away(row.id)]
        here = view.here
        if here is None or here.id != where or row.recovering:
            return []
        return [RecoverDrone(row.id, row.pads[where])]

    # --- launches ------------------------------------------------------------------------------

    def _launches(self, view: DayView) -> list[DayDeed]:
        here = view.here
        if here is None:
            return []
        in_air = _in_air(view.sorties)
        deeds: list[DayDeed] = []
        for row in sorted(view.sorties, key=lambda r: r.sortie.launch_s):
            if row.row.state is not AssignmentState.ABOARD or row.launching or not row.placed:
                continue
            if row.refused >= self.params.launches:
                deeds.append(TakeBack(row.id, f"launch refused {row.refused} times"))
            elif self._may_go(row, view, here) and self.may_launch(row.sortie, in_air) is None:
                in_air.append(row.sortie)
                deeds.append(LaunchFlight(row.id))
        return deeds

    def _may_go(self, row: SortieRow, view: DayView, here: PlannedStop) -> bool:
        drone = view.drone(row.vehicle)
        ready = drone.present and drone.ready and drone.assignment == row.id
        if not ready or drone.doubtful or row.sortie.launch != here.id:
            return False
        if row.sortie.home == here.id:
            return True
        delay_s = max(view.delay_s(), view.held_s())
        return view.now_s >= row.sortie.launch_s + delay_s  # nobody lands before the truck

    # --- the truck -----------------------------------------------------------------------------

    def _work(self, view: DayView, here: PlannedStop) -> list[DayDeed]:
        """What the plan has for this stop and is not begun."""
        deeds: list[DayDeed] = [ServeHere(order) for order in here.serves if order in view.open]
        busy: set[str] = set()
        for sortie in view.pending():
            first = sortie.vehicle not in busy
            busy.add(sortie.vehicle)
            if first and sortie.launch == here.id and view.free(sortie.vehicle):
                deeds.append(PutDroneOut(sortie))
        return deeds

    def holds(self, view: DayView) -> list[str]:
        """Why the truck does not leave where it stands, in words."""
        here = view.here
        if here is None:
            return []
        words = [why for row in view.sorties if (why := row.binds(here.id))]
        words += [
            f"{row.vehicle} ({row.id}) has not taken off"
            for row in view.sorties
            if row.sortie.launch == here.id and self._on_its_pad(row, view)
        ]
        if view.serving():
            words.append("the driver is bringing an order")
        words += [f"{o} is to be brought" for o in here.serves if o in view.open]
        words += [
            f"{s.vehicle} is to be launched with {s.order}"
            for s in view.pending()
            if s.launch == here.id and view.free(s.vehicle)
        ]
        return [*words, "a new plan is being made"] if view.replanning else words

    def _on_its_pad(self, row: SortieRow, view: DayView) -> bool:
        if row.over or row.gone or row.row.state is not AssignmentState.FLYING:
            return False
        drone = view.drone(row.vehicle)
        if drone.present and drone.assignment == row.id:
            return not drone.off_ground
        launched_s = view.now_s if row.launched_us is None else view.day_s(row.launched_us)
        return view.now_s - launched_s < self.params.take_off_s

    def _drive(self, view: DayView) -> list[DayDeed]:
        here, index = view.here, view.index
        if here is None or index is None or self.holds(view):
            return []
        if index + 1 >= len(view.plan.stops):
            return []
        return [DriveOn(here.id, view.plan.stops[index + 1])]


def landed_at(row: SortieRow, view: DayView) -> str | None:
    """At which stop's pad a drone is down; None: at none of them.

    Not heard, it is where it was promised: the driver looks.
    """
    if row.launched_us is None:
        return row.sortie.launch
    drone = view.drone(row.vehicle)
    stops = dict.fromkeys(s for s in (row.promised, row.asked, row.sortie.launch) if s)
    if not drone.present or drone.lat_deg is None:
        return row.promised
    away = [(distance_m(drone.lat_deg, drone.lon_deg, row.pads[s]), s) for s in stops]
    near = [(m, s) for m, s in away if m is not None and m <= NEAR_PAD_M]
    return min(near)[1] if near else None


def _in_air(rows: Sequence[SortieRow]) -> list[PlannedSortie]:
    """Flights in the air, each with the home promised now, and once more with one asked for."""
    homes = [(row, home) for row in rows if row.in_air for home in (row.promised, row.asked)]
    return [msgspec.structs.replace(row.sortie, home=home) for row, home in homes if home]


def distance_m(lat_deg: float | None, lon_deg: float | None, place: Place) -> float | None:
    """Over the ground, small distances; None where something is unknown."""
    if lat_deg is None or lon_deg is None or place.lat_deg is None or place.lon_deg is None:
        return None
    return math.hypot(*offset_m(place.lat_deg, place.lon_deg, lat_deg, lon_deg))
