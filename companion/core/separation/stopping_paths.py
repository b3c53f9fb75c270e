"""Where vehicles stand if they brake, what a neighbour's report leaves open, and what lies between.

Every vehicle holds, at every tick, one manoeuvre: brake to a stop, now. `separation_filter` asks
here, for each velocity that it looks at, how much nearer the path stays to the vehicle's own
braking path than to each neighbour's. The proof that this is enough is in
docs/explanation/avoidance.md. Distances are measured in the norm whose unit ball is the separation
cylinder.

Arrays are batched and component first, which takes half the calls: (3, A, ...) north, east, down of
A vehicles, C velocities, J neighbours, T instants, from where each vehicle is now. What is
flat and what is high comes as (2, A, ...).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints, Singles
from companion.core.base.errors import LeewayError

IN_CACHE = 60_000  # numbers worked on at once


@dataclass(frozen=True, slots=True)
class SeparationParams:
    """What must be kept, what a vehicle can do, and how wrong a neighbour's report may be."""

    horizontal_m: float = 5.0
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
    present: Bools

    def picked(self, *index: Ints) -> "Neighbours":
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
class Instants:
    """The instants looked at, and what has to be kept at each so that it holds between them."""

    params: SeparationParams
    times_s: Floats  # (T,): ends of ticks until everybody stands
    after_tick_s: Floats  # (T,): the same from the end of the first tick
    accel_mps2: Floats  # (2,): flat and high
    shares: Floats  # (3, T): what a metre north, east and down is of the cylinder
    most_change: float  # of slack, between two velocities within reach of the same tick

    @classmethod
    def of(cls, p: SeparationParams) -> "Instants":
        """Two pass each other by at most a chord between instants, and braking they slow down.

        Vertically a pair that is separated at either end is so all along.
        """
        times = p.tick_s * np.arange(int(np.ceil(p.stop_s / p.tick_s)) + 2, dtype=np.float64)
        fastest = np.maximum(p.max_speed_mps - p.accel_mps2 * (times - 2.0 * p.tick_s), 0.0)
        half_chord = np.minimum(fastest, p.max_speed_mps) * p.tick_s
        flat = np.hypot(p.horizontal_m + 2.0 * p.tracking_m, half_chord)
        high = p.vertical_m + 2.0 * p.tracking_vertical_m + 2.0 * p.max_climb_mps * p.tick_s
        changed = p.accel_mps2 / flat.min() + p.climb_accel_mps2 / high
        return cls(
            p,
            times,
            np.maximum(times - p.tick_s, 0.0),
            np.array([p.accel_mps2, p.climb_accel_mps2]),
            1.0 / np.stack([flat, flat, np.full_like(flat, high)]),
            4.0 * p.tick_s * (p.stop_s + p.tick_s) * float(changed),
        )


instants_of = lru_cache(Instants.of)


@dataclass(frozen=True)
class Heard:
    """Those neighbours that can matter: where they were, from the vehicle, and how sure that is.

    Whoever is not present fills a column up, and is of finite numbers.
    """

    away_m: Floats  # (3, A, J)
    vel_mps: Floats  # (3, A, J)
    age_s: Floats  # (A, J), no more than what a neighbour's reach is widened for
    std: Floats  # (3, A, J): flat and high position in m, velocity in m/s
    present: Bools  # (A, J)


@dataclass(frozen=True)
class Reports:
    """Where neighbours would be if they braked now, and how far from there at most.

    In cylinders, as all distances here: metres times `Instants.shares`.
    """

    braking: Singles  # (3, A, J, T)
    unsure: Singles  # (2, A, J, T), flat and high; minus infinity of who is not there

    def picked(self, rows: Ints, kept: Bools) -> "Reports":
        """Of these vehicles, those neighbours (rows, J) that are kept, in few columns."""
        order = few_columns(kept)
        if order is None:
            return self.of(rows)
        index = rows[:, None], order
        found = Reports(self.braking[:, *index], self.unsure[:, *index])
        found.unsure[:, ~np.take_along_axis(kept, order, axis=1)] = -np.inf
        return found

    def of(self, rows: Ints) -> "Reports":
        return Reports(self.braking[:, rows], self.unsure[:, rows])

    @property
    def present(self) -> Bools:
        return self.unsure[0, ..., 0] >= 0.0


