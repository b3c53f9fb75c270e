"""Velocity set-points in, set-points that keep the separation out: the last word before flight.

Every vehicle holds, at every tick, one manoeuvre that is known to be safe: brake to a stop, now.
A new velocity is let through only if flying it for one tick and braking then stays, at every
instant, nearer to the vehicle's own braking path than to each neighbour's, by the whole separation
and all that is not known of the neighbour. Where all do so, no two paths come closer than the
separation, and braking stays safe at the next tick. The proof and its assumptions are in
docs/avoidance.md; distances are measured in the norm whose unit ball is the separation cylinder.

Arrays are batched: A vehicles, J neighbours each. Positions and velocities are local NED.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from companion.core.errors import LeewayError

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]
Clearance = Callable[[Floats, NDArray[np.int64]], Floats]
"""Points (a, ..., 3) of the vehicles `rows` (a,) -> a lower bound of the way to an obstacle, m."""

DIRECTIONS = 12
CREEP_MPS = 1.0  # speed at which one may back out of a place too close to be certain
CREEP_SLACK = 0.1  # of the way made; backing out leads straight away, within some 25 degrees
RIGHT_BIAS_MPS = 0.3  # both give way to the right, as the rules of the air have it (SERA.3210)
DODGE_WEIGHT = 0.3  # of a vertical metre a second beside a horizontal one
IN_CACHE = 60_000  # numbers worked on at once
ESCAPE_S = 3.0  # how far an escape looks ahead


class Verdict(IntEnum):
    """What the filter did with the wanted velocity."""

    PASSED = 0
    BENT = 1
    BRAKED = 2
    ESCAPED = 3


@dataclass(frozen=True, slots=True)
class SeparationParams:
    """What must be kept, what a vehicle can do, and how wrong a neighbour's report may be."""

    horizontal_m: float = 5.0  # evaluation.md, 12
    vertical_m: float = 4.0
    tick_s: float = 0.2
    max_speed_mps: float = 15.0
    max_climb_mps: float = 2.0
    accel_mps2: float = 3.0  # PX4 MPC_ACC_HOR default 3; ArduCopter WPNAV_ACCEL default 2.5
    climb_accel_mps2: float = 2.0  # PX4 MPC_ACC_DOWN_MAX 3, ArduCopter PSC_ACC_Z 1 to 2.5
    tracking_m: float = 0.5  # how far the vehicle strays from the path that it was told
    tracking_vertical_m: float = 0.2
    error_sigmas: float = 3.0
    max_age_s: float = 3.0  # older reports: the reach of a neighbour is not widened further
    obstacle_m: float = 3.0  # left free about buildings: half a span, tracking and map

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise LeewayError(f"separation.{name}: {value}, expected a number above 0")

    @property
    def stop_s(self) -> float:
        """The longest time that braking takes."""
        braking = self.max_speed_mps / self.accel_mps2
        return max(braking, self.max_climb_mps / self.climb_accel_mps2)


@dataclass(frozen=True)
class Neighbours:
    """What was heard of each vehicle's neighbours: arrays (A, J, 3) and (A, J)."""

    pos_ned_m: Floats
    vel_ned_mps: Floats
    age_s: Floats
    pos_std_m: Floats  # of each horizontal axis
    alt_std_m: Floats
    vel_std_mps: Floats
    present: NDArray[np.bool_]

    def picked(self, *index: NDArray[np.int64]) -> "Neighbours":
        """These vehicles, or these neighbours of these vehicles."""
        return Neighbours(
            self.pos_ned_m[index],
            self.vel_ned_mps[index],
            self.age_s[index],
            self.pos_std_m[index],
            self.alt_std_m[index],
            self.vel_std_mps[index],
            self.present[index],
        )


@dataclass(frozen=True)
class Filtered:
    """The velocity to be reached at the end of this tick (A, 3), and why it is that one."""

    vel_ned_mps: Floats
    verdict: NDArray[np.int64]


