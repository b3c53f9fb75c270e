"""From a plan and where the vehicle is to the gate's question: what is left to fly.

Every decision point has the ways home that the mission aboard really holds: the return branch
entered at `Plan.entry`, and each rally point: by a straight line where it is in clear sight, or
else along the return branch to the waypoint from which it is. Where the way back is flown at
another height, each way home changes height first, straight up or down: what the autopilot does
on its way there takes no longer.
"""

from itertools import pairwise

from companion.core.base.geo import Ned, horizontal_m, over
from companion.core.return_budget.remaining_mission import Ahead, Stage, WayHome
from companion.core.routing.leg_energy import OVER_M, Leg, LegKind, cruise_legs
from companion.core.routing.route_planner import DEPOT, Plan, RallyWay, unattended

__all__ = ["DEPOT", "ahead_away", "ahead_delivering", "ahead_outbound", "ahead_returning"]


def ahead_outbound(
    plan: Plan,
    position_ned_m: Ned,
    next_index: int,
    payload_kg: float,
    drop_height_m: float,
    drop_s: float,
    settle_left_s: float = 0.0,
) -> Ahead:
    """Still outbound, flying to `plan.outbound_ned_m[next_index]` (take-off and settle included
    when the vehicle is low over the depot). The decision points are the outbound waypoints.

    Turning back now is priced straight to the return branch's entry of the waypoint behind; from
    the first leg to the depot, or to a home elsewhere by the way that leads there from over it.
    """
    start = _lifted(position_ned_m, plan.outbound_ned_m, next_index)
    first = _rise(position_ned_m, start, payload_kg)
    if settle_left_s > 0.0:
        first += (Leg(LegKind.HOVER, start, start, payload_kg, settle_left_s),)
    stages: list[Stage] = []
    here = start
    for index in range(next_index, len(plan.outbound_ned_m)):
        there = plan.outbound_ned_m[index]
        legs = (*first, *cruise_legs(here, there, payload_kg))
        stages.append(Stage(legs, ways_from_outbound(plan, index, payload_kg)))
        first, here = (), there
    stages.append(_delivery(plan, here, payload_kg, drop_height_m, drop_s))
    return Ahead(
        _ways_now(plan, position_ned_m, start, next_index, payload_kg),
        tuple(stages),
    )


def ahead_delivering(
    plan: Plan,
    position_ned_m: Ned,
    payload_kg: float,
    drop_height_m: float,
    drop_s: float,
) -> Ahead:
    """At the customer, parcel still aboard: descend, drop, climb, return."""
    above = plan.over_customer_ned_m
    change = _change(plan, position_ned_m, above, payload_kg)
    last = len(plan.outbound_ned_m) - 1
    now = tuple(_after(change, way) for way in _ways_from(plan, above, last, payload_kg))
    return Ahead(now, (_delivery(plan, position_ned_m, payload_kg, drop_height_m, drop_s),))


def ahead_returning(
    plan: Plan,
    position_ned_m: Ned,
    return_index: int | None,
    payload_kg: float,
    delivered: bool,
    rally_name: str | None = None,
) -> Ahead:
    """On the way back to `plan.return_ned_m[return_index]` (None: on the last descent), or on
    the way to a rally point. `payload_kg` 0 once the release is confirmed.
    """
    if return_index is None:
        ground = next((r.ground_ned_m for r in plan.rally if r.name == rally_name), None)
        landing = rally_name if ground is not None and rally_name is not None else plan.landing
        ground = ground or plan.landing_ned_m
        # A descent drifts little: land from straight above, cruising what is left sideways.
        above = over(ground, position_ned_m)
        legs = (*cruise_legs(position_ned_m, above, payload_kg), _land(above, ground, payload_kg))
        return Ahead((_way(landing, legs, plan.home_ground_speed_mps),), (), delivered)
    start = _lifted(position_ned_m, plan.return_ned_m, return_index)
    rise = _rise(position_ned_m, start, payload_kg)
    if rally_name is not None and plan.home is not None:
        return _ahead_bound(plan, start, rise, rally_name, payload_kg, delivered)
    ways = list(_ways_home(plan, start, return_index, payload_kg))
    if return_index > 0:
        ways += _rally_ways(plan, start, None, return_index - 1, return_index, payload_kg)
    else:
        last = len(plan.outbound_ned_m) - 1
        ways += _rally_ways(plan, start, last, None, return_index, payload_kg)
    if rally_name is not None and all(way.landing != rally_name for way in ways):
        rally = next(r for r in plan.rally if r.name == rally_name)
        ways.append(_rally_way(plan, (start,), rally, payload_kg))
    return Ahead(tuple(_after(rise, way) for way in ways), (), delivered)


