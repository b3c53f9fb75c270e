"""Spacing of launches from the depot, counted from take-offs as they happen.

A launch that is ordered and not yet flown blocks the next one: where commands are delayed on their
way, launches ordered one by one would all be carried out when the network returns.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.fleet.messages import State
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import BEFORE_TAKE_OFF, IN_THE_AIR, FleetStatus
from ground_station.core.schema.orders import AssignmentRow

CANNOT_TAKE_OFF_S = 300.0
"""A vehicle unheard for this long no longer takes off: a launch is void 15 s after the state that
it rests on, and an authorised companion gives up after 180 s on the ground."""


@dataclass(slots=True)
class LaunchPacing:
    """Decides whether the next launch may be ordered. `gap_s` 0: launches are not spaced.

    The gap is counted by this desk's clock from when it saw a launch or a take-off: the clocks of
    several desks on one store may differ.
    """

    store: Store
    clock: Clock
    log: Callable[[str], None]
    gap_s: float
    newest_launch: int = 0
    _status: FleetStatus | None = None
    _last_s: float | None = None
    _seen_in_air: set[str] = field(default_factory=set)
    _reported: set[str] = field(default_factory=set)

    def begin(self) -> None:
        """Count a launch just before a restart."""
        self.newest_launch = self.store.newest_launch()
        if self.store.launched():
            self._last_s = self.clock.monotonic_s()

    def on_state(self, state: State) -> None:
        """Count a take-off."""
        id_ = state.assignment
        if id_ and state.phase in IN_THE_AIR and id_ not in self._seen_in_air:
            self._seen_in_air.add(id_)
            self._last_s = self.clock.monotonic_s()

    def update(self, status: FleetStatus) -> None:
        """Take the fleet's status, which later decisions read."""
        self._status = status

    def may_launch(self) -> bool:
        """Whether the gap is over and no ordered launch is still to be flown."""
        newest = self.store.newest_launch()
        if newest != self.newest_launch:
            self.newest_launch, self._last_s = newest, self.clock.monotonic_s()
        if self.gap_s <= 0.0:
            return True
        if self._last_s is not None and self.clock.monotonic_s() - self._last_s < self.gap_s:
            return False
        waiting = [row for row in self.store.launched() if self._may_still_take_off(row)]
        for row in waiting:
            if row.id not in self._reported:
                self._reported.add(row.id)
                self.log(f"next launch waits: {row.vehicle} has not taken off with {row.id}")
        return not waiting

    def _may_still_take_off(self, row: AssignmentRow) -> bool:
        if row.id in self._seen_in_air or self._status is None:
            return row.id not in self._seen_in_air
        seen, now_s = self._status.of(row.vehicle), self.clock.monotonic_s()
        state = seen.state
        if state is not None and seen.present(now_s):
            return state.assignment == row.id and state.phase in BEFORE_TAKE_OFF
        silent_s = seen.silent_s(now_s)
        return silent_s is not None and silent_s < CANNOT_TAKE_OFF_S
