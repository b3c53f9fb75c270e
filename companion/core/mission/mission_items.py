"""The dead man's mission: what follows every outbound waypoint, untouched, is the way home.

```
 TAKEOFF over the depot; LOITER_TIME
 SPEED home; JUMP over depot                    <- nobody says go: lands at the depot
   (home elsewhere: SPEED home; WAYPOINTs over the launch pad ...; JUMP over home)
 for each outbound waypoint i:  WAYPOINT out i;  SPEED home;  JUMP ret(entry of i)
 for each rally point, and each other stop of the truck:  WAYPOINT over it;  LAND;  JUMP to the end
 (ArduCopter beside neighbours, for each placed item k from here on and each outbound waypoint:
    ASIDE_LIMIT;  ASIDE;  JUMP k)               <- set-points that stop: on with k by itself
 DELIVER: WAYPOINT at drop height, held; RELEASE; LOITER_TIME; SPEED home
 ret 0..n: WAYPOINT climb-out at the customer, return waypoints, over home;  LAND at home
 SPEED: the end, which goes nowhere
```
Every LAND leads to the end: PX4 (1.18, flown) goes on to the item after a LAND that it has
completed and takes off again for it, and does not disarm while a mission is in progress; led to
a last item without a place it finishes, landed, and disarms. ArduCopter disarms at any LAND.
Items are numbered from 0 for every autopilot; adapters shift and encode them (ArduPilot keeps
its home at 0). Only a companion that is alive jumps the autopilot onward.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import islice

from companion.core.base.errors import LeewayError

JUMP_REPEATS = 30_000
"""Times that a JUMP is taken. Not -1: PX4 keeps the count unsigned (mission_item_s, uint16);
ArduPilot keeps it in 16 bits with sign.
"""


class ItemKind(Enum):
    """What an item asks of the autopilot."""

    TAKEOFF = "takeoff"
    WAYPOINT = "waypoint"
    LOITER_TIME = "loiter"
    LAND = "land"
    SPEED = "speed"
    JUMP = "jump"
    RELEASE = "release"
    ASIDE_LIMIT = "set-points for so long"
    ASIDE = "set-points"
    OTHER = "other"


PLACED = {ItemKind.TAKEOFF, ItemKind.WAYPOINT, ItemKind.LOITER_TIME, ItemKind.LAND}


class Part(Enum):
    """Which part of the flight an item belongs to."""

    TAKEOFF = "takeoff"
    SETTLE = "settle"
    OUTBOUND = "outbound"
    DELIVER = "deliver"
    RELEASE = "release"
    RETURN = "return"
    LAND = "land"
    RALLY = "rally"
    RALLY_LAND = "rally landing"
    END = "end"
    ASIDE = "set-points"


@dataclass(frozen=True, slots=True)
class Spot:
    """A point to fly to; `height_rel_m` is above the depot's ground (the autopilot's home)."""

    lat_deg: float
    lon_deg: float
    height_rel_m: float


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One item; `value` is s (WAYPOINT, LOITER_TIME, ASIDE_LIMIT), m/s (SPEED), an index (JUMP)."""

    kind: ItemKind
    part: Part
    label: str = ""
    spot: Spot | None = None
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class DeadMansMission:
    """The items and where in them things are (indices into `items`)."""

    items: tuple[MissionItem, ...]
    takeoff: int
    settle: int
    outbound: tuple[int, ...]
    entry_of_outbound: tuple[int, ...]
    deliver: int
    release: int
    delay: int
    returning: tuple[int, ...]
    land: int
    rally: tuple[tuple[int, int], ...]
    away: tuple[int, ...] = ()
    asides: tuple[tuple[int, int], ...] = ()
    """(item, first of the three items by which set-points lead to it); ArduCopter's only."""

    def stands_for(self, index: int) -> int:
        """The item that an item leads to where it is one of set-points; else itself."""
        return next((k for k, first in self.asides if first <= index <= first + 2), index)

    def aside_of(self, index: int) -> int | None:
        """Where set-points begin that lead to this item, if the mission has such."""
        return next((first for k, first in self.asides if k == index), None)

    def is_aside(self, index: int) -> bool:
        """Tell whether set-points are obeyed at this item (or are about to be)."""
        return any(first <= index <= first + 1 for _, first in self.asides)

    def part_at(self, index: int) -> Part | None:
        """Return the part of the flight at an item, `None` when it is not one of ours."""
        return self.items[index].part if 0 <= index < len(self.items) else None

    def spot_at(self, index: int) -> Spot | None:
        """Return where the autopilot is heading at an item: that item's spot or the next one's."""
        return next((item.spot for _, item in self._way_from(index) if item.spot is not None), None)

    def next_place(self, index: int) -> int | None:
        """The next item with a place that the autopilot comes to by itself after this one."""
        further = islice(self._way_from(index), 1, None)
        return next((at for at, item in further if item.kind in PLACED), None)

    def _way_from(self, index: int) -> Iterator[tuple[int, MissionItem]]:
        """The items as the autopilot comes to them by itself, this one first."""
        for _ in range(len(self.items)):
            if not 0 <= index < len(self.items):
                return
            item = self.items[index]
            yield index, item
            index = int(item.value) if item.kind is ItemKind.JUMP else index + 1

    def follows(self, before: int, now: int) -> bool:
        """Tell whether the autopilot gets from `before` to `now` by itself.

        True when `now` is passed before two more placed items were: telemetry may skip items that
        take no time, never a place.
        """
        index, placed = before, 0
        for _ in range(len(self.items)):
            if index == now:
                return True
            if not 0 <= index < len(self.items) or placed > 1:
                return False
            item = self.items[index]
            index = int(item.value) if item.kind is ItemKind.JUMP else index + 1
            if 0 <= index < len(self.items) and self.items[index].kind in PLACED:
                placed += 1
        return False