@dataclass(frozen=True)
class SeparationFilter:
    """`safe(...)` for any number of vehicles at once; holds nothing between calls."""

    params: SeparationParams = field(default_factory=SeparationParams)

    def allows(
        self, pos_ned_m: Floats, vel_ned_mps: Floats, wanted_ned_mps: Floats, neighbours: Neighbours
    ) -> Mask:
        """Which wanted velocities (A, 3) would pass as they are, whatever stands on the ground."""
        p = self.params
        first = _reach(vel_ned_mps, wanted_ned_mps, p)[:, None, :]
        heard = _relevant(pos_ned_m, vel_ned_mps, neighbours, p)
        paths = _paths(pos_ned_m, vel_ned_mps, first, p)
        slack = _slack(paths, _braking(pos_ned_m, vel_ned_mps, p), _reports(heard, p), p)
        return np.asarray(slack.min(axis=-1, initial=np.inf)[:, 0] >= 0.0)

    def safe(
        self,
        pos_ned_m: Floats,
        vel_ned_mps: Floats,
        wanted_ned_mps: Floats,
        neighbours: Neighbours,
        layer_down_m: Floats,
        clearance: Clearance | None = None,
    ) -> Filtered:
        """Nearest safe velocities; `layer_down_m` (A,) is the height where a vehicle dodges to."""
        p = self.params
        rows = np.arange(len(pos_ned_m))
        first = _reach(vel_ned_mps, np.nan_to_num(wanted_ned_mps), p)[:, None, :]
        heard = _relevant(pos_ned_m, vel_ned_mps, neighbours, p)
        paths = _paths(pos_ned_m, vel_ned_mps, first, p)
        braking, reports = _braking(pos_ned_m, vel_ned_mps, p), _reports(heard, p)
        slack = _slack(paths, braking, reports, p)
        fine = (slack.min(axis=-1, initial=np.inf) >= 0.0) & _clear(paths, rows, clearance, p)
        velocity, verdict = first[:, 0, :].copy(), np.zeros(len(rows), dtype=np.int64)
        blocked = np.flatnonzero(~fine[:, 0])
        if len(blocked):
            velocity[blocked], verdict[blocked] = self._bent(
                pos_ned_m[blocked],
                vel_ned_mps[blocked],
                np.nan_to_num(wanted_ned_mps[blocked]),
                *_nearest(heard.picked(blocked), reports.picked(blocked), slack[blocked, 0], p),
                braking[blocked],
                layer_down_m[blocked],
                (lambda points, sub: clearance(points, blocked[sub])) if clearance else None,
            )
        return Filtered(velocity, verdict)

    def _bent(
        self,
        pos: Floats,
        vel: Floats,
        wanted: Floats,
        heard: Neighbours,
        reports: "_Reports",
        braking: Floats,
        layer_down_m: Floats,
        clearance: Clearance | None,
    ) -> tuple[Floats, NDArray[np.int64]]:
        """Where the wanted velocity is refused: the best of a fan about the present one."""
        p = self.params
        rows = np.arange(len(pos))
        dodge = _towards_layer(pos, vel, layer_down_m, p)
        fan = _fan(vel, wanted, dodge, p)
        paths = _paths(pos, vel, fan, p)
        slacks = _slack(paths, braking, reports, p)
        slack = slacks.min(axis=-1, initial=np.inf)
        level = _only_changes_level(fan, braking, reports, p)
        moved = np.linalg.norm(paths - braking[:, None], axis=-1).max(axis=-1)
        clear = _clear(paths, rows, clearance, p)
        brake_slack = slack[:, -1:]
        creeping = (np.linalg.norm(fan, axis=-1) <= CREEP_MPS) & (brake_slack < 0.0)
        creeping &= slack >= brake_slack - CREEP_SLACK * moved / p.horizontal_m
        fine = clear & (((slacks >= 0.0) | level).all(axis=-1) | creeping)
        cost = np.where(fine, _cost(fan, wanted, dodge), np.inf)
        choice = cost.argmin(axis=1)
        choice[~np.isfinite(cost[rows, choice])] = fan.shape[1] - 1
        verdict = np.where((choice == fan.shape[1] - 1), Verdict.BRAKED, Verdict.BENT)
        lost = brake_slack[:, 0] < 0.0  # who may brake has a separation to everybody
        if lost.any():
            lost &= _evidently_broken(braking, reports, p)
        if lost.any():
            away = np.where(clear, _escape_margin(paths, heard, p), -np.inf)
            away[:, -1] = np.maximum(away[:, -1], -1e9)  # braking is always there
            choice = np.where(lost, away.argmax(axis=1), choice)
            verdict = np.where(lost, Verdict.ESCAPED, verdict)
        return fan[rows, choice], verdict.astype(np.int64)


