"""Braking paths, bounds on a neighbour's position from its report, and the slack between them.

At every tick each vehicle has one fallback manoeuvre: brake to a stop now. For each candidate
velocity, `separation_filter` asks how much nearer the path stays to the vehicle's own braking path
than to each neighbour's. The proof that this suffices is in docs/explanation/avoidance.md.
Distances use the norm whose unit ball is the separation cylinder.

Arrays are batched, component first, which halves the number of calls: (3, A, ...) north, east, down
for A vehicles, C velocities, J neighbours, T instants, relative to each vehicle's position now.
Horizontal and vertical parts are (2, A, ...).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints, Singles
from companion.core.base.errors import LeewayError

IN_CACHE = 60_000  # array elements per batch, to stay in the cache


@dataclass(frozen=True, slots=True)
class SeparationParams:
    """Required separation, vehicle limits, and error bounds of a neighbour's report.

    Raises LeewayError for a value that is not finite and above 0.
    """

    horizontal_m: float = 5.0
    vertical_m: float = 4.0
    tick_s: float = 0.2
    max_speed_mps: float = 15.0
    max_climb_mps: float = 2.0
    accel_mps2: float = 3.0  # PX4 MPC_ACC_HOR default 3; ArduCopter WPNAV_ACCEL default 2.5
    climb_accel_mps2: float = 2.0  # PX4 MPC_ACC_DOWN_MAX 3, ArduCopter PSC_ACC_Z 1 to 2.5
    tracking_m: float = 0.5  # deviation from the commanded path
    tracking_vertical_m: float = 0.2
    error_sigmas: float = 3.0
    max_age_s: float = 3.0  # beyond this age a neighbour's reach grows no further
    obstacle_m: float = 3.0  # clearance to buildings: half a span, tracking and map error

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise LeewayError(f"separation.{name}: {value}, expected a number above 0")

    @property
    def stop_s(self) -> float:
        """The longest braking time, horizontal or vertical."""
        braking = self.max_speed_mps / self.accel_mps2
        return max(braking, self.max_climb_mps / self.climb_accel_mps2)


@dataclass(frozen=True)
class Neighbours:
    """Latest report of each neighbour of each vehicle: arrays (A, J, 3) and (A, J)."""

    pos_ned_m: Floats
    vel_ned_mps: Floats
    age_s: Floats
    pos_std_m: Floats  # per horizontal axis
    alt_std_m: Floats
    vel_std_mps: Floats
    present: Bools

    def picked(self, *index: Ints) -> "Neighbours":
        """The same, indexed by vehicle, or by vehicle and neighbour."""
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
    """The sampled instants, and the separation needed at each so that it holds between them."""

    params: SeparationParams
    times_s: Floats  # (T,): ends of ticks until every vehicle has stopped
    after_tick_s: Floats  # (T,): the same from the end of the first tick
    accel_mps2: Floats  # (2,): horizontal and vertical
    shares: Floats  # (3, T): 1/m, metres north, east, down to cylinder units
    most_change: float  # bound on the slack's change between two velocities reachable in one tick

    @classmethod
    def of(cls, p: SeparationParams) -> "Instants":
        """Between instants two vehicles pass by at most a chord, and braking makes that shorter.

        Vertically, a pair that is separated at both ends of a tick is separated throughout.
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
    """Neighbours that can matter: relative position and velocity, age and uncertainty.

    Absent neighbours pad the columns, with finite numbers.
    """

    away_m: Floats  # (3, A, J)
    vel_mps: Floats  # (3, A, J)
    age_s: Floats  # (A, J), capped at `max_age_s`
    std: Floats  # (3, A, J): horizontal and vertical position in m, velocity in m/s
    present: Bools  # (A, J)


