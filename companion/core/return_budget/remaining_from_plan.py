"""Remaining mission, the input of the gate, from a plan and the position of the vehicle.

Every decision point has the routes home of the uploaded mission: the return branch entered at
`Plan.entry`, and each rally point. A rally point is reached by a straight line where that is
clear, else along the return branch to a waypoint from which it is. Where the return is flown at
another height, each route home begins with a vertical change of height: an upper bound on the time
that the autopilot takes to change height along its route.
"""

from itertools import pairwise

from companion.core.base.geo import Ned, horizontal_distance_m, point_above
from companion.core.return_budget.remaining_mission import RemainingMission, ReturnRoute, Stage
from companion.core.routing.leg_energy import MIN_LEG_M, Leg, LegKind, cruise_leg_unless_too_short
from companion.core.routing.route_planner import DEPOT, Plan, RallySite, to_fixed_ground_speed_leg

__all__ = [
    "DEPOT",
    "remaining_delivery",
    "remaining_outbound",
    "remaining_return",
    "remaining_to_other_home",
]


def remaining_outbound(
    plan: Plan,
    position_ned_m: Ned,
    next_waypoint_index: int,
    payload_kg: float,
    drop_height_m: float,
    drop_hover_s: float,
    remaining_settle_s: float = 0.0,
) -> RemainingMission:
    """Return the mission from the leg to `plan.outbound_ned_m[next_waypoint_index]`, with take-off
    and hover while low over the depot. The outbound waypoints are the decision points.

    Turning back now leads straight to the return branch at the entry of the previous waypoint, on
    the first leg to the depot or along `plan.away_ned_m` to another home.
    """
    start = _raise_to_lower_leg_end(position_ned_m, plan.outbound_ned_m, next_waypoint_index)
    first = _climb_legs(position_ned_m, start, payload_kg)
    if remaining_settle_s > 0.0:
        first += (Leg(LegKind.HOVER, start, start, payload_kg, remaining_settle_s),)
    stages: list[Stage] = []
    here = start
    for index in range(next_waypoint_index, len(plan.outbound_ned_m)):
        waypoint = plan.outbound_ned_m[index]
        leg_sequence = (*first, *cruise_leg_unless_too_short(here, waypoint, payload_kg))
        stages.append(Stage(leg_sequence, return_routes_from_outbound(plan, index, payload_kg)))
        first, here = (), waypoint
    stages.append(_delivery_stage(plan, here, payload_kg, drop_height_m, drop_hover_s))
    return RemainingMission(
        _return_routes_from_outbound_leg(
            plan, position_ned_m, start, next_waypoint_index, payload_kg
        ),
        tuple(stages),
    )


def remaining_delivery(
    plan: Plan,
    position_ned_m: Ned,
    payload_kg: float,
    drop_height_m: float,
    drop_hover_s: float,
) -> RemainingMission:
    """Return the remaining mission at the customer: descend, drop, climb, return."""
    above = plan.return_route_start_ned_m
    change = _height_change_legs(plan, position_ned_m, above, payload_kg)
    last = len(plan.outbound_ned_m) - 1
    now = tuple(
        _prepend_leg_sequence(change, route)
        for route in _return_routes_from(plan, above, last, payload_kg)
    )
    return RemainingMission(
        now, (_delivery_stage(plan, position_ned_m, payload_kg, drop_height_m, drop_hover_s),)
    )


