"""One vehicle's belief of the field from what it feels itself and what a desk tells it of others.

Whoever tells may lie, stand still, be late or fall silent. So the fleet is only used while it
agrees with one's own wind, and in doubt one's own wind alone is: then nothing here is asked at all.

- What can be no wind, is old, moves too fast or stays the same for a minute changes nothing, and
  who contradicts all the others is left out (`tellings`, `agreement`).
- All others together are held against one's own wind, over 15 minutes and over the newest one
  (`SettledField.disagreement`). Where they contradict one another nobody can tell a front that has
  not come here yet from a lie: one's own wind holds until they have agreed for a minute.
"""

import math
from collections.abc import Iterable

from companion.core.wind_field.field_belief import FieldBelief
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.settled_field import SettledField
from companion.core.wind_field.tellings import WindTelling

OWN = "(own)"
"""No member's name."""

MUTE_S = 25.0
"""A word comes every 10 s: two are missing."""

DOUBT_SQUARE = 9.21
"""Chance passes it once in a hundred times (chi-square of two degrees) where the process holds."""

AGREED_S = 60.0
SETTLED_S = 1.0
"""The belief is worked out anew at most so often: as often as the gate asks."""

MOST_FRONT_S = 900.0
"""No front is on its way to a site for longer."""


class FleetWind:
    """Follows one's own wind and the others'; times are of one's own clock."""

    def __init__(self, process: FieldProcess) -> None:
        self._process = process
        self.forget()

    def forget(self) -> None:
        """Begin anew: nothing is known, also not of one's own wind."""
        self._belief = FieldBelief(self._process)
        self._own: WindTelling | None = None
        self._heard_s: float | None = None
        self._doubted_s: float | None = None
        self._front: FrontAhead | None = None
        self._settled: SettledField | None = None
        self._of_s: float | None = None
        self.refused: dict[str, str] = {}
        """Whose newest telling was not taken, and why."""
        self.why_not = ""
        """Why the fleet is not used now; empty: it is, or nobody has told anything."""

    def feel(self, own: WindTelling) -> None:
        """One's own wind, at any rate."""
        if self._own is not None and own.t_s < self._own.t_s - SETTLED_S:
            self.forget()  # the clock went back
        self._own = own
        self._belief.tell(own, own.t_s)

    def hear(self, told: Iterable[WindTelling], front: FrontAhead | None, now_s: float) -> None:
        """What the desk told of the others; `front`: one that is new or better known."""
        self._heard_s = now_s
        self.refused = {}
        for one in told:
            if one.member != OWN and (why := self._belief.tell(one, now_s)):
                self.refused[one.member] = why
        if front is not None:
            self._front = front

    def withdraw_front(self) -> bool:
        """The front that was told is none; whether one was still expected."""
        expected, self._front = self._front is not None, None
        return expected

    def used(self, now_s: float) -> SettledField | None:
        """The field as all believe it; None: one's own wind alone is to be used (`why_not`)."""
        if self._heard_s is None or self._own is None:
            return None
        if self._of_s is None or not 0.0 <= now_s - self._of_s < SETTLED_S - 1e-6:
            self._settled, self._of_s = self._looked_at(now_s), now_s
        return self._settled

    def front_at(self, now_s: float, place_ne_m: tuple[float, float]) -> FrontAhead | None:
        """A front that may still come to a place."""
        front = self._front
        if front is None:
            return None
        due_s, std_s = front.arrives(place_ne_m)
        if now_s > due_s + 2.0 * std_s or now_s - front.noticed_s > MOST_FRONT_S:
            self._front = None
        return self._front

    def _looked_at(self, now_s: float) -> SettledField | None:
        assert self._heard_s is not None
        silent_s = now_s - self._heard_s
        if silent_s > MUTE_S:
            self.why_not = "silent"
            self._doubted_s = None  # who comes back is looked at as anybody new
            return None
        settled = self._belief.settle(now_s, OWN, newest=self._own)
        others = [name for name in settled.members if name != OWN]
        square = settled.disagreement(OWN)
        if not others:
            self.why_not = "nobody who is believed"
        elif square is None:
            self.why_not = "too little of one's own wind to compare"
        elif square > DOUBT_SQUARE:
            self.why_not, self._doubted_s = "contradicts one's own wind", now_s
        elif self._doubted_s is not None and now_s - self._doubted_s < AGREED_S:
            self.why_not = "has contradicted one's own wind"
        else:
            self.why_not = ""
            return settled
        return None


def others_words(settled: SettledField) -> str:
    """Who is believed besides oneself, in words."""
    count = sum(name != OWN for name in settled.members)
    return "1 other" if count == 1 else f"{count} others"


def wind_words(to_ne_mps: tuple[float, float]) -> str:
    """A wind as people say it: its speed, and where it blows from."""
    north, east = to_ne_mps
    from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
    return f"{math.hypot(north, east):.1f} m/s from {from_deg:.0f}"