def _reach(vel: Floats, wanted: Floats, p: SeparationParams) -> Floats:
    """What one tick's acceleration makes of the wanted velocity; (..., 3)."""
    wanted = wanted.copy()
    wanted[..., :2] = _shorter(wanted[..., :2], p.max_speed_mps)
    wanted[..., 2] = np.clip(wanted[..., 2], -p.max_climb_mps, p.max_climb_mps)
    change = wanted - vel
    change[..., :2] = _shorter(change[..., :2], p.accel_mps2 * p.tick_s)
    most = p.climb_accel_mps2 * p.tick_s
    change[..., 2] = np.clip(change[..., 2], -most, most)
    return vel + change


def _flat(vectors: Floats) -> Floats:
    """Horizontal lengths; (...)."""
    return np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2)


def _shorter(vectors: Floats, most: float) -> Floats:
    length = _flat(vectors)[..., None]
    return vectors * np.minimum(1.0, most / np.maximum(length, 1e-9))


@lru_cache
def _times_s(p: SeparationParams) -> Floats:
    """Ends of ticks until everybody stands; (T,)."""
    return p.tick_s * np.arange(int(np.ceil(p.stop_s / p.tick_s)) + 2, dtype=np.float64)


def _brake_by(vel: Floats, after_s: Floats, p: SeparationParams) -> Floats:
    """The way made while braking from `vel` (..., 3) for `after_s` (T,); (..., T, 3)."""
    speed = _flat(vel)
    climb = np.abs(vel[..., 2])
    t_h = np.minimum(after_s, (speed / p.accel_mps2)[..., None])
    t_v = np.minimum(after_s, (climb / p.climb_accel_mps2)[..., None])
    share_h = t_h - 0.5 * p.accel_mps2 * t_h**2 / np.maximum(speed, 1e-9)[..., None]
    share_v = t_v - 0.5 * p.climb_accel_mps2 * t_v**2 / np.maximum(climb, 1e-9)[..., None]
    return np.stack(
        [share_h * vel[..., 0:1], share_h * vel[..., 1:2], share_v * vel[..., 2:3]], axis=-1
    )


def _braking(pos: Floats, vel: Floats, p: SeparationParams) -> Floats:
    """The path if one brakes now; (A, T, 3)."""
    return pos[:, None, :] + _brake_by(vel, _times_s(p), p)


def _paths(pos: Floats, vel: Floats, chosen: Floats, p: SeparationParams) -> Floats:
    """One tick towards each chosen velocity (A, C, 3), braking after it; (A, C, T, 3)."""
    after = np.maximum(_times_s(p) - p.tick_s, 0.0)
    moved = pos[:, None, :] + 0.5 * p.tick_s * (vel[:, None, :] + chosen)
    paths = moved[:, :, None, :] + _brake_by(chosen, after, p)
    paths[:, :, 0, :] = pos[:, None, :]
    return paths


@dataclass(frozen=True)
class _Reports:
    """Where neighbours would be if they braked now (A, J, T, 3), and how far from there at most."""

    braking: Floats
    error_m: Floats  # (A, J, T), horizontal
    error_vertical_m: Floats
    absent: NDArray[np.bool_]

    def picked(self, *index: NDArray[np.int64]) -> "_Reports":
        return _Reports(
            self.braking[index],
            self.error_m[index],
            self.error_vertical_m[index],
            self.absent[index],
        )