def remaining_return(
    plan: Plan,
    position_ned_m: Ned,
    return_index: int | None,
    payload_kg: float,
    delivered: bool,
    rally_name: str | None = None,
) -> RemainingMission:
    """Return the remaining mission towards `plan.return_ned_m[return_index]` (None: in the last
    descent), or towards a rally point. `payload_kg` is 0 once the release is confirmed.
    """
    if return_index is None:
        ground = next((r.ground_ned_m for r in plan.rally if r.name == rally_name), None)
        landing = (
            rally_name
            if ground is not None and rally_name is not None
            else plan.return_route_end_name
        )
        ground = ground or plan.return_route_end_ground_ned_m
        # A descent drifts little: cruise over the site, then land vertically.
        above = point_above(ground, position_ned_m)
        leg_sequence = (
            *cruise_leg_unless_too_short(position_ned_m, above, payload_kg),
            _landing_leg(above, ground, payload_kg),
        )
        return RemainingMission(
            (_build_route_with_unattended_legs(landing, leg_sequence, plan.home_ground_speed_mps),),
            (),
            delivered,
        )
    start = _raise_to_lower_leg_end(position_ned_m, plan.return_ned_m, return_index)
    rise = _climb_legs(position_ned_m, start, payload_kg)
    if rally_name is not None and plan.home is not None:
        return _remaining_to_site(plan, start, rise, rally_name, payload_kg, delivered)
    routes = list(_return_branch_routes(plan, start, return_index, payload_kg))
    if return_index > 0:
        routes += _rally_routes(plan, start, None, return_index - 1, return_index, payload_kg)
    else:
        last = len(plan.outbound_ned_m) - 1
        routes += _rally_routes(plan, start, last, None, return_index, payload_kg)
    if rally_name is not None and all(route.landing != rally_name for route in routes):
        rally = next(r for r in plan.rally if r.name == rally_name)
        routes.append(_build_rally_route(plan, (start,), rally, payload_kg))
    return RemainingMission(
        tuple(_prepend_leg_sequence(rise, route) for route in routes), (), delivered
    )


def _remaining_to_site(
    plan: Plan,
    start_ned_m: Ned,
    climb_legs: tuple[Leg, ...],
    site_name: str,
    payload_kg: float,
    delivered: bool,
) -> RemainingMission:
    """Return the remaining mission on a straight line to a landing site other than home."""
    rally = next(r for r in plan.rally if r.name == site_name)
    route = _build_rally_route(plan, (start_ned_m,), rally, payload_kg)
    return RemainingMission((_prepend_leg_sequence(climb_legs, route),), (), delivered)


def remaining_to_other_home(
    plan: Plan, position_ned_m: Ned, away_index: int, payload_kg: float, delivered: bool
) -> RemainingMission:
    """Return the remaining mission from the launch pad to another home, by `away_ned_m`."""
    points = (*plan.away_ned_m, plan.return_ned_m[-1])
    start = _raise_to_lower_leg_end(position_ned_m, points, away_index)
    rise = _climb_legs(position_ned_m, start, payload_kg)
    route = _build_home_route(plan, (start, *points[away_index:]), payload_kg)
    return RemainingMission((_prepend_leg_sequence(rise, route),), (), delivered)


def return_routes_from_outbound(
    plan: Plan, waypoint_index: int, payload_kg: float
) -> tuple[ReturnRoute, ...]:
    """Return the routes home from an outbound waypoint: return branch, then each rally point."""
    here = plan.outbound_ned_m[waypoint_index]
    start = point_above(here, plan.return_ned_m[plan.entry[waypoint_index]])
    change = _height_change_legs(plan, here, start, payload_kg)
    return tuple(
        _prepend_leg_sequence(change, route)
        for route in _return_routes_from(plan, start, waypoint_index, payload_kg)
    )


def _return_routes_from(
    plan: Plan, start_ned_m: Ned, outbound_index: int, payload_kg: float
) -> tuple[ReturnRoute, ...]:
    """Return the routes home from `start_ned_m`, at the height of the return route."""
    entry = plan.entry[outbound_index]
    routes = _return_branch_routes(plan, start_ned_m, entry, payload_kg)
    return (*routes, *_rally_routes(plan, start_ned_m, outbound_index, None, entry, payload_kg))