def few_columns(kept: Bools) -> Ints | None:
    """Which columns (A, most) hold all that is kept, first; None: all of them, as they are."""
    if kept.all():
        return None
    most = int(kept.sum(axis=1).max(initial=0))
    return np.argsort(~kept, axis=1, kind="stable")[:, :most]


def flat_of(vectors: Floats) -> Floats:
    """Horizontal lengths; (...)."""
    return np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1])


def no_more_than(vectors: Floats, flat: float, high: float) -> Floats:
    """These vectors (3, ...), shortened over the ground and cut vertically."""
    found = np.empty_like(vectors)
    length = np.maximum(flat_of(vectors), 1e-9)
    np.multiply(vectors[:2], np.minimum(1.0, flat / length), out=found[:2])
    np.minimum(np.maximum(vectors[2], -high), high, out=found[2])
    return found


def reach(vel: Floats, wanted: Floats, p: SeparationParams) -> Floats:
    """What one tick's acceleration makes of the wanted velocity; (3, ...)."""
    change = no_more_than(wanted, p.max_speed_mps, p.max_climb_mps) - vel
    return vel + no_more_than(change, p.accel_mps2 * p.tick_s, p.climb_accel_mps2 * p.tick_s)


def _flat_and_high(vectors: Floats) -> Floats:
    sizes = np.empty((2, *vectors.shape[1:]))
    sizes[0] = flat_of(vectors)
    np.abs(vectors[2], out=sizes[1])
    return sizes


def _brake_by(vel: Floats, after_s: Floats, now: Instants) -> Floats:
    """The way made while braking from `vel` (3, ...) for `after_s` (T,); (3, ..., T)."""
    speed = _flat_and_high(vel)
    accel = now.accel_mps2.reshape(2, *(1,) * (speed.ndim - 1))
    share = np.minimum(after_s, (speed / accel)[..., None])
    less = (0.5 * accel / np.maximum(speed, 1e-9))[..., None] * share
    less *= share
    share -= less
    way = np.empty((3, *share.shape[1:]))
    np.multiply(vel[:2, ..., None], share[0], out=way[:2])
    np.multiply(vel[2, ..., None], share[1], out=way[2])
    return way


def braking_of(vel: Floats, now: Instants) -> Floats:
    """The path if one brakes now; (3, ..., T)."""
    return _brake_by(vel, now.times_s, now)


def paths_of(vel: Floats, chosen: Floats, now: Instants) -> Floats:
    """One tick from `vel` (3, A) towards each velocity (3, A, C), braking then; (3, A, C, T)."""
    paths = _brake_by(chosen, now.after_tick_s, now)
    paths += (0.5 * now.params.tick_s * (vel[..., None] + chosen))[..., None]
    paths[..., 0] = 0.0
    return paths