def _ahead_bound(
    plan: Plan,
    start: Ned,
    rise: tuple[Leg, ...],
    name: str,
    payload_kg: float,
    delivered: bool,
) -> Ahead:
    """On a straight way to one of the landing sites beside home."""
    rally = next(r for r in plan.rally if r.name == name)
    way = _rally_way(plan, (start,), rally, payload_kg)
    return Ahead((_after(rise, way),), (), delivered)


def ahead_away(
    plan: Plan, position_ned_m: Ned, away_index: int, payload_kg: float, delivered: bool
) -> Ahead:
    """On the way from the launch pad to a home elsewhere, to `plan.away_ned_m[away_index]`."""
    points = (*plan.away_ned_m, plan.return_ned_m[-1])
    start = _lifted(position_ned_m, points, away_index)
    rise = _rise(position_ned_m, start, payload_kg)
    way = _way_by(plan, (start, *points[away_index:]), payload_kg)
    return Ahead((_after(rise, way),), (), delivered)


def ways_from_outbound(plan: Plan, index: int, payload_kg: float) -> tuple[WayHome, ...]:
    """Ways home from an outbound waypoint: the return branch, then each rally point."""
    here = plan.outbound_ned_m[index]
    start = over(here, plan.return_ned_m[plan.entry[index]])
    change = _change(plan, here, start, payload_kg)
    return tuple(_after(change, way) for way in _ways_from(plan, start, index, payload_kg))


def _ways_from(plan: Plan, start: Ned, index: int, payload_kg: float) -> tuple[WayHome, ...]:
    """The same from there at the height of the way back."""
    entry = plan.entry[index]
    ways = _ways_home(plan, start, entry, payload_kg)
    return (*ways, *_rally_ways(plan, start, index, None, entry, payload_kg))


def _ways_now(
    plan: Plan, position: Ned, start: Ned, next_index: int, payload_kg: float
) -> tuple[WayHome, ...]:
    """Turning round in the leg to `next_index`, back where it came from."""
    rise = _rise(position, start, payload_kg)
    if plan.layered or (next_index == 0 and plan.away_ned_m):
        return _ways_now_changing(plan, start, rise, next_index, payload_kg)
    if next_index == 0:
        above = over(plan.depot_ned_m, start)
        if horizontal_m(position, above) <= OVER_M:  # still over the depot: straight down
            legs = (_land(over(above, position), plan.landing_ned_m, payload_kg),)
            return (_way(plan.landing, legs, plan.home_ground_speed_mps),)
        legs = (
            *cruise_legs(start, above, payload_kg),
            _land(above, plan.landing_ned_m, payload_kg),
        )
        ways: tuple[WayHome, ...] = (_way(plan.landing, legs, plan.home_ground_speed_mps),)
        ways = (*ways, *_rally_ways(plan, start, None, None, None, payload_kg))
    else:
        entry = plan.entry[next_index - 1]
        ways = _ways_home(plan, start, entry, payload_kg)
        ways = (*ways, *_rally_ways(plan, start, next_index - 1, None, entry, payload_kg))
    return tuple(_after(rise, way) for way in ways)


def _ways_now_changing(
    plan: Plan, start: Ned, rise: tuple[Leg, ...], next_index: int, payload_kg: float
) -> tuple[WayHome, ...]:
    """Turning round into a way home at another height, or to a home that is not the launch pad."""
    if next_index > 0:
        onward = (plan.return_ned_m[plan.entry[next_index - 1]],)
    else:
        onward = (*plan.away_ned_m[1:], plan.return_ned_m[-1])
    level = over(start, onward[0])
    change = (*rise, *_change(plan, start, level, payload_kg))
    if next_index > 0:
        ways = _ways_from(plan, level, next_index - 1, payload_kg)
    else:
        ways = (_way_by(plan, (level, *onward), payload_kg),)
    return tuple(_after(change, way) for way in ways)


def _ways_home(plan: Plan, here: Ned, entry: int, payload_kg: float) -> tuple[WayHome, ...]:
    return (_way_by(plan, (here, *plan.return_ned_m[entry:]), payload_kg),)