def build_dead_mans_mission(
    *,
    depot: Spot,
    outbound: Sequence[Spot],
    drop: Spot,
    returning: Sequence[Spot],
    entries: Sequence[int],
    rally: Sequence[tuple[Spot, Spot]],
    settle_s: float,
    hold_s: float,
    weigh_s: float,
    delay_s: float,
    home_speed_mps: float,
    start: Spot | None = None,
    away: Sequence[Spot] = (),
    aside_s: float | None = None,
) -> DeadMansMission:
    """Lay out the mission above.

    `outbound` ends over the customer at cruise height; `returning` starts there (the climb-out)
    and ends over `depot`, the ground where it lands. `start` is where it takes off to (`None`: over
    that same depot), `away` the way from there to the last of `returning` where that is elsewhere.
    From `outbound[i]` the way home enters at `returning[entries[i]]`.
    Over the customer the vehicle holds for `hold_s`, so that leave to descend can be given there;
    at the drop for `weigh_s` before the release and `delay_s` after it (safety rule 5).
    `rally` holds (over it, its ground). `aside_s`: ArduCopter flies set-points for that long at
    most before the mission goes on by itself; `None`: there are no such items.
    Raises LeewayError where these do not fit together.
    """
    if not outbound or len(returning) < 2 or len(entries) != len(outbound):
        raise LeewayError("mission: expected outbound waypoints, each with its way home")
    for number, entry in enumerate(entries):
        if not 0 <= entry < len(returning):
            raise LeewayError(f"mission: outbound point {number} enters a way home at {entry}")
    if not (math.isfinite(home_speed_mps) and home_speed_mps > 0.0):
        raise LeewayError(f"mission: home speed {home_speed_mps!r}: expected more than 0 m/s")

    over_depot = returning[-1] if start is None else start
    out_start = 4 + len(away)
    rally_start = out_start + 3 * len(outbound)
    aside_start = rally_start + 3 * len(rally)
    led_to = len(away) + len(outbound) + 2 * len(rally) + 1 + len(returning) + 1
    deliver = aside_start + (3 * led_to if aside_s is not None else 0)
    ret_start = deliver + 4
    land = ret_start + len(returning)
    outward = tuple(out_start + 3 * i for i in range(len(outbound)))

    items = [
        MissionItem(ItemKind.TAKEOFF, Part.TAKEOFF, "takeoff", over_depot),
        MissionItem(ItemKind.LOITER_TIME, Part.SETTLE, "settle", over_depot, settle_s),
        MissionItem(ItemKind.SPEED, Part.SETTLE, "home speed", None, home_speed_mps),
    ]
    items += [
        MissionItem(ItemKind.WAYPOINT, Part.RETURN, f"away {number}", spot)
        for number, spot in enumerate(away)
    ]
    left = Part.RETURN if away else Part.SETTLE
    items.append(MissionItem(ItemKind.JUMP, left, "no go", None, float(land - 1)))
    for number, (spot, entry) in enumerate(zip(outbound, entries, strict=True)):
        wait_s = hold_s if number == len(outbound) - 1 else 0.0
        items += [
            MissionItem(ItemKind.WAYPOINT, Part.OUTBOUND, f"out {number}", spot, wait_s),
            MissionItem(ItemKind.SPEED, Part.OUTBOUND, "home speed", None, home_speed_mps),
            MissionItem(ItemKind.JUMP, Part.OUTBOUND, "home", None, float(ret_start + entry)),
        ]
    rally_items: list[tuple[int, int]] = []
    for number, (over, ground) in enumerate(rally):
        down = len(items) + 1
        rally_items.append((down - 1, down))
        items += [
            MissionItem(ItemKind.WAYPOINT, Part.RALLY, f"rally {number}", over),
            MissionItem(ItemKind.LAND, Part.RALLY_LAND, f"rally {number} landing", ground),
            MissionItem(ItemKind.JUMP, Part.RALLY_LAND, "end", None, float(land + 1)),
        ]
    aboard = (*range(3, 3 + len(away)), *outward, *(i for pair in rally_items for i in pair))
    asides: list[tuple[int, int]] = []
    if aside_s is not None:
        for target in (*aboard, deliver, *range(ret_start, land + 1)):
            asides.append((target, len(items)))
            items += _aside(target, aside_s)
    items += [
        MissionItem(ItemKind.WAYPOINT, Part.DELIVER, "drop", drop, weigh_s),
        MissionItem(ItemKind.RELEASE, Part.RELEASE, "release"),
        MissionItem(ItemKind.LOITER_TIME, Part.RELEASE, "let go", drop, delay_s),
        MissionItem(ItemKind.SPEED, Part.RELEASE, "home speed", None, home_speed_mps),
    ]
    items += [
        MissionItem(ItemKind.WAYPOINT, Part.RETURN, f"ret {number}", spot)
        for number, spot in enumerate(returning)
    ]
    items.append(MissionItem(ItemKind.LAND, Part.LAND, "land", depot))
    items.append(MissionItem(ItemKind.SPEED, Part.END, "end", None, home_speed_mps))
    return DeadMansMission(
        items=tuple(items),
        takeoff=0,
        settle=1,
        outbound=outward,
        entry_of_outbound=tuple(ret_start + entry for entry in entries),
        deliver=deliver,
        release=deliver + 1,
        delay=deliver + 2,
        returning=tuple(range(ret_start, land)),
        land=land,
        rally=tuple(rally_items),
        away=tuple(range(3, 3 + len(away))),
        asides=tuple(asides),
    )


