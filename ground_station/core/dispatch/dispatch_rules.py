"""The rules of a day with a truck: `due_actions(snapshot) -> actions`.

The store defines the promises (`SortieRow.binding_reason`). The rules define when each action is
due: drones to their pads, launches, recoveries, orders for the driver, changes of home, the truck's
next stop.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from companion.core.base.geo import ne_offset_m
from companion.core.base.location import Location
from ground_station.core.dispatch.day_snapshot import CLOSED_PREFIX, DaySnapshot
from ground_station.core.dispatch.dispatch_actions import (
    AuthoriseLaunch,
    CancelHomeChange,
    ConfirmHomeChange,
    DeclareOffSite,
    DeclareOverdue,
    DeployDrone,
    DispatchAction,
    DriveToStop,
    RecoverDrone,
    RequestHomeChange,
    SendMission,
    ServeOrder,
    WithdrawAssignment,
)
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop
from ground_station.core.schema.orders import IN_FORCE, AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow

ON_PAD_M = 30.0
"""A drone this close to its pad counts as on it: twice the error of a plain GNSS receiver."""

NEAR_PAD_M = 50.0

SAME_SITE_M = 15.0
"""Pads closer than this are one site: no receiver can distinguish them."""

LaunchConflict = Callable[[PlannedSortie, Sequence[PlannedSortie]], str | None]
"""The conflict for which a sortie must wait for those in the air; None: it may launch."""

ChargeCheck = Callable[[PlannedSortie, float], bool]
"""Whether a pack with this charge suffices for this sortie."""


@dataclass(frozen=True, slots=True)
class DispatchParams:
    """Thresholds at which the desk departs from the plan.

    `truck_late_s`: delay of the truck that counts as late. `silent_after_s`: a drone counts as
    silent. `take_off_timeout_s`: time from launch to take-off. `overdue_after_s`: time after the
    launch when no drone can still be in the air (its time limit plus a margin).
    `home_change_delay_s`: a flight's home is moved if the truck would arrive later than its landing
    by this; `home_request_interval_s`: interval before the request is repeated after a refusal,
    whose cause may be temporary. `ready_timeout_s`: a drone on its pad that is not ready by then is
    withdrawn. `max_refused_launches`: refused launches until withdrawal. `wind_deviation_sigmas`:
    deviation of the measured wind in standard deviations. `max_replan_attempts`: attempts with a
    planner whose process ends without a result, per reason, `replan_interval_s` after one another.
    `forecast_replan_interval_s`: minimum interval between re-plans for a forecast that closes
    sorties.
    """

    truck_late_s: float = 120.0
    silent_after_s: float = 60.0
    take_off_timeout_s: float = 60.0
    overdue_after_s: float = 2100.0
    home_change_delay_s: float = 60.0
    home_request_interval_s: float = 30.0
    replan_interval_s: float = 60.0
    max_replan_attempts: int = 3
    max_refused_launches: int = 3
    ready_timeout_s: float = 300.0
    wind_deviation_sigmas: float = 2.0
    forecast_replan_interval_s: float = 600.0


@dataclass(frozen=True, slots=True)
class DispatchRules:
    """The rules, and checks that need the day's data: launch conflicts and sufficient charge."""

    params: DispatchParams
    launch_conflict: LaunchConflict
    has_sufficient_charge: ChargeCheck

    def due_actions(self, day: DaySnapshot) -> list[DispatchAction]:
        """Return all actions that are due. The truck drives only when no other action is due."""
        actions: list[DispatchAction] = []
        for row in day.sorties:
            if not (row.is_drone_on_truck or row.is_drone_lost_off_site_or_overdue):
                actions += self._due_actions_of_sortie(row, day)
        actions += self._launch_or_withdraw_actions(day)
        if day.current_stop is not None and not day.replanning:
            actions += self._driver_task_actions_at_stop(day, day.current_stop)
        if not actions:
            actions += self._drive_to_next_stop_actions(day)
        return actions

    # --- one sortie ----------------------------------------------------------------------------

    def _due_actions_of_sortie(self, row: SortieRow, day: DaySnapshot) -> list[DispatchAction]:
        drone = day.drone_status(row.vehicle)
        if row.is_finished:
            return self._recover_or_record_landing_actions(row, day)
        if row.requested_stop and drone.assignment == row.id and drone.home == row.requested_stop:
            return [ConfirmHomeChange(row.id, row.requested_stop)]
        waited_s = day.pad_wait_s.get(row.id, 0.0)
        match row.assignment.state:
            case AssignmentState.UPLOADED if (
                row.launch_pending and self._is_silent_longer_than_endurance(row, day)
            ):
                return [DeclareOverdue(row.id)]
            case AssignmentState.ORDERED | AssignmentState.UPLOADED if (
                row.id in day.closed_assignments
            ):
                return [
                    WithdrawAssignment(row.id, f"{CLOSED_PREFIX}: {day.closed_assignments[row.id]}")
                ]
            case AssignmentState.ORDERED | AssignmentState.UPLOADED if (
                waited_s > self.params.ready_timeout_s
            ):
                reason = f"not ready {waited_s:.0f} s after placement"
                return [WithdrawAssignment(row.id, reason)]
            case AssignmentState.ORDERED if row.put_on_pad:
                return self._send_mission_or_withdraw_actions(row, day)
            case AssignmentState.WITHDRAWING if row.put_on_pad and self._is_silent(row, day):
                return self._recover_or_record_landing_actions(row, day)
            case AssignmentState.IN_FLIGHT:
                return self._declare_overdue_or_change_home_actions(row, day)
            case _:
                return []

    def _is_silent(self, row: SortieRow, day: DaySnapshot) -> bool:
        silent_s = day.drone_status(row.vehicle).silent_s
        return silent_s is None or silent_s > self.params.silent_after_s

    def _is_silent_longer_than_endurance(self, row: SortieRow, day: DaySnapshot) -> bool:
        """Return True if the drone is silent for longer than it can fly."""
        silent_s = day.drone_status(row.vehicle).silent_s
        listened_s = day.now_s - day.desk_start_s
        return (listened_s if silent_s is None else silent_s) > self.params.overdue_after_s

    def _send_mission_or_withdraw_actions(
        self, row: SortieRow, day: DaySnapshot
    ) -> list[DispatchAction]:
        """Send the mission once the drone is on its pad with sufficient charge."""
        drone = day.drone_status(row.vehicle)
        if drone.doubtful:
            return [WithdrawAssignment(row.id, f"{row.vehicle} is doubtful")]
        if not (drone.present and drone.idle):
            return []
        if off_pad_text(drone.lat_deg, drone.lon_deg, row.pads[row.sortie.launch]):
            return []
        if drone.charge_frac is not None and not self.has_sufficient_charge(
            row.sortie, drone.charge_frac
        ):
            reason = f"pack charge of {drone.charge_frac:.0%} is insufficient"
            return [WithdrawAssignment(row.id, reason)]
        return [SendMission(row.id)]

    def _declare_overdue_or_change_home_actions(
        self, row: SortieRow, day: DaySnapshot
    ) -> list[DispatchAction]:
        launched_s = (
            day.now_s if row.launched_us is None else day.epoch_us_to_day_s(row.launched_us)
        )
        # The time stamp may come from an earlier run of the desk with a wrong clock.
        listened_s = day.now_s - max(launched_s, day.desk_start_s)
        if listened_s > self.params.overdue_after_s and self._is_silent(row, day):
            return [DeclareOverdue(row.id)]
        return self._move_home_to_current_stop_actions(row, day)

    def _move_home_to_current_stop_actions(
        self, row: SortieRow, day: DaySnapshot
    ) -> list[DispatchAction]:
        """Move the home to the truck's current stop if the truck would reach the promised stop too
        late: it is late, or later drones still land here. Not for a silent drone: the truck would
        wait here for its response while it lands at the promised stop.
        """
        here = day.current_stop
        if (
            here is None
            or row.requested_stop
            or here.id == row.promised_stop
            or here.id not in row.pads
        ):
            return []
        if not day.drone_status(row.vehicle).present:
            return []
        refused_us = row.home_refused_us
        if (
            refused_us is not None
            and day.now_s - day.epoch_us_to_day_s(refused_us) < self.params.home_request_interval_s
        ):
            return []
        expected = {stop.id: stop.arrive_s for stop in day.plan.stops}
        lands_s = day.expected_landing_s(row)
        delay_s = max(0.0, day.truck_delay_s(), day.departure_delay_for_landings_s())
        truck_arrival_s = expected.get(row.promised_stop, day.now_s) + delay_s
        if truck_arrival_s <= lands_s + self.params.home_change_delay_s or day.now_s >= lands_s:
            return []
        changed_sortie = msgspec.structs.replace(row.sortie, home=here.id)
        others = _airborne_sorties_per_possible_home(
            [other for other in day.sorties if other != row]
        )
        if self.launch_conflict(changed_sortie, others) is not None:
            return []
        reason = f"the truck would arrive {truck_arrival_s - lands_s:.0f} s too late"
        return [RequestHomeChange(row.id, here.id, reason)]

    def _recover_or_record_landing_actions(
        self, row: SortieRow, day: DaySnapshot
    ) -> list[DispatchAction]:
        drone = day.drone_status(row.vehicle)
        if drone.present and drone.assignment == row.id:
            return []  # its last state precedes the landing
        landing_stop_id = find_landing_stop_id(row, day)
        if landing_stop_id is None:
            return [DeclareOffSite(row.id)]
        if row.requested_stop:  # the landing stop shows whether it accepted; no response is awaited
            home_action = (
                ConfirmHomeChange if landing_stop_id == row.requested_stop else CancelHomeChange
            )
            return [home_action(row.id, row.requested_stop)]
        here = day.current_stop
        if here is None or here.id != landing_stop_id or row.recovery_ordered:
            return []
        return [RecoverDrone(row.id, row.pads[landing_stop_id])]

    # --- launches ------------------------------------------------------------------------------

    def _launch_or_withdraw_actions(self, day: DaySnapshot) -> list[DispatchAction]:
        here = day.current_stop
        if here is None:
            return []
        in_air = _airborne_sorties_per_possible_home(day.sorties)
        actions: list[DispatchAction] = []
        for row in sorted(day.sorties, key=lambda r: r.sortie.launch_s):
            if (
                row.assignment.state is not AssignmentState.UPLOADED
                or row.launch_pending
                or not row.put_on_pad
            ):
                continue
            if row.is_drone_lost_off_site_or_overdue:  # the truck may have left
                continue
            if row.refused_launches >= self.params.max_refused_launches:
                actions.append(
                    WithdrawAssignment(row.id, f"launch refused {row.refused_launches} times")
                )
            elif self._is_launch_due(row, day, here) and not self.launch_conflict(
                row.sortie, in_air
            ):
                in_air.append(row.sortie)
                actions.append(AuthoriseLaunch(row.id))
        return actions

    def _is_launch_due(self, row: SortieRow, day: DaySnapshot, current_stop: PlannedStop) -> bool:
        drone = day.drone_status(row.vehicle)
        ready = drone.present and drone.ready and drone.assignment == row.id
        if (
            not ready
            or drone.doubtful
            or row.sortie.launch != current_stop.id
            or day.must_wait(row)
        ):
            return False
        if row.sortie.home == current_stop.id:
            return True
        delay_s = max(day.truck_delay_s(), day.departure_delay_for_landings_s())
        return day.now_s >= row.sortie.launch_s + delay_s  # no drone lands before the truck

    # --- the truck -----------------------------------------------------------------------------

    def _driver_task_actions_at_stop(
        self, day: DaySnapshot, current_stop: PlannedStop
    ) -> list[DispatchAction]:
        """Return the planned work of this stop that is not assigned yet."""
        actions: list[DispatchAction] = [
            ServeOrder(o) for o in current_stop.serves if day.is_due(o)
        ]
        handled_drones: set[str] = set()
        for sortie in day.unassigned_sorties_by_launch_time():
            first = sortie.vehicle not in handled_drones
            handled_drones.add(sortie.vehicle)
            is_available = (
                sortie.vehicle not in day.drones_on_hold
                and day.is_drone_available_on_truck(sortie.vehicle)
            )
            if first and sortie.launch == current_stop.id and is_available:
                actions.append(DeployDrone(sortie))
        return actions

    def departure_blockers(self, day: DaySnapshot) -> list[str]:
        """Return the conditions that keep the truck at its stop, as text."""
        here = day.current_stop
        if here is None:
            return []
        blockers = [reason for row in day.sorties if (reason := row.binding_reason(here.id))]
        blockers += [
            f"{row.vehicle} ({row.id}) has not taken off"
            for row in day.sorties
            if row.sortie.launch == here.id and self._is_launched_but_not_airborne(row, day)
        ]
        if any(row.state in IN_FORCE for row in day.truck_assignments):
            blockers.append("the driver is delivering an order")
        blockers += [f"{o} is still to be delivered" for o in here.serves if o in day.due_orders]
        blockers += [
            f"{s.vehicle} is still to launch with"
            f" {s.order}{' (held)' * (s.vehicle in day.drones_on_hold)}"
            for s in day.unassigned_sorties_by_launch_time()
            if s.launch == here.id and day.is_drone_available_on_truck(s.vehicle)
        ]
        return [*blockers, "a new plan is being computed"] if day.replanning else blockers

    def _is_launched_but_not_airborne(self, row: SortieRow, day: DaySnapshot) -> bool:
        if (
            row.is_finished
            or row.is_drone_lost_off_site_or_overdue
            or row.assignment.state is not AssignmentState.IN_FLIGHT
        ):
            return False
        drone = day.drone_status(row.vehicle)
        if drone.present and drone.assignment == row.id:
            return not drone.off_ground
        launched_s = (
            day.now_s if row.launched_us is None else day.epoch_us_to_day_s(row.launched_us)
        )
        return day.now_s - launched_s < self.params.take_off_timeout_s

    def _drive_to_next_stop_actions(self, day: DaySnapshot) -> list[DispatchAction]:
        here, index = day.current_stop, day.truck_stop_or_destination_index
        if here is None or index is None or self.departure_blockers(day):
            return []
        if index + 1 >= len(day.plan.stops):
            return []
        return [DriveToStop(here.id, day.plan.stops[index + 1])]