def _way_by(plan: Plan, points: tuple[Ned, ...], payload_kg: float) -> WayHome:
    """Along these points, and down at home, below the last."""
    legs = [leg for a, b in pairwise(points) for leg in cruise_legs(a, b, payload_kg)]
    legs.append(_land(points[-1], plan.landing_ned_m, payload_kg))
    return _way(plan.landing, tuple(legs), plan.home_ground_speed_mps)


def _rally_ways(
    plan: Plan,
    here: Ned,
    outbound: int | None,
    homeward: int | None,
    entry: int | None,
    payload_kg: float,
) -> tuple[WayHome, ...]:
    """A way to each rally point that is seen from the waypoint `outbound` or `homeward`; to one
    that is not, along the return branch from `entry` until it is.
    """
    ways: list[WayHome] = []
    for rally in plan.rally:
        if outbound in rally.from_outbound or homeward in rally.from_return:
            ways.append(_rally_way(plan, (here,), rally, payload_kg))
        elif entry is not None and (via := _shortest_via(plan, here, entry, rally)):
            ways.append(_rally_way(plan, via, rally, payload_kg))
    return tuple(ways)


def _shortest_via(plan: Plan, here: Ned, entry: int, rally: RallyWay) -> tuple[Ned, ...]:
    """Along the return branch to where the rally point is nearest in sight; empty: it never is."""
    paths = [
        (here, *plan.return_ned_m[entry : index + 1])
        for index in rally.from_return
        if index >= entry
    ]
    above = over(rally.ground_ned_m, here)
    return min(paths, key=lambda path: _length_m((*path, above)), default=())


def _length_m(path: tuple[Ned, ...]) -> float:
    return sum(horizontal_m(a, b) for a, b in pairwise(path))


def _rally_way(plan: Plan, path: tuple[Ned, ...], rally: RallyWay, payload_kg: float) -> WayHome:
    above = rally.above(path[-1])
    legs = [leg for a, b in pairwise((*path, above)) for leg in cruise_legs(a, b, payload_kg)]
    land = _land(above, rally.ground_ned_m, payload_kg)
    return _way(rally.name, (*legs, land), plan.home_ground_speed_mps)


def _delivery(
    plan: Plan, start: Ned, payload_kg: float, drop_height_m: float, drop_s: float
) -> Stage:
    above = plan.outbound_ned_m[-1]
    drop = (above[0], above[1], plan.customer_ned_m[2] - drop_height_m)
    down = (above[0], above[1], min(start[2], drop[2]))
    legs = (
        Leg(LegKind.DESCEND, down, drop, payload_kg),
        Leg(LegKind.HOVER, drop, drop, payload_kg, drop_s),
    )
    back = plan.over_customer_ned_m
    climb = (Leg(LegKind.CLIMB, drop, back, 0.0),)
    last = len(plan.outbound_ned_m) - 1
    ways = tuple(_after(climb, way) for way in _ways_from(plan, back, last, 0.0))
    return Stage(legs, ways, delivers=True)


def _way(landing: str, legs: tuple[Leg, ...], ground_speed_mps: float) -> WayHome:
    return WayHome(landing, legs, tuple(unattended(leg, ground_speed_mps) for leg in legs))


def _after(legs: tuple[Leg, ...], way: WayHome) -> WayHome:
    if not legs:
        return way
    return WayHome(way.landing, (*legs, *way.legs), (*legs, *way.unattended_legs))


def _lifted(position: Ned, points: tuple[Ned, ...], to: int) -> Ned:
    """At least as high as the lower end of the leg to `points[to]`."""
    low = max(points[max(to - 1, 0)][2], points[to][2])
    return position[0], position[1], min(position[2], low)


def _change(plan: Plan, position: Ned, to: Ned, payload_kg: float) -> tuple[Leg, ...]:
    """Up, or down where the way back is the lower layer."""
    if plan.layered and to[2] - position[2] > OVER_M:
        return (Leg(LegKind.DESCEND, position, to, payload_kg),)
    return _rise(position, to, payload_kg)


def _rise(position: Ned, to: Ned, payload_kg: float) -> tuple[Leg, ...]:
    if position[2] - to[2] <= OVER_M:
        return ()
    return (Leg(LegKind.CLIMB, position, to, payload_kg),)


def _land(above: Ned, ground: Ned, payload_kg: float) -> Leg:
    return Leg(LegKind.LAND, above, ground, payload_kg)