def _aside(target: int, for_s: float) -> list[MissionItem]:
    """Set-points on the way to an item: for so long, unless asked again; then the item itself."""
    return [
        MissionItem(ItemKind.ASIDE_LIMIT, Part.ASIDE, "set-point limits", None, for_s),
        MissionItem(ItemKind.ASIDE, Part.ASIDE, "set-points", None, 1.0),
        MissionItem(ItemKind.JUMP, Part.ASIDE, f"on to {target}", None, float(target)),
    ]


DEGREES_TOLERANCE = 3e-7
HEIGHT_TOLERANCE_M = 0.02
VALUE_TOLERANCE = 0.02


def differences(ours: Sequence[MissionItem], aboard: Sequence[MissionItem]) -> tuple[str, ...]:
    """Say where the mission read back departs from ours; empty when it is the same flight.

    Both are as we number and encode them: what an autopilot is known to rewrite (frames, NaN,
    radius, home item) was undone or ignored by its adapter, so anything
    left over changes the flight.
    """
    found: list[str] = []
    if len(ours) != len(aboard):
        found.append(f"{len(aboard)} items aboard, {len(ours)} uploaded")
    for index, (mine, theirs) in enumerate(zip(ours, aboard, strict=False)):
        name = f"item {index} ({mine.label or mine.kind.value})"
        if mine.kind is not theirs.kind:
            found.append(f"{name}: {theirs.kind.value} aboard, expected {mine.kind.value}")
            continue
        if not abs(mine.value - theirs.value) <= VALUE_TOLERANCE:
            found.append(f"{name}: value {theirs.value:g} aboard, expected {mine.value:g}")
        if mine.kind is ItemKind.TAKEOFF:
            # Both autopilots climb where they stand; the place of a take-off item is not kept.
            if not _same_height(mine.spot, theirs.spot):
                found.append(f"{name}: another height aboard")
        elif (mine.kind in PLACED) and not _same_spot(mine.spot, theirs.spot):
            found.append(f"{name}: another place aboard ({theirs.spot}, expected {mine.spot})")
    return tuple(found)


def _same_height(mine: Spot | None, theirs: Spot | None) -> bool:
    if mine is None or theirs is None:
        return mine is theirs
    return abs(mine.height_rel_m - theirs.height_rel_m) <= HEIGHT_TOLERANCE_M


def _same_spot(mine: Spot | None, theirs: Spot | None) -> bool:
    if mine is None or theirs is None:
        return mine is theirs
    return (
        abs(mine.lat_deg - theirs.lat_deg) <= DEGREES_TOLERANCE
        and abs(mine.lon_deg - theirs.lon_deg) <= DEGREES_TOLERANCE
        and _same_height(mine, theirs)
    )