def find_landing_stop_id(row: SortieRow, day: DaySnapshot) -> str | None:
    """Return the stop on whose pad a drone has landed; None: it is on no pad.

    A silent drone counts as landed at its promised stop: the driver checks there. If several stops
    have pads at one site, the truck's current stop takes precedence, then the promised one.
    """
    if row.launched_us is None:
        return row.sortie.launch
    drone = day.drone_status(row.vehicle)
    stops = dict.fromkeys(
        s for s in (row.promised_stop, row.requested_stop, row.sortie.launch) if s
    )
    if not drone.present or drone.lat_deg is None:
        return row.promised_stop
    pad_distances = [
        (ground_distance_if_known_m(drone.lat_deg, drone.lon_deg, row.pads[s]), s) for s in stops
    ]
    near = [(m, s) for m, s in pad_distances if m is not None and m <= NEAR_PAD_M]
    if not near:
        return None
    nearest = row.pads[min(near)[1]]
    spacing_m = {
        s: ground_distance_if_known_m(nearest.lat_deg, nearest.lon_deg, row.pads[s])
        for _, s in near
    }
    same = [s for s, m in spacing_m.items() if m is not None and m <= SAME_SITE_M]
    here = None if day.current_stop is None else day.current_stop.id
    return next(s for s in (here, row.promised_stop, *same) if s in same)


def _airborne_sorties_per_possible_home(rows: Sequence[SortieRow]) -> list[PlannedSortie]:
    """Return the sorties in the air, once for the promised home and once for a requested home."""
    home_pairs = [
        (row, home)
        for row in rows
        if row.may_be_airborne
        for home in (row.promised_stop, row.requested_stop)
    ]
    return [msgspec.structs.replace(row.sortie, home=home) for row, home in home_pairs if home]


def ground_distance_if_known_m(
    lat_deg: float | None, lon_deg: float | None, location: Location
) -> float | None:
    """Return the ground distance, for short distances; None if a position is unknown."""
    if lat_deg is None or lon_deg is None or location.lat_deg is None or location.lon_deg is None:
        return None
    return math.hypot(*ne_offset_m(location.lat_deg, location.lon_deg, lat_deg, lon_deg))


def off_pad_text(lat_deg: float | None, lon_deg: float | None, pad: Location) -> str:
    """Return the reason that a drone at this position is not on its pad; empty: it is."""
    away_m = ground_distance_if_known_m(lat_deg, lon_deg, pad)
    if away_m is None:
        return "position unknown"
    return f"{away_m:.0f} m from the depot, limit {ON_PAD_M:.0f} m" if away_m > ON_PAD_M else ""
