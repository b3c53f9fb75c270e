"""What must hold of a small day under a fault: by truth, by the store, and by what was said."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.fleet.messages import EventKind, FleetEvent
from ground_station.core.schema.orders import AssignmentRow
from sim_bridge.app.day import rules
from sim_bridge.app.day.judge import flown as flights_of
from sim_bridge.app.faults.verdict import TRACEBACK
from sim_bridge.app.fleet_faults.fleet_stage import STRUCK, FleetStage

GOING_ON = ("go", "onward", "descend")


@dataclass(frozen=True, slots=True)
class FlownDay:
    """A day that has ended: its row by truth, its stage, its desks' words, what the store has."""

    row: dict[str, Any]
    stage: FleetStage
    folder: Path
    events: list[FleetEvent]
    assignments: list[AssignmentRow]

    @property
    def struck(self) -> dict[str, Any] | None:
        """The flight of the vehicle that was struck; None: it never flew."""
        flights = self.row["flights"]
        return next((flight for flight in flights if flight["vehicle"] == STRUCK), None)

    @property
    def told(self) -> list[tuple[float, str]]:
        """What the desks said, with the day's times, in order."""
        lines = [line for log in self.folder.glob("*.log") for line in log.read_text().splitlines()]
        split = [line.split(maxsplit=1) for line in lines]
        return sorted(((float(t_s), words) for t_s, words in split), key=lambda told: told[0])

    @property
    def said(self) -> list[str]:
        """The same without the times."""
        return [words for _, words in self.told]

    @property
    def p_home_last_go(self) -> float | None:
        """P(home) that the struck vehicle promised at its last decision to go on outward."""
        gone = [
            event.p_home
            for event in self.events
            if event.vehicle == STRUCK
            and event.kind is EventKind.DECISION
            and event.text.partition(":")[0] in GOING_ON
            and event.p_home is not None
        ]
        return gone[-1] if gone else None

    @property
    def exceptions(self) -> int:
        """Tracebacks in what desks, companions and truck wrote."""
        texts = [*self.folder.rglob("*.log"), *self.folder.rglob("*.txt")]
        return sum(path.read_text(errors="replace").count(TRACEBACK) for path in texts)


Ask = Callable[[FlownDay], list[str]]
"""What is wrong with a day by one rule, in words."""


def fault_began(flown: FlownDay) -> list[str]:
    """A day that ended before its fault shows nothing."""
    return [] if flown.stage.began_s is not None else ["the fault never began"]


def keeps_the_day(flown: FlownDay) -> list[str]:
    """What holds of any day: vehicles home, orders once, true books, promises, hands off."""
    return [words for ask in rules.ASKS for words in ask(flown.row)]


def raises_nothing(flown: FlownDay) -> list[str]:
    """No exception in anything that was written."""
    return rules.raises_nothing(flown.folder)


def launches_once(flown: FlownDay) -> list[str]:
    """Put out once, a drone flies at most once: no order launches twice, by truth."""
    mission = flown.stage.built.data.day.mission
    tracks = [
        drone.track(up, mission.reserve_frac)
        for drone in flown.stage.built.drones
        for up in drone.power_ups
        if up.rows
    ]
    return [
        f"{track.vehicle} flew {len(flights)} times, put out once"
        for track in tracks
        if len(flights := flights_of(track)) > 1
    ]


def brings_all(flown: FlownDay) -> list[str]:
    """The fault costs no delivery either."""
    left = [line["order"] for line in flown.row["undelivered"]]
    return [f"not brought: {', '.join(left)}"] if left else []


def assigns_once(flown: FlownDay) -> list[str]:
    """Each order was given to one drone, once."""
    given = Counter(row.order_id for row in flown.assignments)
    return [f"{order} was assigned {times} times" for order, times in given.items() if times > 1]


def tells(words: str) -> Ask:
    """A desk said this after the fault began."""

    def ask(flown: FlownDay) -> list[str]:
        began_s = flown.stage.began_s
        heard = [text for t_s, text in flown.told if began_s is not None and t_s >= began_s]
        return [] if any(words in text for text in heard) else [f"no desk said {words!r}"]

    return ask


def notes(what: str) -> Ask:
    """The play itself has seen it."""
    return lambda flown: [] if what in flown.stage.notes else [f"not seen: {what}"]


ALWAYS: tuple[Ask, ...] = (fault_began, keeps_the_day, launches_once, raises_nothing)
"""What every row asks."""