def _reports(heard: Neighbours, p: SeparationParams) -> _Reports:
    """A report of age t: half a t^2 and a t more than its own errors in position and velocity.

    The braking path is at most min(tau, v / a) as far off as the velocity (docs/avoidance.md).
    """
    age = np.clip(heard.age_s, 0.0, p.max_age_s)
    vel = heard.vel_ned_mps
    now = heard.pos_ned_m + vel * age[..., None]
    times = _times_s(p)
    k = p.error_sigmas

    def spread(pos_std: Floats, speed: Floats, accel: float) -> Floats:
        fast = k * heard.vel_std_mps + accel * age
        here = k * pos_std + 0.5 * accel * age**2 + k * heard.vel_std_mps * age
        braking_s = (speed + fast) / accel
        return here[..., None] + fast[..., None] * np.minimum(times, braking_s[..., None])

    braking = now[..., None, :] + _brake_by(vel, times, p)
    return _Reports(
        braking,
        spread(heard.pos_std_m, _flat(vel), p.accel_mps2),
        spread(heard.alt_std_m, np.abs(vel[..., 2]), p.climb_accel_mps2),
        ~heard.present,
    )


@lru_cache
def _cylinder(p: SeparationParams) -> tuple[Floats, float]:
    """Separation to hold at the instants looked at, so that it holds between them; (T,) and m.

    Two vehicles pass each other by at most a chord between instants, and braking they slow down;
    vertically a pair that is separated at either end is so all along.
    """
    fastest = np.maximum(p.max_speed_mps - p.accel_mps2 * (_times_s(p) - 2.0 * p.tick_s), 0.0)
    half_chord = np.minimum(fastest, p.max_speed_mps) * p.tick_s
    horizontal = np.hypot(p.horizontal_m + 2.0 * p.tracking_m, half_chord)
    vertical = p.vertical_m + 2.0 * p.tracking_vertical_m + 2.0 * p.max_climb_mps * p.tick_s
    return horizontal, vertical


