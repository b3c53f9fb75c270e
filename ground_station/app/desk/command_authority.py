"""Checks of the desk who may command, by its newest roster and when a command is executed.

The store holds the signed roster too: each program of the store checks its operator by it, and a
desk whose folder was restored from a backup gets its newest roster back.
"""

from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from companion.fleet.messages import Launch, Refused
from companion.fleet.roster import SignedRoster
from companion.fleet.trust import MemberTrust
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.tables import ROSTER_KEY


@dataclass(slots=True)
class CommandAuthority:
    """Authority over the commands of one store."""

    trust: MemberTrust
    store: Store
    log: Callable[[str], None]
    epoch_us: Callable[[], int]
    _stored_stamp: str = ""
    _logged_alarm: str = ""

    @property
    def _holds(self) -> HoldStore:
        return HoldStore(self.store.database, self.epoch_us)

    def exchange_roster_with_store(self) -> None:
        """Accept a newer roster of the store, store this desk's, and log a new alarm."""
        if self.trust.roster_stamp != self._stored_stamp:
            if not isinstance(accept_roster_of_store(self.trust, self.store), Refused):
                self.store.database.replace_about_value(ROSTER_KEY, self.trust.signed_roster)
            self._stored_stamp = self.trust.roster_stamp
        if self.trust.roster_alarm != self._logged_alarm:
            self._logged_alarm = self.trust.roster_alarm
            self.log(f"ALARM: {self._logged_alarm}" if self._logged_alarm else "roster: one again")

    def refuse_unauthorised_commands(self) -> None:
        """Void the stored commands of authors without the right."""
        for row in self.store.outbox():
            error = self.trust.authority_error_or_empty(row.command, row.issuer)
            if error and self.store.cancel_command(row.id, error):
                self.log(f"{row.vehicle}: {row.id} refused: {error}")

    def refuse_unauthorised_launches(self) -> None:
        """Void the launch confirmations of authors without the right."""
        for row in self.store.assignments(in_force=True):
            if row.confirmed_by is None:
                continue
            action = Launch(assignment=row.id)
            error = self.trust.authority_error_or_empty(action, row.confirmed_by)
            if error and self._holds.void_launch_confirmation(row.id, error):
                self.log(f"{row.vehicle}: launch of {row.order_id} refused: {error}")


def accept_roster_of_store(trust: MemberTrust | None, store: Store) -> Refused | None:
    """Put the store's roster in force if it is newer; return why it, or no identity, is refused."""
    stored = store.database.about_value(ROSTER_KEY, SignedRoster)
    if stored is None:
        return None
    if trust is None:
        return Refused("the desk of this store has a roster: expected --identity FOLDER")
    result = trust.store_roster_if_newer(msgspec.json.encode(stored), may_be_older=True)
    return result if isinstance(result, Refused) else None
