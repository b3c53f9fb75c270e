"""A route's corners flown at full speed: the time that turning costs, and the heading change.

One turn rounds a corner: it leaves the first leg before the waypoint and meets the second after it.
In wind the turn is a circle in the air and a trochoid over the ground. With air headings `psi` that
hold both courses, its displacement is `d = 2 R sin(|dpsi| / 2) u(psi_mid) + w T`,
`T = |dpsi| R / V`. Then `d = a u(in) + b u(out)` gives its begin and end in closed form. Where legs
are too short, a Dubins path joins the first leg to the second instead.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats
from sim_bridge.research.dubins.airplane import join_poses
from sim_bridge.research.dubins.limits import FlightLimits, require_air_faster

WINDOW_S = 2.0
"""Window of max turn, the largest heading change within it (docs/reference/outcomes.md)."""

_STRAIGHT_RAD = 1e-6
_SAMPLES = 17


@dataclass(frozen=True, slots=True)
class Corners:
    """n corners as flown; arrays (n,).

    `extra_s`: time compared with flying both legs to the corner and away from it; mostly negative
    where it is cut. `before_m` and `after_m`: distance along the legs, from the waypoint, at which
    the turn begins and ends. `off_m`: least distance from the waypoint. `turn_rad`: largest change
    of air heading within 2 s. `cut`: flown by one turn; else by a Dubins path.
    """

    extra_s: Floats
    before_m: Floats
    after_m: Floats
    off_m: Floats
    turn_rad: Floats
    cut: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class _Course:
    """A course over the ground, with the air heading and ground speed that hold it."""

    unit_n: Floats
    unit_e: Floats
    heading_rad: Floats
    ground_mps: Floats


def held_course(course_rad: Floats, airspeed_mps: float, wind_to_ne_mps: Floats) -> _Course:
    """Air heading and ground speed along each course (wind triangle); NaN where none holds it."""
    unit_n, unit_e = np.cos(course_rad), np.sin(course_rad)
    along = wind_to_ne_mps[..., 0] * unit_n + wind_to_ne_mps[..., 1] * unit_e
    across = wind_to_ne_mps[..., 1] * unit_n - wind_to_ne_mps[..., 0] * unit_e
    crab = np.arcsin(across / airspeed_mps)
    return _Course(unit_n, unit_e, course_rad - crab, airspeed_mps * np.cos(crab) + along)


def round_corners(
    course_in_rad: Floats,
    course_out_rad: Floats,
    room_in_m: Floats,
    room_out_m: Floats,
    limits: FlightLimits,
    wind_to_ne_mps: Floats,
) -> Corners:
    """Round every corner at the limits' airspeed and radius; all arrays (n,).

    `room_in_m` and `room_out_m`: length of each leg that the turn may use. Raises LeewayError for
    wind as fast as the airspeed.
    """
    count = len(course_in_rad)
    wind = np.broadcast_to(wind_to_ne_mps, (count, 2))
    require_air_faster(limits.airspeed_mps, wind)
    first = held_course(course_in_rad, limits.airspeed_mps, wind)
    last = held_course(course_out_rad, limits.airspeed_mps, wind)
    corners = _cut(first, last, limits, wind)
    fits = (corners.before_m >= 0.0) & (corners.after_m >= 0.0)
    fits &= (corners.before_m <= room_in_m) & (corners.after_m <= room_out_m)
    rows = np.flatnonzero(~fits)
    corners.cut[rows] = False
    if len(rows):
        _join(rows, corners, first, last, room_in_m, room_out_m, limits, wind)
    return corners


def _cut(first: _Course, last: _Course, limits: FlightLimits, wind: Floats) -> Corners:
    radius, speed = limits.turn_radius_m, limits.airspeed_mps
    change = np.remainder(last.heading_rad - first.heading_rad + np.pi, 2.0 * np.pi) - np.pi
    time = np.abs(change) * radius / speed
    away_n, away_e = _along_arc(first.heading_rad, change, np.ones(1), radius, time, wind)
    n, e = away_n[:, 0], away_e[:, 0]
    sine = first.unit_n * last.unit_e - first.unit_e * last.unit_n
    straight = np.abs(change) < _STRAIGHT_RAD
    with np.errstate(divide="ignore", invalid="ignore"):
        before = np.where(straight, 0.0, (n * last.unit_e - e * last.unit_n) / sine)
        after = np.where(straight, 0.0, (first.unit_n * e - first.unit_e * n) / sine)
    before, after = (np.where(np.isfinite(x), x, np.inf) for x in (before, after))
    shares = np.linspace(0.0, 1.0, _SAMPLES)
    path_n, path_e = _along_arc(first.heading_rad, change, shares, radius, time, wind)
    with np.errstate(invalid="ignore"):
        off = np.hypot(
            path_n - (before * first.unit_n)[:, None], path_e - (before * first.unit_e)[:, None]
        ).min(axis=1)
        extra = time - before / first.ground_mps - after / last.ground_mps
    return Corners(
        extra_s=extra,
        before_m=before,
        after_m=after,
        off_m=off,
        turn_rad=np.minimum(np.abs(change), limits.turn_rate_rps * WINDOW_S),
        cut=np.ones(len(time), np.bool_),
    )


def _along_arc(
    heading: Floats, change: Floats, share: Floats, radius: float, time: Floats, wind: Floats
) -> tuple[Floats, Floats]:
    """Displacement over the ground (north, east) after each share of a turn; (n, k) each."""
    angle = change[:, None] * share
    chord = 2.0 * radius * np.sin(0.5 * np.abs(angle))
    middle = heading[:, None] + 0.5 * angle
    seconds = time[:, None] * share
    return (
        chord * np.cos(middle) + wind[:, :1] * seconds,
        chord * np.sin(middle) + wind[:, 1:] * seconds,
    )


def _join(
    rows: NDArray[np.int64],
    corners: Corners,
    first: _Course,
    last: _Course,
    room_in_m: Floats,
    room_out_m: Floats,
    limits: FlightLimits,
    wind: Floats,
) -> None:
    """Fly the corners at `rows` as Dubins paths that use all the room."""
    before, after = room_in_m[rows], room_out_m[rows]
    zero = np.zeros(len(rows))
    start = np.stack(
        [-before * first.unit_n[rows], -before * first.unit_e[rows], zero, first.heading_rad[rows]],
        axis=1,
    )
    goal = np.stack(
        [after * last.unit_n[rows], after * last.unit_e[rows], zero, last.heading_rad[rows]], axis=1
    )
    paths = join_poses(start, goal, limits, wind[rows])
    legs_s = before / first.ground_mps[rows] + after / last.ground_mps[rows]
    times = paths.time_s[:, None] * np.linspace(0.0, 1.0, 4 * _SAMPLES)
    poses = paths.at(times)
    window = np.minimum(times + WINDOW_S, paths.time_s[:, None])
    turned = np.abs(paths.at(window)[..., 3] - poses[..., 3]).max(axis=1)
    corners.extra_s[rows] = paths.time_s - legs_s
    corners.before_m[rows], corners.after_m[rows] = before, after
    corners.off_m[rows] = np.hypot(poses[..., 0], poses[..., 1]).min(axis=1)
    corners.turn_rad[rows] = turned


def stopping_s(turn_rad: Floats, speed_mps: float, accel_mps2: float) -> Floats:
    """Time lost at a corner flown without rounding.

    The velocity component lost in the turn is braked and regained, as `route_energy` prices it.
    """
    return 0.5 * (1.0 - np.cos(turn_rad)) * speed_mps / accel_mps2


def hover_turn_s(turn_rad: Floats, limits: FlightLimits, accel_mps2: float) -> Floats:
    """Time lost by stopping at a corner and yawing there at the turn rate of a turn in flight."""
    return limits.airspeed_mps / accel_mps2 + turn_rad / limits.turn_rate_rps