def _slack(paths: Floats, braking: Floats, reports: _Reports, p: SeparationParams) -> Floats:
    """How much nearer to my braking path than to each neighbour's, less a separation; (A, C, J)."""
    count, neighbours = paths.shape[1], reports.absent.shape[1]
    found = np.full((*paths.shape[:2], neighbours), np.inf)
    if not neighbours:
        return found
    horizontal, vertical = _cylinder(p)
    flat_share, high_share = (1.0 / horizontal).astype(np.float32), np.float32(1.0 / vertical)
    near = _separations(_components(paths - braking[:, None]), flat_share, high_share)
    start = braking[:, :1]
    own = _components(paths - start[:, None])
    theirs = _components(reports.braking - start[:, None])
    unsure = reports.error_m * flat_share, reports.error_vertical_m * high_share
    at_once = max(1, IN_CACHE // (count * paths.shape[2] * neighbours))
    for first in range(0, len(paths), at_once):
        some = slice(first, first + at_once)
        away = tuple(o[some, :, None] - t[some, None] for o, t in zip(own, theirs, strict=True))
        apart = _separations(away, flat_share, high_share, [u[some, None] for u in unsure])
        apart -= near[some, :, None]
        found[some] = apart.min(axis=-1) - 1.0
    found[np.broadcast_to(reports.absent[:, None], found.shape)] = np.inf
    return found


@lru_cache
def _most_change(p: SeparationParams) -> float:
    """By how much slack can differ between two velocities within reach of the same tick."""
    flat = 2.0 * p.accel_mps2 * p.tick_s * (p.stop_s + p.tick_s) / _cylinder(p)[0].min()
    high = 2.0 * p.climb_accel_mps2 * p.tick_s * (p.stop_s + p.tick_s) / _cylinder(p)[1]
    return 2.0 * float(flat + high)


def _nearest(
    heard: Neighbours, reports: _Reports, slack: Floats, p: SeparationParams
) -> tuple[Neighbours, _Reports]:
    """Without those neighbours that no velocity within reach can bring near."""
    near = slack < _most_change(p)
    most = int(near.sum(axis=1).max(initial=0))
    order = np.argsort(~near, axis=1, kind="stable")[:, :most]
    rows = np.arange(len(slack))[:, None]
    kept = near[rows, order]
    return (
        replace(heard.picked(rows, order), present=kept),
        replace(reports.picked(rows, order), absent=~kept),
    )


def _components(vectors: Floats) -> tuple[Singles, ...]:
    """North, east and down by themselves: four times as fast, and as exact as it has to be."""
    return tuple(np.ascontiguousarray(vectors[..., k], dtype=np.float32) for k in range(3))


def _separations(
    away: tuple[Singles, ...],
    flat_share: Singles,
    high_share: np.float32,
    unsure: list[Floats] | None = None,
) -> Singles:
    """The cylinder's norm of these vectors, less what is not known of them."""
    north, east, down = away
    flat = np.sqrt(north * north + east * east)
    flat *= flat_share
    high = np.abs(down)
    high *= high_share
    if unsure is not None:
        flat -= unsure[0].astype(np.float32)
        high -= unsure[1].astype(np.float32)
    return np.maximum(flat, high, out=flat)


def _only_changes_level(
    fan: Floats, braking: Floats, reports: _Reports, p: SeparationParams
) -> NDArray[np.bool_]:
    """Whether a velocity brakes, and climbs or sinks out of a neighbour's way; (A, C, J).

    Over the ground it is the braking path, so it harms only who counts on the height between: no
    one does while that is too little, and no one suffers while it grows.
    """
    brakes: Mask = np.all(np.abs(fan[..., :2] - fan[:, -1:, :2]) < 1e-9, axis=-1)
    apart = braking[:, None, :, 2] - reports.braking[..., 2]
    reach = 2.0 * p.climb_accel_mps2 * p.tick_s * (p.max_climb_mps / p.climb_accel_mps2 + p.tick_s)
    most = np.abs(apart) + reports.error_vertical_m + reach
    little: Mask = np.all(most < p.vertical_m + 2.0 * p.tracking_vertical_m, axis=-1)
    moves = fan[..., 2] - fan[:, -1:, 2]
    grows = moves[..., None] * apart[:, None, :, 0] >= 0.0
    free = np.logical_or(little[:, None] | reports.absent[:, None], grows)
    return np.logical_and(brakes[..., None], free)


def _evidently_broken(braking: Floats, reports: _Reports, p: SeparationParams) -> NDArray[np.bool_]:
    """Whether even the kindest reading of a report says that braking is not enough; (A,)."""
    away = braking[:, None] - reports.braking
    flat = (np.hypot(away[..., 0], away[..., 1]) + reports.error_m) / p.horizontal_m
    high = (np.abs(away[..., 2]) + reports.error_vertical_m) / p.vertical_m
    close = (np.maximum(flat, high) < 1.0).any(axis=-1) & ~reports.absent
    return np.asarray(close.any(axis=1))


def _escape_margin(paths: Floats, heard: Neighbours, p: SeparationParams) -> Floats:
    """Least distance, in separations, to neighbours that fly on as reported; (A, C)."""
    times = _times_s(p)
    soon = times <= ESCAPE_S
    flown = (heard.age_s[..., None] + times[soon])[..., None] * heard.vel_ned_mps[:, :, None]
    theirs = heard.pos_ned_m[:, :, None] + flown
    away = paths[:, :, None, soon] - theirs[:, None]
    flat = np.hypot(away[..., 0], away[..., 1]) / p.horizontal_m
    # The sum, not the greater: where neither is enough, every metre of either helps.
    apart = flat + np.abs(away[..., 2]) / p.vertical_m
    apart = np.where(heard.present[:, None, :, None], apart, np.inf)
    return apart.min(axis=(2, 3))


def _clear(
    paths: Floats, rows: NDArray[np.int64], clearance: Clearance | None, p: SeparationParams
) -> NDArray[np.bool_]:
    """Whether each path stays out of buildings, between the instants too; (A, C)."""
    if clearance is None:
        return np.ones(paths.shape[:2], dtype=bool)
    step = _flat(np.diff(paths, axis=2))
    half = 0.5 * np.maximum(
        np.pad(step, ((0, 0), (0, 0), (1, 0))), np.pad(step, ((0, 0), (0, 0), (0, 1)))
    )
    return np.asarray(np.all(clearance(paths, rows) >= p.obstacle_m + half, axis=-1))


def _towards_layer(pos: Floats, vel: Floats, layer_down_m: Floats, p: SeparationParams) -> Floats:
    """The vertical speed that leads to a vehicle's own layer and stops there; (A,)."""
    off = layer_down_m - pos[:, 2]
    most = np.sqrt(p.climb_accel_mps2 * np.abs(off))
    return np.sign(off) * np.minimum(most, p.max_climb_mps)


def _fan(vel: Floats, wanted: Floats, dodge: Floats, p: SeparationParams) -> Floats:
    """Velocities within reach of one tick, the wanted one first and braking last; (A, C, 3)."""
    brake = _reach(vel, np.zeros_like(vel), p)
    first = _reach(vel, wanted, p)
    towards = np.arctan2(wanted[:, 1] - vel[:, 1], wanted[:, 0] - vel[:, 0])
    angle = towards[:, None] + 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    about = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * p.accel_mps2 * p.tick_s
    flat = np.concatenate(
        [
            vel[:, None, :2] + about,
            vel[:, None, :2] + 0.5 * about,
            vel[:, None, :2],
            brake[:, None, :2],
        ],
        axis=1,
    )
    bases = np.stack([first[:, :2], brake[:, :2], vel[:, :2]], axis=1)
    fan = np.concatenate(
        [
            first[:, None],
            _with_down(first[:, None, :2], dodge),
            _with_down(flat, dodge),
            _with_down(bases, 0.0 * dodge),
            brake[:, None],
        ],
        axis=1,
    )
    return _reach(vel[:, None, :], fan, p)


def _with_down(flat: Floats, down: Floats) -> Floats:
    """Horizontal velocities (A, C, 2) with one vertical speed for each vehicle (A,)."""
    level = np.broadcast_to(down[:, None, None], (*flat.shape[:2], 1))
    return np.concatenate([flat, level], axis=-1)


def _cost(fan: Floats, wanted: Floats, dodge: Floats) -> Floats:
    """How far from the wanted velocity and from leaving for one's own layer; (A, C)."""
    right = np.stack([-wanted[:, 1], wanted[:, 0]], axis=-1)
    right /= np.maximum(np.linalg.norm(right, axis=-1, keepdims=True), 1e-9)
    aim = wanted[:, :2] + RIGHT_BIAS_MPS * right
    off = _flat(fan[..., :2] - aim[:, None])
    return off + DODGE_WEIGHT * np.abs(fan[..., 2] - dodge[:, None])


def _relevant(pos: Floats, vel: Floats, heard: Neighbours, p: SeparationParams) -> Neighbours:
    """Neighbours that could matter before everybody stands, in as few columns as hold them."""
    sound = np.isfinite(heard.pos_ned_m).all(-1) & np.isfinite(heard.vel_ned_mps).all(-1)
    age = np.clip(heard.age_s, 0.0, p.max_age_s)
    fast = p.error_sigmas * heard.vel_std_mps + p.accel_mps2 * age
    unsure = p.error_sigmas * heard.pos_std_m + fast * (age + p.stop_s)
    own = _flat(vel) + p.accel_mps2 * p.tick_s
    theirs = _flat(heard.vel_ned_mps)
    flown = own * p.tick_s + 0.5 * own**2 / p.accel_mps2
    reach = flown[:, None] + theirs * age + 0.5 * theirs**2 / p.accel_mps2 + unsure
    # What a tick's acceleration changes of the braking path, and the separation itself.
    beside = 2.0 * p.accel_mps2 * p.tick_s * p.stop_s + p.max_speed_mps * p.tick_s
    reach = reach + beside + _cylinder(p)[0].max()
    away = heard.pos_ned_m - pos[:, None]
    near = heard.present & sound & (_flat(away) < reach)
    most = int(near.sum(axis=1).max(initial=0))
    order = np.argsort(~near, axis=1, kind="stable")[:, :most]
    rows = np.arange(len(pos))[:, None]
    return replace(heard.picked(rows, order), present=near[rows, order])
