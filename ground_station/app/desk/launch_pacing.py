"""Spacing of launches from the depot, counted from take-offs as they happen.

A launch that is ordered but not yet flown blocks the next one: if commands are delayed in transit,
launches ordered one by one would all be executed when the network recovers.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.fleet.messages import State
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import (
    FLIGHT_PHASE_NAMES,
    GROUND_PHASE_NAMES,
    FleetStatus,
)
from ground_station.core.schema.orders import AssignmentRow

NO_TAKE_OFF_AFTER_S = 300.0
"""After this silence a vehicle cannot take off any more: a launch expires 15 s after the state that
it refers to, and an authorised companion aborts after 180 s on the ground."""


@dataclass(slots=True)
class LaunchPacing:
    """Decides whether the next launch may be ordered. `gap_s` 0: launches are not spaced.

    The gap starts when this desk detects a launch or a take-off, on its own clock: the clocks of
    several desks on one store may differ.
    """

    store: Store
    clock: Clock
    log: Callable[[str], None]
    gap_s: float
    newest_launch: int = 0
    _status: FleetStatus | None = None
    _last_launch_s: float | None = None
    _seen_in_air: set[str] = field(default_factory=set)
    _reported: set[str] = field(default_factory=set)

    def start_gap_after_restart(self) -> None:
        """Start the gap at a launch that was ordered just before a restart."""
        self.newest_launch = self.store.newest_launch_command_number()
        if self.store.airborne_or_launch_pending():
            self._last_launch_s = self.clock.monotonic_s()

    def start_gap_at_take_off(self, state: State) -> None:
        """Start the gap at a take-off."""
        id_ = state.assignment
        if id_ and state.phase in FLIGHT_PHASE_NAMES and id_ not in self._seen_in_air:
            self._seen_in_air.add(id_)
            self._last_launch_s = self.clock.monotonic_s()

    def store_fleet_status(self, status: FleetStatus) -> None:
        """Store the fleet's status for later decisions."""
        self._status = status

    def can_order_next_launch(self) -> bool:
        """Whether the gap has elapsed and every ordered launch has taken off."""
        newest = self.store.newest_launch_command_number()
        if newest != self.newest_launch:
            self.newest_launch, self._last_launch_s = newest, self.clock.monotonic_s()
        if self.gap_s <= 0.0:
            return True
        if (
            self._last_launch_s is not None
            and self.clock.monotonic_s() - self._last_launch_s < self.gap_s
        ):
            return False
        waiting = [
            row for row in self.store.airborne_or_launch_pending() if self._may_still_take_off(row)
        ]
        for row in waiting:
            if row.id not in self._reported:
                self._reported.add(row.id)
                self.log(f"next launch waits: {row.vehicle} has not taken off with {row.id}")
        return not waiting

    def _may_still_take_off(self, row: AssignmentRow) -> bool:
        if row.id in self._seen_in_air or self._status is None:
            return row.id not in self._seen_in_air
        vehicle_status, now_s = self._status.status_of(row.vehicle), self.clock.monotonic_s()
        state = vehicle_status.state
        if state is not None and vehicle_status.is_uniquely_online_and_reporting(now_s):
            return state.assignment == row.id and state.phase in GROUND_PHASE_NAMES
        silent_s = vehicle_status.seconds_since_last_state(now_s)
        return silent_s is not None and silent_s < NO_TAKE_OFF_AFTER_S
