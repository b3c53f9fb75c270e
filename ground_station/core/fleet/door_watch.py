"""Says who is at a desk's or router's door and should not be: at once, then once a minute."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from companion.fleet.roster import Roster
from ground_station.core.fleet.door import (
    UNWELCOME_WORDS,
    DoorFigures,
    TurnedAway,
    Unwelcome,
    ended_members,
    turned_away_words,
)

LOOK_S = 1.0
SAY_AGAIN_S = 60.0


@dataclass(slots=True)
class DoorWatch:
    """`look` gives the door as it is, `roster` the one in force."""

    look: Callable[[], DoorFigures]
    roster: Callable[[], Roster]
    say: Callable[[str], None]
    _looked_s: float | None = None
    _on_line: frozenset[str] = frozenset()
    _said_s: dict[str, float] = field(default_factory=dict)
    _told: Counter[TurnedAway] = field(default_factory=Counter)
    _told_s: float | None = None

    def turn(self, now_s: float, now_us: int) -> None:
        """Look, when it is time to."""
        if self._looked_s is not None and now_s - self._looked_s < LOOK_S:
            return
        self._looked_s = now_s
        door = self.look()
        self._say_unwelcome(door.unwelcome, now_s)
        if door.turned_away is not None:
            self._say_turned_away(Counter(door.turned_away), now_s, now_us)

    def _say_unwelcome(self, unwelcome: Mapping[str, Unwelcome], now_s: float) -> None:
        """Whoever has come since the last look; who comes and goes, once a minute."""
        for name in sorted(unwelcome.keys() - self._on_line):
            said_s = self._said_s.get(name)
            if said_s is None or now_s - said_s >= SAY_AGAIN_S:
                self._said_s[name] = now_s
                self.say(f"ON A LINE: {name} {UNWELCOME_WORDS[unwelcome[name]]}")
        self._on_line = frozenset(unwelcome)

    def _say_turned_away(self, counts: Counter[TurnedAway], now_s: float, now_us: int) -> None:
        rested = self._told_s is None or now_s - self._told_s >= SAY_AGAIN_S
        if counts == self._told or not rested:
            return
        for words in turned_away_words(counts - self._told, ended_members(self.roster(), now_us)):
            self.say(words)
        self._told, self._told_s = counts, now_s
