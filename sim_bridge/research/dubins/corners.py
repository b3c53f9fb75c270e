"""A route's corners flown at full speed: time cost of turning, and heading change.

A single turn rounds a corner: it leaves the first leg before the waypoint and meets the second one
after it. In wind the turn is a circle in the air and a trochoid over the ground. With air headings
`psi` that hold both courses, its displacement is `d = 2 R sin(|dpsi| / 2) u(psi_mid) + w T`,
`T = |dpsi| R / V`. Then `d = a u(in) + b u(out)` gives its start and end in closed form. Where legs
are too short, a Dubins path joins the first leg to the second instead.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats
from sim_bridge.research.dubins.level_paths import FlightLimits, Vectors, fastest_dubins_paths

WINDOW_S = 2.0
"""Window of max turn, the largest heading change within it (docs/reference/outcomes.md)."""

_STRAIGHT_RAD = 1e-6
_SAMPLES = 17


@dataclass(frozen=True, slots=True)
class RoundedCorners:
    """n corners as flown; arrays (n,).

    `extra_s`: time compared with flying both legs to and from the corner; mostly negative for a
    cut. `before_m` and `after_m`: distance along the legs, from the waypoint, at which the turn
    starts and ends. `off_m`: minimum distance from the waypoint. `turn_rad`: largest change of air
    heading within 2 s. `cut`: flown as a single turn; else as a Dubins path.
    """

    extra_s: Floats
    before_m: Floats
    after_m: Floats
    off_m: Floats
    turn_rad: Floats
    cut: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class _Course:
    """A course over the ground, with the air heading and ground speed that hold it.

    `unit`: north + 1j east.
    """

    unit: Vectors
    heading_rad: Floats
    ground_mps: Floats


def solve_wind_triangle(course_rad: Floats, airspeed_mps: float, wind_to_ne_mps: Floats) -> _Course:
    """Return air heading and ground speed along each course (wind triangle); NaN if infeasible."""
    unit = np.exp(1j * course_rad)
    wind = (wind_to_ne_mps @ np.array([1.0, 1j])) * unit.conj()  # along the course, and across
    crab = np.arcsin(wind.imag / airspeed_mps)
    return _Course(unit, course_rad - crab, airspeed_mps * np.cos(crab) + wind.real)


def round_corners(
    course_in_rad: Floats,
    course_out_rad: Floats,
    available_in_m: Floats,
    available_out_m: Floats,
    limits: FlightLimits,
    wind_to_ne_mps: Floats,
) -> RoundedCorners:
    """Round every corner at the limits' airspeed and radius; all arrays (n,).

    The available lengths are the parts of each leg that the turn can use.
    """
    count = len(course_in_rad)
    wind = np.broadcast_to(wind_to_ne_mps, (count, 2))
    first = solve_wind_triangle(course_in_rad, limits.airspeed_mps, wind)
    last = solve_wind_triangle(course_out_rad, limits.airspeed_mps, wind)
    corners = _round_by_single_turn(first, last, limits, wind)
    fits = (corners.before_m >= 0.0) & (corners.after_m >= 0.0)
    fits &= (corners.before_m <= available_in_m) & (corners.after_m <= available_out_m)
    rows = np.flatnonzero(~fits)
    corners.cut[rows] = False
    if len(rows):
        _replace_corners_by_dubins_paths(
            rows, corners, first, last, available_in_m, available_out_m, limits, wind
        )
    return corners


def _round_by_single_turn(
    first: _Course, last: _Course, limits: FlightLimits, wind: Floats
) -> RoundedCorners:
    radius, speed = limits.turn_radius_m, limits.airspeed_mps
    change = np.remainder(last.heading_rad - first.heading_rad + np.pi, 2.0 * np.pi) - np.pi
    time = np.abs(change) * radius / speed
    shares = np.linspace(0.0, 1.0, _SAMPLES)
    path = _turn_ground_displacement(first.heading_rad, change, shares, radius, time, wind)
    away = path[:, -1]
    sine = (first.unit.conj() * last.unit).imag
    straight = np.abs(change) < _STRAIGHT_RAD
    with np.errstate(divide="ignore", invalid="ignore"):
        before = np.where(straight, 0.0, (away.conj() * last.unit).imag / sine)
        after = np.where(straight, 0.0, (first.unit.conj() * away).imag / sine)
        before, after = (np.where(np.isfinite(x), x, np.inf) for x in (before, after))
        off = np.abs(path - (before * first.unit)[:, None]).min(axis=1)
        extra = time - before / first.ground_mps - after / last.ground_mps
    return RoundedCorners(
        extra_s=extra,
        before_m=before,
        after_m=after,
        off_m=off,
        turn_rad=np.minimum(np.abs(change), limits.turn_rate_rps * WINDOW_S),
        cut=np.ones(len(time), np.bool_),
    )


def _turn_ground_displacement(
    heading: Floats, change: Floats, share: Floats, radius: float, time: Floats, wind: Floats
) -> Vectors:
    """Return displacement over the ground after each share of a turn; (n, k)."""
    angle = change[:, None] * share
    chord = 2.0 * radius * np.sin(0.5 * np.abs(angle))
    middle = heading[:, None] + 0.5 * angle
    drift = (wind @ np.array([1.0, 1j]))[:, None] * time[:, None] * share
    return np.asarray(chord * np.exp(1j * middle) + drift, np.complex128)


def _replace_corners_by_dubins_paths(
    corner_indices: NDArray[np.int64],
    corners: RoundedCorners,
    first: _Course,
    last: _Course,
    available_in_m: Floats,
    available_out_m: Floats,
    limits: FlightLimits,
    wind: Floats,
) -> None:
    """Fly the corners at `corner_indices` as Dubins paths within the length of both legs."""
    before, after = available_in_m[corner_indices], available_out_m[corner_indices]

    def pose_on_leg(leg: _Course, distance_m: Floats) -> Floats:
        position = distance_m * leg.unit[corner_indices]
        heading = leg.heading_rad[corner_indices]
        return np.column_stack([position.real, position.imag, heading])

    start, goal = pose_on_leg(first, -before), pose_on_leg(last, after)
    paths = fastest_dubins_paths(start, goal, limits, wind[corner_indices])
    straight_s = before / first.ground_mps[corner_indices] + after / last.ground_mps[corner_indices]
    times = paths.time_s[:, None] * np.linspace(0.0, 1.0, 4 * _SAMPLES)
    poses = paths.poses_at(times)
    window = np.minimum(times + WINDOW_S, paths.time_s[:, None])
    max_change = np.abs(paths.poses_at(window)[..., 2] - poses[..., 2]).max(axis=1)
    corners.extra_s[corner_indices] = paths.time_s - straight_s
    corners.before_m[corner_indices], corners.after_m[corner_indices] = before, after
    corners.off_m[corner_indices] = np.hypot(poses[..., 0], poses[..., 1]).min(axis=1)
    corners.turn_rad[corner_indices] = max_change


def unrounded_corner_time_loss_s(turn_rad: Floats, speed_mps: float, accel_mps2: float) -> Floats:
    """Return the time lost at a corner flown without rounding.

    The velocity component lost in the turn is braked and regained, as in `leg_energy`.
    """
    return 0.5 * (1.0 - np.cos(turn_rad)) * speed_mps / accel_mps2


def stop_and_yaw_time_loss_s(turn_rad: Floats, limits: FlightLimits, accel_mps2: float) -> Floats:
    """Return the time lost by stopping at a corner and yawing at the turn rate in flight."""
    return limits.airspeed_mps / accel_mps2 + turn_rad / limits.turn_rate_rps
