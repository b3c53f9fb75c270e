"""The return-by-default ("dead man's") mission: without a jump, every outbound waypoint leads home.

```
 TAKEOFF over the depot; LOITER_TIME
 SPEED home; JUMP over depot                    <- no departure: lands at the depot
   (home elsewhere: SPEED home; WAYPOINTs over the launch pad ...; JUMP over home)
 for each outbound waypoint i:  WAYPOINT out i;  SPEED home;  JUMP ret(entry of i)
 for each rally point, and each other stop of the truck:  WAYPOINT over it;  LAND;  JUMP to the end
 (ArduCopter with neighbours, for each positioned item k from here and each outbound waypoint:
    ASIDE_LIMIT;  ASIDE;  JUMP k)               <- set-points stop: it continues with k
 DELIVER: WAYPOINT at drop height, held; RELEASE; LOITER_TIME; SPEED home
 ret 0..n: WAYPOINT climb-out at the customer, return waypoints, over home;  LAND at home
 SPEED: the end, without motion
```
Every LAND leads to the end: PX4 (1.18, flown) continues with the item after a completed LAND and
takes off again for it, and does not disarm while a mission is in progress. At a last item without a
position it finishes, landed, and disarms. ArduCopter disarms at any LAND.
Items are numbered from 0 for every autopilot; adapters shift and encode them (ArduPilot keeps
its home at 0). Only a running companion jumps the autopilot onward.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import islice

from companion.core.base.errors import LeewayError

JUMP_REPEATS = 30_000
"""Number of repeats of a JUMP. Not -1: PX4 keeps the count unsigned (mission_item_s, uint16);
ArduPilot keeps it in 16 bits with sign."""


class ItemKind(Enum):
    """Command of an item."""

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


POSITIONED_KINDS = {ItemKind.TAKEOFF, ItemKind.WAYPOINT, ItemKind.LOITER_TIME, ItemKind.LAND}


class Part(Enum):
    """Part of the flight to which an item belongs."""

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
class MissionPosition:
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
    spot: MissionPosition | None = None
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class ReturnByDefaultMission:
    """The items, and the indices of its parts in `items`."""

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
    pad_return: tuple[int, ...] = ()
    setpoint_items: tuple[tuple[int, int], ...] = ()
    """(item, first of the three items that lead to it with set-points); ArduCopter only."""

    def resolve_setpoint_item_target(self, item_index: int) -> int:
        """Return the target item if the item belongs to set-points, else the item itself."""
        return next(
            (k for k, first in self.setpoint_items if first <= item_index <= first + 2), item_index
        )

    def first_setpoint_item_of_target(self, target_index: int) -> int | None:
        """Return the first set-point item that leads to this item, if the mission has one."""
        return next((first for k, first in self.setpoint_items if k == target_index), None)

    def is_setpoint_item(self, item_index: int) -> bool:
        """Return whether set-points are executed at this item (or are about to be)."""
        return any(first <= item_index <= first + 1 for _, first in self.setpoint_items)

    def part_of_item(self, item_index: int) -> Part | None:
        """Return the part of the flight at an item, `None` for an unknown item."""
        return self.items[item_index].part if 0 <= item_index < len(self.items) else None

    def position_at_or_after_item(self, item_index: int) -> MissionPosition | None:
        """Return the position of this item or of the next positioned one."""
        return next(
            (
                item.spot
                for _, item in self._items_in_execution_order_from(item_index)
                if item.spot is not None
            ),
            None,
        )

    def next_positioned_item(self, item_index: int) -> int | None:
        """Return the next positioned item that the autopilot reaches on its own after this one."""
        later_items = islice(self._items_in_execution_order_from(item_index), 1, None)
        return next((at for at, item in later_items if item.kind in POSITIONED_KINDS), None)

    def _items_in_execution_order_from(self, start_index: int) -> Iterator[tuple[int, MissionItem]]:
        """Iterate over the items in the order of execution, starting with this one."""
        for _ in range(len(self.items)):
            if not 0 <= start_index < len(self.items):
                return
            item = self.items[start_index]
            yield start_index, item
            start_index = int(item.value) if item.kind is ItemKind.JUMP else start_index + 1

    def is_item_reachable_without_jump(self, from_index: int, to_index: int) -> bool:
        """Return whether the autopilot gets from `from_index` to `to_index` on its own.

        True if `to_index` is passed before two further positioned items: telemetry may skip items
        that take no time, never a positioned one.
        """
        index, positioned_count = from_index, 0
        for _ in range(len(self.items)):
            if index == to_index:
                return True
            if not 0 <= index < len(self.items) or positioned_count > 1:
                return False
            item = self.items[index]
            index = int(item.value) if item.kind is ItemKind.JUMP else index + 1
            if 0 <= index < len(self.items) and self.items[index].kind in POSITIONED_KINDS:
                positioned_count += 1
        return False


def build_return_by_default_mission(
    *,
    landing_position: MissionPosition,
    outbound: Sequence[MissionPosition],
    drop_position: MissionPosition,
    returning: Sequence[MissionPosition],
    return_entry_by_outbound: Sequence[int],
    rally_overhead_and_ground: Sequence[tuple[MissionPosition, MissionPosition]],
    settle_hover_s: float,
    customer_hold_s: float,
    loaded_hover_s: float,
    release_hover_s: float,
    home_speed_mps: float,
    takeoff_position: MissionPosition | None = None,
    pad_to_other_home_route: Sequence[MissionPosition] = (),
    setpoint_timeout_s: float | None = None,
) -> ReturnByDefaultMission:
    """Build the mission described above.

    `outbound` ends over the customer at cruise height; `returning` starts there (the climb-out) and
    ends over `landing_position`. `takeoff_position` is the takeoff target
    (`None`: over the same depot), `pad_to_other_home_route` the route from there to the last of
    `returning` if that is elsewhere. From `outbound[i]` the return route starts at
    `returning[return_entry_by_outbound[i]]`. Over the customer the vehicle holds for
    `customer_hold_s`, during which the descent can be cleared; at the drop for `loaded_hover_s`
    before the release and `release_hover_s` after it (safety rule 5). `rally_overhead_and_ground`
    holds (above the site, its ground). `setpoint_timeout_s`: maximum time for which ArduCopter
    flies set-points before the mission continues; `None`: no such items. Raises LeewayError if
    these are inconsistent.
    """
    if not outbound or len(returning) < 2 or len(return_entry_by_outbound) != len(outbound):
        raise LeewayError("mission: expected outbound waypoints, each with a return entry")
    for number, entry in enumerate(return_entry_by_outbound):
        if not 0 <= entry < len(returning):
            raise LeewayError(f"mission: outbound point {number}: no return entry {entry}")
    if not (math.isfinite(home_speed_mps) and home_speed_mps > 0.0):
        raise LeewayError(f"mission: home speed {home_speed_mps!r}: expected more than 0 m/s")

    over_depot = returning[-1] if takeoff_position is None else takeoff_position
    out_start = 4 + len(pad_to_other_home_route)
    rally_start = out_start + 3 * len(outbound)
    aside_start = rally_start + 3 * len(rally_overhead_and_ground)
    setpoint_target_count = (
        len(pad_to_other_home_route)
        + len(outbound)
        + 2 * len(rally_overhead_and_ground)
        + 1
        + len(returning)
        + 1
    )
    deliver = aside_start + (3 * setpoint_target_count if setpoint_timeout_s is not None else 0)
    ret_start = deliver + 4
    land = ret_start + len(returning)
    outbound_items = tuple(out_start + 3 * i for i in range(len(outbound)))

    items = [
        MissionItem(ItemKind.TAKEOFF, Part.TAKEOFF, "takeoff", over_depot),
        MissionItem(ItemKind.LOITER_TIME, Part.SETTLE, "settle", over_depot, settle_hover_s),
        MissionItem(ItemKind.SPEED, Part.SETTLE, "home speed", None, home_speed_mps),
    ]
    items += [
        MissionItem(ItemKind.WAYPOINT, Part.RETURN, f"away {number}", spot)
        for number, spot in enumerate(pad_to_other_home_route)
    ]
    no_departure_part = Part.RETURN if pad_to_other_home_route else Part.SETTLE
    items.append(MissionItem(ItemKind.JUMP, no_departure_part, "no go", None, float(land - 1)))
    for number, (spot, entry) in enumerate(zip(outbound, return_entry_by_outbound, strict=True)):
        wait_s = customer_hold_s if number == len(outbound) - 1 else 0.0
        items += [
            MissionItem(ItemKind.WAYPOINT, Part.OUTBOUND, f"out {number}", spot, wait_s),
            MissionItem(ItemKind.SPEED, Part.OUTBOUND, "home speed", None, home_speed_mps),
            MissionItem(ItemKind.JUMP, Part.OUTBOUND, "home", None, float(ret_start + entry)),
        ]
    rally_items: list[tuple[int, int]] = []
    for number, (above, ground) in enumerate(rally_overhead_and_ground):
        landing_item = len(items) + 1
        rally_items.append((landing_item - 1, landing_item))
        items += [
            MissionItem(ItemKind.WAYPOINT, Part.RALLY, f"rally {number}", above),
            MissionItem(ItemKind.LAND, Part.RALLY_LAND, f"rally {number} landing", ground),
            MissionItem(ItemKind.JUMP, Part.RALLY_LAND, "end", None, float(land + 1)),
        ]
    onboard_items = (
        *range(3, 3 + len(pad_to_other_home_route)),
        *outbound_items,
        *(i for pair in rally_items for i in pair),
    )
    asides: list[tuple[int, int]] = []
    if setpoint_timeout_s is not None:
        for target in (*onboard_items, deliver, *range(ret_start, land + 1)):
            asides.append((target, len(items)))
            items += _setpoint_items(target, setpoint_timeout_s)
    items += [
        MissionItem(ItemKind.WAYPOINT, Part.DELIVER, "drop", drop_position, loaded_hover_s),
        MissionItem(ItemKind.RELEASE, Part.RELEASE, "release"),
        MissionItem(ItemKind.LOITER_TIME, Part.RELEASE, "let go", drop_position, release_hover_s),
        MissionItem(ItemKind.SPEED, Part.RELEASE, "home speed", None, home_speed_mps),
    ]
    items += [
        MissionItem(ItemKind.WAYPOINT, Part.RETURN, f"ret {number}", spot)
        for number, spot in enumerate(returning)
    ]
    items.append(MissionItem(ItemKind.LAND, Part.LAND, "land", landing_position))
    items.append(MissionItem(ItemKind.SPEED, Part.END, "end", None, home_speed_mps))
    return ReturnByDefaultMission(
        items=tuple(items),
        takeoff=0,
        settle=1,
        outbound=outbound_items,
        entry_of_outbound=tuple(ret_start + entry for entry in return_entry_by_outbound),
        deliver=deliver,
        release=deliver + 1,
        delay=deliver + 2,
        returning=tuple(range(ret_start, land)),
        land=land,
        rally=tuple(rally_items),
        pad_return=tuple(range(3, 3 + len(pad_to_other_home_route))),
        setpoint_items=tuple(asides),
    )


def _setpoint_items(target_index: int, time_limit_s: float) -> list[MissionItem]:
    """Return the items for set-points before a target: limited in time, then the target itself."""
    return [
        MissionItem(ItemKind.ASIDE_LIMIT, Part.ASIDE, "set-point limits", None, time_limit_s),
        MissionItem(ItemKind.ASIDE, Part.ASIDE, "set-points", None, 1.0),
        MissionItem(ItemKind.JUMP, Part.ASIDE, f"on to {target_index}", None, float(target_index)),
    ]


DEGREES_TOLERANCE = 3e-7
HEIGHT_TOLERANCE_M = 0.02
VALUE_TOLERANCE = 0.02


def mission_differences(
    expected_items: Sequence[MissionItem], onboard_items: Sequence[MissionItem]
) -> tuple[str, ...]:
    """List the differences between the downloaded mission and the uploaded one; empty if none.

    Both are numbered and encoded as uploaded. The adapter has undone or ignored every change that
    an autopilot is known to make (frames, NaN, radius, home item), so any remaining difference
    changes the flight.
    """
    found: list[str] = []
    if len(expected_items) != len(onboard_items):
        found.append(f"{len(onboard_items)} items onboard, {len(expected_items)} uploaded")
    for index, (expected, onboard) in enumerate(zip(expected_items, onboard_items, strict=False)):
        name = f"item {index} ({expected.label or expected.kind.value})"
        if expected.kind is not onboard.kind:
            found.append(f"{name}: {onboard.kind.value} onboard, expected {expected.kind.value}")
            continue
        if not abs(expected.value - onboard.value) <= VALUE_TOLERANCE:
            found.append(f"{name}: value {onboard.value:g} onboard, expected {expected.value:g}")
        if expected.kind is ItemKind.TAKEOFF:
            # Both autopilots climb vertically; they do not keep the position of a takeoff item.
            if not _is_height_within_tolerance(expected.spot, onboard.spot):
                found.append(f"{name}: another height onboard")
        elif (expected.kind in POSITIONED_KINDS) and not _is_position_within_tolerance(
            expected.spot, onboard.spot
        ):
            found.append(
                f"{name}: another position onboard ({onboard.spot}, expected {expected.spot})"
            )
    return tuple(found)


def _is_height_within_tolerance(
    expected: MissionPosition | None, onboard: MissionPosition | None
) -> bool:
    if expected is None or onboard is None:
        return expected is onboard
    return abs(expected.height_rel_m - onboard.height_rel_m) <= HEIGHT_TOLERANCE_M


def _is_position_within_tolerance(
    expected: MissionPosition | None, onboard: MissionPosition | None
) -> bool:
    if expected is None or onboard is None:
        return expected is onboard
    return (
        abs(expected.lat_deg - onboard.lat_deg) <= DEGREES_TOLERANCE
        and abs(expected.lon_deg - onboard.lon_deg) <= DEGREES_TOLERANCE
        and _is_height_within_tolerance(expected, onboard)
    )
