"""The rules of a day with a truck: `decide(snapshot) -> actions`, and nothing else.

What is promised is the store's (`SortieRow.binds`). Here is when each thing is due: drones out to
their pads, launches, recoveries, orders for the driver, changes of home, the truck's next stop.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from companion.core.base.geo import offset_m
from companion.core.base.place import Place
from ground_station.core.dispatch.day_snapshot import CLOSED, DaySnapshot
from ground_station.core.dispatch.dispatch_actions import (
    AuthoriseLaunch,
    ConfirmHomeChange,
    DeclareOffSite,
    DeclareOverdue,
    DispatchAction,
    DriveToStop,
    ForgetHomeChange,
    PutDroneOut,
    RecoverDrone,
    RequestHomeChange,
    SendMission,
    ServeOrder,
    WithdrawAssignment,
)
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop
from ground_station.core.schema.orders import AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow

ON_PAD_M = 30.0
"""A drone within this distance of its pad stands on it: twice the error of a plain GNSS
receiver."""

NEAR_PAD_M = 50.0

ONE_PLACE_M = 15.0
"""No receiver tells apart two pads that are so near one another."""

LaunchConflict = Callable[[PlannedSortie, Sequence[PlannedSortie]], str | None]
"""Why a sortie must wait for those in the air; None: it may go."""

Charged = Callable[[PlannedSortie, float], bool]
"""Whether a pack with this charge is enough for this sortie."""


@dataclass(frozen=True, slots=True)
class DispatchParams:
    """When the desk departs from the plan.

    `late_s`: the truck is later than planned by this. `silent_s`: a drone counts as silent.
    `take_off_s`: a launched drone has left the ground by then. `lapse_s`: after its launch no drone
    can still be in the air (its time limit, and some more). `move_home_s`: a flight's home is moved
    when the truck would come later than its landing by this, and asked again no sooner than
    `ask_home_s` after it refused: it may refuse for what passes, or because it lands. `ready_s`: a
    drone on its pad is ready by then, or withdrawn. `launches`: so many refused launches, and it is
    withdrawn. `wind_sigmas`: the measured wind is off by so many standard deviations.
    `replan_tries`: how often a planner whose process ends without an answer is asked for one
    reason, each time `replan_again_s` after the last. `forecast_again_s`: for a forecast that
    closes sorties no sooner after the last plan than this.
    """

    late_s: float = 120.0
    silent_s: float = 60.0
    take_off_s: float = 60.0
    lapse_s: float = 2100.0
    move_home_s: float = 60.0
    ask_home_s: float = 30.0
    replan_again_s: float = 60.0
    replan_tries: int = 3
    launches: int = 3
    ready_s: float = 300.0
    wind_sigmas: float = 2.0
    forecast_again_s: float = 600.0


@dataclass(frozen=True, slots=True)
class DispatchRules:
    """The rules, and what only the day's data can tell: who may fly beside whom, and how full a
    pack must be.
    """

    params: DispatchParams
    launch_conflict: LaunchConflict
    charged: Charged

    def decide(self, day: DaySnapshot) -> list[DispatchAction]:
        """Everything that is due now. The truck drives only when nothing else is."""
        actions: list[DispatchAction] = []
        for row in day.sorties:
            if not (row.aboard or row.gone):
                actions += self._for_sortie(row, day)
        actions += self._launches(day)
        if day.here is not None and not day.replanning:
            actions += self._work_at_stop(day, day.here)
        if not actions:
            actions += self._drive(day)
        return actions

    # --- one sortie ----------------------------------------------------------------------------

    def _for_sortie(self, row: SortieRow, day: DaySnapshot) -> list[DispatchAction]:
        drone = day.drone(row.vehicle)
        if row.over:
            return self._recover(row, day)
        if row.asked and drone.assignment == row.id and drone.home == row.asked:
            return [ConfirmHomeChange(row.id, row.asked)]
        waited_s = day.waited_s.get(row.id, 0.0)
        match row.row.state:
            case AssignmentState.ABOARD if row.launching and self._unheard(row, day):
                return [DeclareOverdue(row.id)]
            case AssignmentState.ORDERED | AssignmentState.ABOARD if row.id in day.closed:
                return [WithdrawAssignment(row.id, f"{CLOSED}: {day.closed[row.id]}")]
            case AssignmentState.ORDERED | AssignmentState.ABOARD if waited_s > self.params.ready_s:
                why = f"not ready {waited_s:.0f} s after it was put out"
                return [WithdrawAssignment(row.id, why)]
            case AssignmentState.ORDERED if row.placed:
                return self._send_mission(row, day)
            case AssignmentState.WITHDRAWING if row.placed and self._silent(row, day):
                return self._recover(row, day)
            case AssignmentState.FLYING:
                return self._in_flight(row, day)
            case _:
                return []

    def _silent(self, row: SortieRow, day: DaySnapshot) -> bool:
        silent_s = day.drone(row.vehicle).silent_s
        return silent_s is None or silent_s > self.params.silent_s

    def _unheard(self, row: SortieRow, day: DaySnapshot) -> bool:
        """Not heard since its launch was ordered, for longer than it can fly."""
        silent_s = day.drone(row.vehicle).silent_s
        listened_s = day.now_s - day.desk_from_s
        return (listened_s if silent_s is None else silent_s) > self.params.lapse_s

    def _send_mission(self, row: SortieRow, day: DaySnapshot) -> list[DispatchAction]:
        """Once the drone stands charged on its pad."""
        drone = day.drone(row.vehicle)
        if drone.doubtful:
            return [WithdrawAssignment(row.id, f"{row.vehicle} is doubtful")]
        if not (drone.present and drone.idle):
            return []
        away_m = distance_m(drone.lat_deg, drone.lon_deg, row.pads[row.sortie.launch])
        if away_m is None or away_m > ON_PAD_M:
            return []
        if drone.charge_frac is not None and not self.charged(row.sortie, drone.charge_frac):
            why = f"a pack at {drone.charge_frac:.0%} is not enough for it"
            return [WithdrawAssignment(row.id, why)]
        return [SendMission(row.id)]

    def _in_flight(self, row: SortieRow, day: DaySnapshot) -> list[DispatchAction]:
        launched_s = day.now_s if row.launched_us is None else day.day_s(row.launched_us)
        # The launch's time stamp may be of an earlier desk, whose clock was wrong.
        listened_s = day.now_s - max(launched_s, day.desk_from_s)
        if listened_s > self.params.lapse_s and self._silent(row, day):
            return [DeclareOverdue(row.id)]
        return self._change_home(row, day)

    def _change_home(self, row: SortieRow, day: DaySnapshot) -> list[DispatchAction]:
        """To where the truck stands, when it would come too late to the promised stop: it is late
        already, or drones that land later are still to land here. Not one that is not heard: until
        it answered, the truck would wait here for one that comes down where it was promised.
        """
        here = day.here
        if here is None or row.asked or here.id == row.promised or here.id not in row.pads:
            return []
        if not day.drone(row.vehicle).present:
            return []
        refused_us = row.home_refused_us
        if refused_us is not None and day.now_s - day.day_s(refused_us) < self.params.ask_home_s:
            return []
        expected = {stop.id: stop.arrive_s for stop in day.plan.stops}
        lands_s = day.lands_s(row)
        delay_s = max(0.0, day.delay_s(), day.held_s())
        comes_s = expected.get(row.promised, day.now_s) + delay_s
        if comes_s <= lands_s + self.params.move_home_s or day.now_s >= lands_s:
            return []
        moved = msgspec.structs.replace(row.sortie, home=here.id)
        others = _in_air([other for other in day.sorties if other != row])
        if self.launch_conflict(moved, others) is not None:
            return []
        why = f"the truck comes {comes_s - lands_s:.0f} s too late"
        return [RequestHomeChange(row.id, here.id, why)]

    def _recover(self, row: SortieRow, day: DaySnapshot) -> list[DispatchAction]:
        drone = day.drone(row.vehicle)
        if drone.present and drone.assignment == row.id:
            return []  # its last state is of before the landing: it was still in the air there
        where = landed_at(row, day)
        if where is None:
            return [DeclareOffSite(row.id)]
        if row.asked:  # its answer is not waited for any more: where it is tells what it was
            done = ConfirmHomeChange if where == row.asked else ForgetHomeChange
            return [done(row.id, row.asked)]
        here = day.here
        if here is None or here.id != where or row.recovering:
            return []
        return [RecoverDrone(row.id, row.pads[where])]

    # --- launches ------------------------------------------------------------------------------

    def _launches(self, day: DaySnapshot) -> list[DispatchAction]:
        here = day.here
        if here is None:
            return []
        in_air = _in_air(day.sorties)
        actions: list[DispatchAction] = []
        for row in sorted(day.sorties, key=lambda r: r.sortie.launch_s):
            if row.row.state is not AssignmentState.ABOARD or row.launching or not row.placed:
                continue
            if row.gone:  # the truck may have left
                continue
            if row.refused >= self.params.launches:
                actions.append(WithdrawAssignment(row.id, f"launch refused {row.refused} times"))
            elif self._launch_is_due(row, day, here) and not self.launch_conflict(
                row.sortie, in_air
            ):
                in_air.append(row.sortie)
                actions.append(AuthoriseLaunch(row.id))
        return actions

    def _launch_is_due(self, row: SortieRow, day: DaySnapshot, here: PlannedStop) -> bool:
        drone = day.drone(row.vehicle)
        ready = drone.present and drone.ready and drone.assignment == row.id
        if not ready or drone.doubtful or row.sortie.launch != here.id or row.vehicle in day.held:
            return False
        if row.sortie.home == here.id:
            return True
        delay_s = max(day.delay_s(), day.held_s())
        return day.now_s >= row.sortie.launch_s + delay_s  # no drone lands before the truck

    # --- the truck -----------------------------------------------------------------------------

    def _work_at_stop(self, day: DaySnapshot, here: PlannedStop) -> list[DispatchAction]:
        """What the plan has for this stop and is not begun."""
        actions: list[DispatchAction] = [
            ServeOrder(order) for order in here.serves if order in day.open
        ]
        busy: set[str] = set()
        for sortie in day.pending():
            first = sortie.vehicle not in busy
            busy.add(sortie.vehicle)
            may_go = sortie.vehicle not in day.held and day.free(sortie.vehicle)
            if first and sortie.launch == here.id and may_go:
                actions.append(PutDroneOut(sortie))
        return actions

    def holds(self, day: DaySnapshot) -> list[str]:
        """Why the truck does not leave where it stands, in words."""
        here = day.here
        if here is None:
            return []
        words = [why for row in day.sorties if (why := row.binds(here.id))]
        words += [
            f"{row.vehicle} ({row.id}) has not taken off"
            for row in day.sorties
            if row.sortie.launch == here.id and self._on_its_pad(row, day)
        ]
        if day.serving():
            words.append("the driver is bringing an order")
        words += [f"{o} is to be brought" for o in here.serves if o in day.open]
        words += [
            f"{s.vehicle} is to be launched with {s.order}{' (held)' * (s.vehicle in day.held)}"
            for s in day.pending()
            if s.launch == here.id and day.free(s.vehicle)
        ]
        return [*words, "a new plan is being made"] if day.replanning else words

    def _on_its_pad(self, row: SortieRow, day: DaySnapshot) -> bool:
        if row.over or row.gone or row.row.state is not AssignmentState.FLYING:
            return False
        drone = day.drone(row.vehicle)
        if drone.present and drone.assignment == row.id:
            return not drone.off_ground
        launched_s = day.now_s if row.launched_us is None else day.day_s(row.launched_us)
        return day.now_s - launched_s < self.params.take_off_s

    def _drive(self, day: DaySnapshot) -> list[DispatchAction]:
        here, index = day.here, day.index
        if here is None or index is None or self.holds(day):
            return []
        if index + 1 >= len(day.plan.stops):
            return []
        return [DriveToStop(here.id, day.plan.stops[index + 1])]


def landed_at(row: SortieRow, day: DaySnapshot) -> str | None:
    """The stop on whose pad a drone is down; None: it is on none.

    A drone that is not heard counts as landed where it was promised: the driver looks there. Where
    stops have pads at one place, it is the stop where the truck stands, else the promised one.
    """
    if row.launched_us is None:
        return row.sortie.launch
    drone = day.drone(row.vehicle)
    stops = dict.fromkeys(s for s in (row.promised, row.asked, row.sortie.launch) if s)
    if not drone.present or drone.lat_deg is None:
        return row.promised
    away = [(distance_m(drone.lat_deg, drone.lon_deg, row.pads[s]), s) for s in stops]
    near = [(m, s) for m, s in away if m is not None and m <= NEAR_PAD_M]
    if not near:
        return None
    nearest = row.pads[min(near)[1]]
    apart = {s: distance_m(nearest.lat_deg, nearest.lon_deg, row.pads[s]) for _, s in near}
    same = [s for s, m in apart.items() if m is not None and m <= ONE_PLACE_M]
    here = None if day.here is None else day.here.id
    return next(s for s in (here, row.promised, *same) if s in same)


def _in_air(rows: Sequence[SortieRow]) -> list[PlannedSortie]:
    """Sorties in the air, each with its promised home, and again with a home it was asked for."""
    homes = [(row, home) for row in rows if row.in_air for home in (row.promised, row.asked)]
    return [msgspec.structs.replace(row.sortie, home=home) for row, home in homes if home]


def distance_m(lat_deg: float | None, lon_deg: float | None, place: Place) -> float | None:
    """Over the ground, for short distances; None where a place is unknown."""
    if lat_deg is None or lon_deg is None or place.lat_deg is None or place.lon_deg is None:
        return None
    return math.hypot(*offset_m(place.lat_deg, place.lon_deg, lat_deg, lon_deg))