def _return_routes_from_outbound_leg(
    plan: Plan, position_ned_m: Ned, start_ned_m: Ned, next_waypoint_index: int, payload_kg: float
) -> tuple[ReturnRoute, ...]:
    """Return the routes home of a vehicle that turns back in the leg to `next_waypoint_index`."""
    rise = _climb_legs(position_ned_m, start_ned_m, payload_kg)
    if plan.has_waypoints_at_different_heights or (next_waypoint_index == 0 and plan.away_ned_m):
        return _return_routes_with_height_change(
            plan, start_ned_m, rise, next_waypoint_index, payload_kg
        )
    if next_waypoint_index == 0:
        above = point_above(plan.depot_ned_m, start_ned_m)
        if (
            horizontal_distance_m(position_ned_m, above) <= MIN_LEG_M
        ):  # over the depot: land vertically
            leg_sequence = (
                _landing_leg(
                    point_above(above, position_ned_m),
                    plan.return_route_end_ground_ned_m,
                    payload_kg,
                ),
            )
            return (
                _build_route_with_unattended_legs(
                    plan.return_route_end_name, leg_sequence, plan.home_ground_speed_mps
                ),
            )
        leg_sequence = (
            *cruise_leg_unless_too_short(start_ned_m, above, payload_kg),
            _landing_leg(above, plan.return_route_end_ground_ned_m, payload_kg),
        )
        routes: tuple[ReturnRoute, ...] = (
            _build_route_with_unattended_legs(
                plan.return_route_end_name, leg_sequence, plan.home_ground_speed_mps
            ),
        )
        routes = (*routes, *_rally_routes(plan, start_ned_m, None, None, None, payload_kg))
    else:
        entry = plan.entry[next_waypoint_index - 1]
        routes = _return_branch_routes(plan, start_ned_m, entry, payload_kg)
        routes = (
            *routes,
            *_rally_routes(plan, start_ned_m, next_waypoint_index - 1, None, entry, payload_kg),
        )
    return tuple(_prepend_leg_sequence(rise, route) for route in routes)


def _return_routes_with_height_change(
    plan: Plan,
    start_ned_m: Ned,
    climb_legs: tuple[Leg, ...],
    next_waypoint_index: int,
    payload_kg: float,
) -> tuple[ReturnRoute, ...]:
    """Return routes home at another height, or to a home that is not the launch pad."""
    if next_waypoint_index > 0:
        onward = (plan.return_ned_m[plan.entry[next_waypoint_index - 1]],)
    else:
        onward = (*plan.away_ned_m[1:], plan.return_ned_m[-1])
    level = point_above(start_ned_m, onward[0])
    change = (*climb_legs, *_height_change_legs(plan, start_ned_m, level, payload_kg))
    if next_waypoint_index > 0:
        routes = _return_routes_from(plan, level, next_waypoint_index - 1, payload_kg)
    else:
        routes = (_build_home_route(plan, (level, *onward), payload_kg),)
    return tuple(_prepend_leg_sequence(change, route) for route in routes)


def _return_branch_routes(
    plan: Plan, start_ned_m: Ned, entry_index: int, payload_kg: float
) -> tuple[ReturnRoute, ...]:
    return (_build_home_route(plan, (start_ned_m, *plan.return_ned_m[entry_index:]), payload_kg),)


def _build_home_route(
    plan: Plan, route_points_ned_m: tuple[Ned, ...], payload_kg: float
) -> ReturnRoute:
    """Return the route along these points that lands at home, below the last."""
    leg_sequence = [
        leg
        for a, b in pairwise(route_points_ned_m)
        for leg in cruise_leg_unless_too_short(a, b, payload_kg)
    ]
    leg_sequence.append(
        _landing_leg(route_points_ned_m[-1], plan.return_route_end_ground_ned_m, payload_kg)
    )
    return _build_route_with_unattended_legs(
        plan.return_route_end_name, tuple(leg_sequence), plan.home_ground_speed_mps
    )


def _rally_routes(
    plan: Plan,
    start_ned_m: Ned,
    outbound_index: int | None,
    return_index: int | None,
    entry_index: int | None,
    payload_kg: float,
) -> tuple[ReturnRoute, ...]:
    """Return a route to each rally point with a clear line from waypoint `outbound_index` or
    `return_index`; to another one along the return branch from `entry_index` to a waypoint with a
    clear line.
    """
    routes: list[ReturnRoute] = []
    for rally in plan.rally:
        if outbound_index in rally.from_outbound or return_index in rally.from_return:
            routes.append(_build_rally_route(plan, (start_ned_m,), rally, payload_kg))
        elif entry_index is not None and (
            branch_path := _shortest_branch_path(plan, start_ned_m, entry_index, rally)
        ):
            routes.append(_build_rally_route(plan, branch_path, rally, payload_kg))
    return tuple(routes)


