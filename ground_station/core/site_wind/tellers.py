"""Who tells the wind of a site: since when, what last, and who is left out and why.

Why somebody is left out is found elsewhere (`site_belief`); it is kept here.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from companion.core.wind_field.tellings import TELLING_S, WindTelling

KNOWN_S, LEAST_SPAN_S = 120.0, 60.0
"""A field is known where somebody has told in the last two minutes, for a minute or longer: gusts
and turns of one drone average out over that.
"""

REFUSED_S = 1.5 * TELLING_S
"""Who tells nothing that can be kept (a frozen wind, an impossible one) is found so once for each
telling that would be kept.
"""


@dataclass(slots=True)
class Teller:
    """One's tellings: the first of an unbroken row, and the newest. `out`: why it is not
    believed, since `out_s`; `agrees_s`: since when it fits the others again.
    """

    first_s: float
    newest: WindTelling
    out: str = ""
    out_s: float = 0.0
    agrees_s: float | None = None
    tried_s: float = -math.inf

    def leave_out(self, why: str, t_s: float) -> None:
        """It is not believed from now on."""
        self.out, self.out_s, self.agrees_s = why, t_s, None


@dataclass(slots=True)
class Tellers:
    """All who have told one listener. `stations`: who of them stands on the ground."""

    stations: set[str] = field(default_factory=set)
    _each: dict[str, Teller] = field(default_factory=dict)
    _refused: dict[str, tuple[float, str]] = field(default_factory=dict)

    @property
    def drones(self) -> frozenset[str]:
        """Who is no station."""
        return frozenset(self._each.keys() - self.stations)

    def note(self, telling: WindTelling, t_s: float) -> Teller | None:
        """Who tells this, its newest telling noted; None: it can be no wind."""
        name = telling.member
        if trouble := telling.trouble():
            self.refuse(name, trouble, t_s)
            return None
        teller = self._each.get(name)
        if teller is None or t_s - teller.newest.t_s > KNOWN_S:
            before = teller
            teller = self._each[name] = Teller(t_s, telling)
            if before is not None and before.out:
                teller.leave_out(before.out, before.out_s)
        teller.newest = telling
        return teller

    def refuse(self, name: str, why: str, t_s: float) -> None:
        """Nothing of what it told now is kept."""
        self._refused[name] = t_s, why

    def leave_out(self, name: str, why: str, t_s: float) -> None:
        """It is not believed from now on."""
        if name in self._each:
            self._each[name].leave_out(why, t_s)

    def left_out(self, t_s: float) -> dict[str, str]:
        """Who is not believed now, and why."""
        refused = {
            name: why
            for name, (refused_s, why) in self._refused.items()
            if t_s - refused_s <= REFUSED_S
        }
        return refused | {
            name: teller.out
            for name, teller in self._each.items()
            if teller.out and t_s - teller.newest.t_s <= KNOWN_S
        }

    def believed(self, t_s: float, within_s: float = KNOWN_S) -> list[WindTelling]:
        """The newest telling of each who has told of late and is not left out, by name."""
        out = self.left_out(t_s)
        return [
            teller.newest
            for name, teller in sorted(self._each.items())
            if name not in out and t_s - teller.newest.t_s <= within_s
        ]

    def known_drones(self, t_s: float) -> list[str]:
        """Drones that are believed and have told of late, for long enough."""
        return self._long_enough(one.member for one in self.believed(t_s) if self._flies(one))

    def known_stations(self, t_s: float) -> list[str]:
        """The same of stations."""
        return self._long_enough(one.member for one in self.believed(t_s) if not self._flies(one))

    def _flies(self, telling: WindTelling) -> bool:
        return telling.member not in self.stations

    def _long_enough(self, names: Iterable[str]) -> list[str]:
        each = ((name, self._each[name]) for name in names)
        return [name for name, one in each if one.newest.t_s - one.first_s >= LEAST_SPAN_S]