def relevant(pos_ned_m: Floats, vel: Floats, told: Neighbours, now: Instants) -> Heard:
    """Neighbours that could matter before everybody stands, in as few columns as hold them.

    `pos_ned_m` (A, 3) as told; `vel` (3, A).
    """
    p = now.params
    away = np.ascontiguousarray((told.pos_ned_m - pos_ned_m[:, None]).transpose(2, 0, 1))
    theirs = np.ascontiguousarray(told.vel_ned_mps.transpose(2, 0, 1))
    age = np.minimum(np.maximum(told.age_s, 0.0), p.max_age_s)
    fast = p.error_sigmas * told.vel_std_mps + p.accel_mps2 * age
    unsure = p.error_sigmas * told.pos_std_m + fast * (age + p.stop_s)
    own = flat_of(vel) + p.accel_mps2 * p.tick_s
    speed = flat_of(theirs)
    flown = own * p.tick_s + 0.5 * own**2 / p.accel_mps2
    # What a tick's acceleration changes of the braking path, and the separation itself.
    beside = 2.0 * p.accel_mps2 * p.tick_s * p.stop_s + p.max_speed_mps * p.tick_s
    flown += beside + 1.0 / now.shares[0].min()
    reached = flown[:, None] + speed * age + 0.5 * speed**2 / p.accel_mps2 + unsure
    near = told.present & (flat_of(away) < reached)  # no number is not less than any
    near &= np.isfinite(away[2] + theirs[2])
    std = np.stack([told.pos_std_m, told.alt_std_m, told.vel_std_mps])
    order = few_columns(near)
    if order is None:
        return Heard(away, theirs, age, std, near)
    index = np.arange(len(order))[:, None], order
    near = near[index]
    whole = np.concatenate([away, theirs, age[None], std])[:, *index]
    whole[:, ~near] = 0.0
    return Heard(whole[:3], whole[3:6], whole[6], whole[7:], near)


def reports_of(heard: Heard, now: Instants) -> Reports:
    """A report of age t: half a t^2 and a t more than its own errors in position and velocity.

    The braking path is at most min(tau, v / a) as far off as the velocity
    (docs/explanation/avoidance.md).
    """
    sigmas, age, vel = now.params.error_sigmas, heard.age_s, heard.vel_mps
    braking = braking_of(vel, now)
    braking += (heard.away_m + vel * age)[..., None]
    braking *= now.shares[:, None, None]
    accel = now.accel_mps2[:, None, None]
    drift = sigmas * heard.std[2]
    fast = drift + accel * age
    here = sigmas * heard.std[:2] + 0.5 * accel * age**2 + drift * age
    braking_s = (_flat_and_high(vel) + fast) / accel
    unsure = fast[..., None] * np.minimum(now.times_s, braking_s[..., None])
    unsure += here[..., None]
    unsure *= now.shares[1:, None, None]
    if not heard.present.all():
        unsure[:, ~heard.present] = -np.inf
    return Reports(braking.astype(np.float32), unsure.astype(np.float32))


def slack_of(
    paths: Floats, braking: Floats, reports: Reports, now: Instants, each: bool = False
) -> Singles:
    """How much nearer to my braking path than to any neighbour's, less a separation; (A, C).

    Paths (3, A, C, T), one's own braking path (3, A, T). Of `each` neighbour: (A, C, J).
    """
    count, neighbours, instants = paths.shape[2], *reports.unsure.shape[2:]
    found = np.full((paths.shape[1], count, neighbours if each else 1), np.inf, dtype=np.float32)
    if neighbours and found.size:
        shares = now.shares[:, None, None]
        near = _norm((shares * (paths - braking[:, :, None])).astype(np.float32))
        own = (shares * paths).astype(np.float32)
        at_once = max(1, IN_CACHE // (count * neighbours * instants))
        for first in range(0, len(found), at_once):
            some = slice(first, first + at_once)
            away = own[:, some, :, None] - reports.braking[:, some, None]
            apart = _norm(away, reports.unsure[:, some, None])
            apart -= near[some, :, None]
            apart.reshape(*found[some].shape, -1).min(axis=-1, out=found[some])
        found -= 1.0
    return found if each else found[..., 0]


def _norm(away: Singles, unsure: Singles | None = None) -> Singles:
    """The cylinder's norm of these (3, ...), less what is not known of them; in place.

    Singles: twice as fast, and as exact as it has to be.
    """
    np.multiply(away[:2], away[:2], out=away[:2])
    np.add(away[0], away[1], out=away[0])
    np.sqrt(away[0], out=away[0])
    np.abs(away[2], out=away[2])
    if unsure is not None:
        away[::2] -= unsure
    return np.maximum(away[0], away[2], out=away[0])