def _shortest_branch_path(
    plan: Plan, start_ned_m: Ned, entry_index: int, rally: RallySite
) -> tuple[Ned, ...]:
    """Return the shortest path by the return branch to a clear line to the rally point, or ()."""
    paths = [
        (start_ned_m, *plan.return_ned_m[entry_index : index + 1])
        for index in rally.from_return
        if index >= entry_index
    ]
    above = point_above(rally.ground_ned_m, start_ned_m)
    return min(paths, key=lambda path: _path_length_m((*path, above)), default=())


def _path_length_m(path: tuple[Ned, ...]) -> float:
    return sum(horizontal_distance_m(a, b) for a, b in pairwise(path))


def _build_rally_route(
    plan: Plan, path: tuple[Ned, ...], rally: RallySite, payload_kg: float
) -> ReturnRoute:
    above = rally.arrival_point_above_site(path[-1])
    leg_sequence = [
        leg
        for a, b in pairwise((*path, above))
        for leg in cruise_leg_unless_too_short(a, b, payload_kg)
    ]
    land = _landing_leg(above, rally.ground_ned_m, payload_kg)
    return _build_route_with_unattended_legs(
        rally.name, (*leg_sequence, land), plan.home_ground_speed_mps
    )


def _delivery_stage(
    plan: Plan, start_ned_m: Ned, payload_kg: float, drop_height_m: float, drop_hover_s: float
) -> Stage:
    above = plan.outbound_ned_m[-1]
    drop = (above[0], above[1], plan.customer_ned_m[2] - drop_height_m)
    down = (above[0], above[1], min(start_ned_m[2], drop[2]))
    leg_sequence = (
        Leg(LegKind.DESCEND, down, drop, payload_kg),
        Leg(LegKind.HOVER, drop, drop, payload_kg, drop_hover_s),
    )
    back = plan.return_route_start_ned_m
    climb = (Leg(LegKind.CLIMB, drop, back, 0.0),)
    last = len(plan.outbound_ned_m) - 1
    routes = tuple(
        _prepend_leg_sequence(climb, route) for route in _return_routes_from(plan, back, last, 0.0)
    )
    return Stage(leg_sequence, routes, delivers=True)


def _build_route_with_unattended_legs(
    landing_name: str, leg_sequence: tuple[Leg, ...], ground_speed_mps: float
) -> ReturnRoute:
    return ReturnRoute(
        landing_name,
        leg_sequence,
        tuple(to_fixed_ground_speed_leg(leg, ground_speed_mps) for leg in leg_sequence),
    )


def _prepend_leg_sequence(leg_sequence: tuple[Leg, ...], route: ReturnRoute) -> ReturnRoute:
    if not leg_sequence:
        return route
    return ReturnRoute(
        route.landing,
        (*leg_sequence, *route.leg_sequence),
        (*leg_sequence, *route.unattended_sequence),
    )


def _raise_to_lower_leg_end(position_ned_m: Ned, points: tuple[Ned, ...], target_index: int) -> Ned:
    """Return the position, at least at the lower end of the leg to `points[target_index]`."""
    low = max(points[max(target_index - 1, 0)][2], points[target_index][2])
    return position_ned_m[0], position_ned_m[1], min(position_ned_m[2], low)


def _height_change_legs(
    plan: Plan, position_ned_m: Ned, target_ned_m: Ned, payload_kg: float
) -> tuple[Leg, ...]:
    """Return the vertical leg to the height of `target_ned_m`; a descent only in a layered plan."""
    if plan.has_waypoints_at_different_heights and target_ned_m[2] - position_ned_m[2] > MIN_LEG_M:
        return (Leg(LegKind.DESCEND, position_ned_m, target_ned_m, payload_kg),)
    return _climb_legs(position_ned_m, target_ned_m, payload_kg)


def _climb_legs(position_ned_m: Ned, target_ned_m: Ned, payload_kg: float) -> tuple[Leg, ...]:
    if position_ned_m[2] - target_ned_m[2] <= MIN_LEG_M:
        return ()
    return (Leg(LegKind.CLIMB, position_ned_m, target_ned_m, payload_kg),)


def _landing_leg(overhead_ned_m: Ned, ground_ned_m: Ned, payload_kg: float) -> Leg:
    return Leg(LegKind.LAND, overhead_ned_m, ground_ned_m, payload_kg)