@dataclass(frozen=True)
class Reports:
    """Braking paths of the neighbours, and how far from them a neighbour may be.

    In cylinder units, as all distances here: metres times `Instants.shares`.
    """

    braking: Singles  # (3, A, J, T)
    unsure: Singles  # (2, A, J, T), horizontal and vertical; minus infinity if absent

    def picked(self, rows: Ints, kept: Bools) -> "Reports":
        """For these vehicles, the neighbours marked in `kept` (rows, J), in as few columns as
        possible.
        """
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
    """Column order (A, most) that puts the kept entries first; None if all are kept."""
    if kept.all():
        return None
    most = int(kept.sum(axis=1).max(initial=0))
    return np.argsort(~kept, axis=1, kind="stable")[:, :most]


def flat_of(vectors: Floats) -> Floats:
    """Horizontal lengths (...) of vectors (3, ...)."""
    return np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1])


def no_more_than(vectors: Floats, flat: float, high: float) -> Floats:
    """Vectors (3, ...) with horizontal length at most `flat` and vertical part within +-`high`."""
    found = np.empty_like(vectors)
    length = np.maximum(flat_of(vectors), 1e-9)
    np.multiply(vectors[:2], np.minimum(1.0, flat / length), out=found[:2])
    np.minimum(np.maximum(vectors[2], -high), high, out=found[2])
    return found


def reach(vel: Floats, wanted: Floats, p: SeparationParams) -> Floats:
    """Velocity (3, ...) after one tick of acceleration towards the wanted one, within limits."""
    change = no_more_than(wanted, p.max_speed_mps, p.max_climb_mps) - vel
    return vel + no_more_than(change, p.accel_mps2 * p.tick_s, p.climb_accel_mps2 * p.tick_s)


def _flat_and_high(vectors: Floats) -> Floats:
    sizes = np.empty((2, *vectors.shape[1:]))
    sizes[0] = flat_of(vectors)
    np.abs(vectors[2], out=sizes[1])
    return sizes


def _brake_by(vel: Floats, after_s: Floats, now: Instants) -> Floats:
    """Displacement (3, ..., T) while braking from `vel` (3, ...) for `after_s` (T,)."""
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
    """Braking path (3, ..., T) from now."""
    return _brake_by(vel, now.times_s, now)


def paths_of(vel: Floats, chosen: Floats, now: Instants) -> Floats:
    """Accelerate for one tick from `vel` (3, A) to each velocity (3, A, C), then brake; (3, A, C,
    T).
    """
    paths = _brake_by(chosen, now.after_tick_s, now)
    paths += (0.5 * now.params.tick_s * (vel[..., None] + chosen))[..., None]
    paths[..., 0] = 0.0
    return paths


def relevant(pos_ned_m: Floats, vel: Floats, told: Neighbours, now: Instants) -> Heard:
    """Neighbours that could matter before every vehicle has stopped, in as few columns as possible.

    `pos_ned_m` (A, 3) as reported; `vel` (3, A).
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
    # Change of the braking path by one tick of acceleration, plus the separation itself.
    beside = 2.0 * p.accel_mps2 * p.tick_s * p.stop_s + p.max_speed_mps * p.tick_s
    flown += beside + 1.0 / now.shares[0].min()
    reached = flown[:, None] + speed * age + 0.5 * speed**2 / p.accel_mps2 + unsure
    near = told.present & (flat_of(away) < reached)  # NaN compares false
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
    """Braking paths and uncertainty of reports. Age t adds a t^2 / 2 to position, a t to velocity.

    An error in velocity moves the braking path by at most that error times min(tau, v / a)
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
    """How much nearer a path stays to its own braking path than to any neighbour's, minus 1; (A,
    C).

    Cylinder units. `paths` (3, A, C, T), own braking path (3, A, T). With `each`, per neighbour:
    (A, C, J). Infinite without neighbours.
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
    """Cylinder norm of vectors (3, ...), minus their uncertainty; overwrites its input.

    float32: twice as fast, and accurate enough.
    """
    np.multiply(away[:2], away[:2], out=away[:2])
    np.add(away[0], away[1], out=away[0])
    np.sqrt(away[0], out=away[0])
    np.abs(away[2], out=away[2])
    if unsure is not None:
        away[::2] -= unsure
    return np.maximum(away[0], away[2], out=away[0])
