"""Spacing of launches from the depot, counted from take-offs that vehicles report.

A launch that was sent blocks the next one until its vehicle reports the take-off, refuses it, or
reports a state after its validity without a start. A silent vehicle blocks until a person decides:
commands that are delayed in transit would otherwise all be executed when the network recovers.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.fleet.messages import State
from ground_station.adapters.store import launch_store as launches
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES, FleetStatus
from ground_station.core.fleet.launch_evidence import is_airborne, is_launch_over, window_of
from ground_station.core.schema.orders import AssignmentRow


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
    _status: FleetStatus = field(default_factory=FleetStatus)
    _take_off_s: float = -math.inf
    _ordered_s: float = -math.inf
    _airborne: set[str] = field(default_factory=set)
    """Vehicles, under any control."""
    _flown: set[str] = field(default_factory=set)
    """Assignments."""
    _reported: set[str] = field(default_factory=set)

    def start_gap_after_restart(self) -> None:
        """Start the gap at a launch that was ordered just before a restart."""
        self.newest_launch = launches.newest_launch_command_number(self.store.database)
        if launches.airborne_or_launch_pending(self.store.database):
            self._take_off_s = self.clock.monotonic_s()

    def start_gap_at_take_off(self, state: State) -> None:
        """Start the gap at a take-off; it starts again until the vehicle has left the ground."""
        is_flying = is_airborne(state)
        if is_flying and state.assignment:
            self._flown.add(state.assignment)
        if not is_flying and state.phase not in FLIGHT_PHASE_NAMES:
            self._airborne.discard(state.vehicle)
        elif state.vehicle not in self._airborne:
            self._take_off_s = self.clock.monotonic_s()
            if is_flying:
                self._airborne.add(state.vehicle)

    def store_fleet_status(self, status: FleetStatus) -> None:
        """Store the fleet's status for later decisions."""
        self._status = status

    @property
    def earliest_launch_s(self) -> float:
        """End of the gap after the last take-off, on this desk's monotonic clock."""
        return self._take_off_s + self.gap_s if self.gap_s > 0.0 else -math.inf

    def record_newest_launch(self) -> None:
        """Start the gap at a launch that this or another desk has ordered since the last call."""
        newest = launches.newest_launch_command_number(self.store.database)
        if newest != self.newest_launch:
            self.newest_launch, self._ordered_s = newest, self.clock.monotonic_s()

    def can_order_next_launch(self) -> bool:
        """Whether the gap has elapsed and no ordered launch can still lead to a take-off."""
        self.record_newest_launch()
        if self.gap_s <= 0.0:
            return True
        if self.clock.monotonic_s() < max(self._take_off_s, self._ordered_s) + self.gap_s:
            return False
        waiting = [
            row
            for row in launches.airborne_or_launch_pending(self.store.database)
            if self._may_still_take_off(row)
        ]
        for row in waiting:
            if row.id not in self._reported:
                self._reported.add(row.id)
                self.log(
                    f"next launch waits: {row.vehicle} has not taken off with {row.id}; ends with"
                    " its take-off, its refusal, its state after the launch expired, or"
                    f" ground-station order settle {row.order_id}"
                )
        return not waiting

    def _may_still_take_off(self, row: AssignmentRow) -> bool:
        if row.id in self._flown:
            return False
        if launches.has_reported_flight(self.store.database, row):  # to this desk or another one
            self._flown.add(row.id)
            return False
        status, now_s = self._status.status_of(row.vehicle), self.clock.monotonic_s()
        is_reporting = status.is_uniquely_online_and_reporting(now_s)
        pending = launches.launches_that_may_start(self.store.database, row.id)
        if pending and not is_reporting and self.store.cancel_command(pending[-1].id, "not sent"):
            self.log(f"{row.vehicle}: launch of {row.id} cancelled: not sent, it is silent")
            return False
        windows = [window_of(launch) for launch in pending]
        if status.state is None or not is_reporting or None in windows:
            return True
        return not all(is_launch_over(status.state, row.id, one) for one in windows if one)
