"""The lines of a desk or router that others call, by the names in their certificates."""

from collections import Counter
from dataclasses import dataclass

import zenoh

from companion.fleet.roster import Roster
from companion.fleet.trust import Trust
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.zenoh_log import DoorLog
from ground_station.core.fleet.door import DoorFigures, unwelcome_on


@dataclass(slots=True)
class ZenohDoor:
    """One session's, judged by the roster in force. `log`: who was turned away; None: not read.

    Who opens the session anew puts it here.
    """

    session: zenoh.Session
    trust: Trust
    log: DoorLog | None = None

    def roster(self) -> Roster:
        """The one in force."""
        return self.trust.roster

    def figures(self) -> DoorFigures:
        """As it is now."""
        names = Counter(link.auth_identifier for link in self.session.info.links())
        lines = {name: count for name, count in names.items() if name is not None}
        unwelcome = unwelcome_on(lines, self.trust.roster, epoch_us())
        return DoorFigures(lines, unwelcome, None if self.log is None else self.log.turned_away)
