"""Launch holds of the desk in the store: placed when due, cleared when their reason is over.

A hold is stored before any launch that it must block. An operator may release a hold: its source
does not place it again for the same reason; the other sources still place theirs.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.core.dispatch.hold_source import HoldKey, HoldSource
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.holds import ALL_DRONES

ADOPTED_HOLD_DURATION_S = 600.0
"""Duration of earlier holds after a restart, counted from when they were set: a restarted desk does
not know earlier fronts.
"""


@dataclass(slots=True)
class LaunchHoldControl:
    """Holds that this desk has placed or adopted, until their reason is over. An operator may have
    released them.
    """

    store: Store
    clock: Clock
    log: Callable[[str], None]
    _earliest_end_s_by_hold: dict[HoldKey, float] = field(default_factory=dict)
    """Adopted holds last at least until then; -inf: placed by this desk."""
    _has_adopted: bool = False

    def adopt_existing_holds(self, now_s: float) -> None:
        """Adopt the desk's holds from before a restart; they expire, too."""
        if self._has_adopted:
            return
        for hold in self.store.holds_in_force():
            if hold.by in tuple(HoldSource):
                age_s = max(0.0, (self.clock.epoch_us() - hold.set_us) / 1e6)
                end_s = now_s + max(0.0, ADOPTED_HOLD_DURATION_S - age_s)
                self._earliest_end_s_by_hold[hold.scope, HoldSource(hold.by)] = end_s
        self._has_adopted = True

    def place_and_clear_holds(
        self, reason_by_due_hold: Mapping[HoldKey, str], now_s: float
    ) -> bool:
        """Place the holds that are due, clear those that are over; True if any changed.

        Raises StoreError if the store is unreachable.
        """
        new = [key for key in reason_by_due_hold if key not in self._earliest_end_s_by_hold]
        due_scopes = {scope for scope, _ in reason_by_due_hold}
        expired = [
            (scope, source)
            for scope, source in self._earliest_end_s_by_hold.keys() - reason_by_due_hold.keys()
            if now_s >= self._earliest_end_s_by_hold[scope, source]
            and not (source is HoldSource.UNKNOWN and scope in due_scopes)
        ]
        if not new and not expired:
            return False
        hold_store = HoldStore(self.store.database, self.clock.epoch_us)
        in_force = {(hold.scope, hold.by) for hold in self.store.holds_in_force()}
        for scope, source in new:
            if (scope, source) not in in_force:  # another desk of this store may have set it
                reason = reason_by_due_hold[scope, source]
                sent_launches = hold_store.place_holds([scope], reason, source.value)
                self.log(f"{_scope_name(scope)}: launch hold: {reason}")
                for one in sent_launches:
                    self.log(f"WARNING: {one} may take off, launch already sent: keep pad clear")
            self._earliest_end_s_by_hold[scope, source] = -math.inf
        for scope, source in sorted(expired):
            released = hold_store.clear_holds([scope], source.value, only_placed_by_actor=True)
            del self._earliest_end_s_by_hold[scope, source]
            cause_text = "" if source in (HoldSource.UNKNOWN, HoldSource.ZONE) else " for the wind"
            for hold in released:
                self.log(f"{_scope_name(scope)}: launch hold{cause_text} ended ({hold.reason})")
        return True


def _scope_name(scope: str) -> str:
    return "every drone" if scope == ALL_DRONES else scope
