"""Braking paths, bounds on a neighbour's position from its report, and the slack between them.

At every tick each vehicle has one fallback manoeuvre: brake to a stop now. For each candidate
velocity, the slack is how much nearer its path stays to the vehicle's own braking path than to each
neighbour's. The proof that this suffices is in docs/explanation/avoidance.md.
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

BATCH_ELEMENTS = 60_000  # array elements per batch, to stay in the cache


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
    def longest_braking_time_s(self) -> float:
        """Longest braking time, horizontal or vertical."""
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

    def select_by_index(self, *vehicle_and_neighbour_indices: Ints) -> "Neighbours":
        """Return a subset, indexed by vehicle, or by vehicle and neighbour."""
        return Neighbours(
            self.pos_ned_m[vehicle_and_neighbour_indices],
            self.vel_ned_mps[vehicle_and_neighbour_indices],
            self.age_s[vehicle_and_neighbour_indices],
            self.pos_std_m[vehicle_and_neighbour_indices],
            self.alt_std_m[vehicle_and_neighbour_indices],
            self.vel_std_mps[vehicle_and_neighbour_indices],
            self.present[vehicle_and_neighbour_indices],
        )


@dataclass(frozen=True)
class Instants:
    """Sampled instants, and the separation required at each so that it holds between them."""

    params: SeparationParams
    times_s: Floats  # (T,): ends of ticks until every vehicle has stopped
    after_tick_s: Floats  # (T,): the same from the end of the first tick
    accel_mps2: Floats  # (2,): horizontal and vertical
    shares: Floats  # (3, T): 1/m, metres north, east, down to cylinder units
    most_change: float  # bound on the slack's change between two velocities reachable in one tick

    @classmethod
    def from_params(cls, p: SeparationParams) -> "Instants":
        """Compute the instants. Between two of them a pair moves relatively by at most a chord,
        which braking shortens. A pair that is separated vertically at both ends of a tick is
        separated throughout.
        """
        times = p.tick_s * np.arange(
            int(np.ceil(p.longest_braking_time_s / p.tick_s)) + 2, dtype=np.float64
        )
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
            4.0 * p.tick_s * (p.longest_braking_time_s + p.tick_s) * float(changed),
        )


get_instants = lru_cache(Instants.from_params)


@dataclass(frozen=True)
class NearbyNeighbours:
    """Relevant neighbours: relative position and velocity, age and uncertainty.

    Absent neighbours pad the columns, with finite numbers.
    """

    away_m: Floats  # (3, A, J)
    vel_mps: Floats  # (3, A, J)
    age_s: Floats  # (A, J), capped at `max_age_s`
    std: Floats  # (3, A, J): horizontal and vertical position in m, velocity in m/s
    present: Bools  # (A, J)


@dataclass(frozen=True)
class NeighbourPaths:
    """Braking paths of the neighbours, and the uncertainty of these paths.

    In cylinder units, as all distances here: metres times `Instants.shares`.
    """

    braking: Singles  # (3, A, J, T)
    uncertainty: Singles  # (2, A, J, T), horizontal and vertical; minus infinity if absent

    def select_kept_neighbours(self, vehicle_indices: Ints, is_kept: Bools) -> "NeighbourPaths":
        """Return the neighbours marked in `is_kept` (rows, J) of these vehicles, in the least
        number of columns.
        """
        order = column_order_kept_first(is_kept)
        if order is None:
            return self.select_vehicles(vehicle_indices)
        index = vehicle_indices[:, None], order
        found = NeighbourPaths(self.braking[:, *index], self.uncertainty[:, *index])
        found.uncertainty[:, ~np.take_along_axis(is_kept, order, axis=1)] = -np.inf
        return found

    def select_vehicles(self, vehicle_indices: Ints) -> "NeighbourPaths":
        return NeighbourPaths(
            self.braking[:, vehicle_indices], self.uncertainty[:, vehicle_indices]
        )


def column_order_kept_first(is_kept: Bools) -> Ints | None:
    """Return the column order (A, most) with the kept entries first; None if all are kept."""
    if is_kept.all():
        return None
    most = int(is_kept.sum(axis=1).max(initial=0))
    return np.argsort(~is_kept, axis=1, kind="stable")[:, :most]


def horizontal_norm(vectors: Floats) -> Floats:
    """Return horizontal lengths (...) of vectors (3, ...)."""
    return np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1])


def limit_vectors(vectors: Floats, max_horizontal: float, max_vertical: float) -> Floats:
    """Limit vectors (3, ...) to length `max_horizontal`, vertical part +-`max_vertical`."""
    found = np.empty_like(vectors)
    length = np.maximum(horizontal_norm(vectors), 1e-9)
    np.multiply(vectors[:2], np.minimum(1.0, max_horizontal / length), out=found[:2])
    np.minimum(np.maximum(vectors[2], -max_vertical), max_vertical, out=found[2])
    return found


def velocity_after_one_tick(
    current_vel: Floats, desired_vel: Floats, p: SeparationParams
) -> Floats:
    """Return velocity (3, ...) after one tick of limited acceleration to the desired one."""
    change = limit_vectors(desired_vel, p.max_speed_mps, p.max_climb_mps) - current_vel
    return current_vel + limit_vectors(
        change, p.accel_mps2 * p.tick_s, p.climb_accel_mps2 * p.tick_s
    )


def _horizontal_and_vertical_magnitudes(vectors: Floats) -> Floats:
    sizes = np.empty((2, *vectors.shape[1:]))
    sizes[0] = horizontal_norm(vectors)
    np.abs(vectors[2], out=sizes[1])
    return sizes


def _braking_displacement(vel: Floats, braking_times_s: Floats, instants: Instants) -> Floats:
    """Return displacement (3, ..., T) on braking from `vel` (3, ...) for `braking_times_s` (T,)."""
    speed = _horizontal_and_vertical_magnitudes(vel)
    accel = instants.accel_mps2.reshape(2, *(1,) * (speed.ndim - 1))
    share = np.minimum(braking_times_s, (speed / accel)[..., None])
    less = (0.5 * accel / np.maximum(speed, 1e-9))[..., None] * share
    less *= share
    share -= less
    displacement = np.empty((3, *share.shape[1:]))
    np.multiply(vel[:2, ..., None], share[0], out=displacement[:2])
    np.multiply(vel[2, ..., None], share[1], out=displacement[2])
    return displacement


def braking_paths(vel: Floats, instants: Instants) -> Floats:
    """Return the braking path (3, ..., T) from now."""
    return _braking_displacement(vel, instants.times_s, instants)


def paths_of_candidate_velocities(
    vel: Floats, candidate_velocities: Floats, instants: Instants
) -> Floats:
    """Return paths (3, A, C, T): accelerate for one tick from `vel` (3, A) to each velocity
    (3, A, C), then brake.
    """
    paths = _braking_displacement(candidate_velocities, instants.after_tick_s, instants)
    paths += (0.5 * instants.params.tick_s * (vel[..., None] + candidate_velocities))[..., None]
    paths[..., 0] = 0.0
    return paths


def select_neighbours_within_reach(
    pos_ned_m: Floats, vel: Floats, neighbours: Neighbours, instants: Instants
) -> NearbyNeighbours:
    """Select neighbours that may be too close before every vehicle has stopped, in the least number
    of columns. `pos_ned_m` is (A, 3), `vel` (3, A).
    """
    p = instants.params
    away = np.ascontiguousarray((neighbours.pos_ned_m - pos_ned_m[:, None]).transpose(2, 0, 1))
    neighbour_vel = np.ascontiguousarray(neighbours.vel_ned_mps.transpose(2, 0, 1))
    age = np.minimum(np.maximum(neighbours.age_s, 0.0), p.max_age_s)
    fast = p.error_sigmas * neighbours.vel_std_mps + p.accel_mps2 * age
    uncertainty = p.error_sigmas * neighbours.pos_std_m + fast * (age + p.longest_braking_time_s)
    own = horizontal_norm(vel) + p.accel_mps2 * p.tick_s
    speed = horizontal_norm(neighbour_vel)
    flown = own * p.tick_s + 0.5 * own**2 / p.accel_mps2
    # Change of the braking path by one tick of acceleration, plus the separation itself.
    path_change_m = (
        2.0 * p.accel_mps2 * p.tick_s * p.longest_braking_time_s + p.max_speed_mps * p.tick_s
    )
    flown += path_change_m + 1.0 / instants.shares[0].min()
    reached = flown[:, None] + speed * age + 0.5 * speed**2 / p.accel_mps2 + uncertainty
    near = neighbours.present & (horizontal_norm(away) < reached)  # NaN compares false
    near &= np.isfinite(away[2] + neighbour_vel[2])
    std = np.stack([neighbours.pos_std_m, neighbours.alt_std_m, neighbours.vel_std_mps])
    order = column_order_kept_first(near)
    if order is None:
        return NearbyNeighbours(away, neighbour_vel, age, std, near)
    index = np.arange(len(order))[:, None], order
    near = near[index]
    whole = np.concatenate([away, neighbour_vel, age[None], std])[:, *index]
    whole[:, ~near] = 0.0
    return NearbyNeighbours(whole[:3], whole[3:6], whole[6], whole[7:], near)


def predict_neighbour_braking_paths(
    nearby_neighbours: NearbyNeighbours, instants: Instants
) -> NeighbourPaths:
    """Return braking paths and uncertainty. Age t adds a t^2 / 2 to position, a t to velocity.

    An error in velocity moves the braking path by at most that error times min(tau, v / a)
    (docs/explanation/avoidance.md).
    """
    sigmas, age, vel = (
        instants.params.error_sigmas,
        nearby_neighbours.age_s,
        nearby_neighbours.vel_mps,
    )
    braking = braking_paths(vel, instants)
    braking += (nearby_neighbours.away_m + vel * age)[..., None]
    braking *= instants.shares[:, None, None]
    accel = instants.accel_mps2[:, None, None]
    drift = sigmas * nearby_neighbours.std[2]
    fast = drift + accel * age
    here = sigmas * nearby_neighbours.std[:2] + 0.5 * accel * age**2 + drift * age
    braking_s = (_horizontal_and_vertical_magnitudes(vel) + fast) / accel
    uncertainty = fast[..., None] * np.minimum(instants.times_s, braking_s[..., None])
    uncertainty += here[..., None]
    uncertainty *= instants.shares[1:, None, None]
    if not nearby_neighbours.present.all():
        uncertainty[:, ~nearby_neighbours.present] = -np.inf
    return NeighbourPaths(braking.astype(np.float32), uncertainty.astype(np.float32))


def compute_separation_slack(
    candidate_path_points: Floats,
    own_braking_paths: Floats,
    neighbour_paths: NeighbourPaths,
    sampled_instants: Instants,
    per_neighbour: bool = False,
) -> Singles:
    """Return the slack (A, C): distance of a path to the neighbours' braking paths minus that to
    its own, minus 1, least over neighbours and instants.

    Cylinder units. `candidate_path_points` (3, A, C, T), own braking path (3, A, T). With
    `per_neighbour`, per neighbour: (A, C, J). Infinite without neighbours.
    """
    count, neighbours, instants = (
        candidate_path_points.shape[2],
        *neighbour_paths.uncertainty.shape[2:],
    )
    found = np.full(
        (candidate_path_points.shape[1], count, neighbours if per_neighbour else 1),
        np.inf,
        dtype=np.float32,
    )
    if neighbours and found.size:
        shares = sampled_instants.shares[:, None, None]
        near = _cylinder_norm_in_place(
            (shares * (candidate_path_points - own_braking_paths[:, :, None])).astype(np.float32)
        )
        own = (shares * candidate_path_points).astype(np.float32)
        batch_size = max(1, BATCH_ELEMENTS // (count * neighbours * instants))
        for first in range(0, len(found), batch_size):
            some = slice(first, first + batch_size)
            away = own[:, some, :, None] - neighbour_paths.braking[:, some, None]
            difference = _cylinder_norm_in_place(away, neighbour_paths.uncertainty[:, some, None])
            difference -= near[some, :, None]
            difference.reshape(*found[some].shape, -1).min(axis=-1, out=found[some])
        found -= 1.0
    return found if per_neighbour else found[..., 0]


def _cylinder_norm_in_place(vectors: Singles, uncertainty: Singles | None = None) -> Singles:
    """Return the cylinder norm of vectors (3, ...) minus their uncertainty; overwrites its input.

    float32: twice as fast, and accurate enough.
    """
    np.multiply(vectors[:2], vectors[:2], out=vectors[:2])
    np.add(vectors[0], vectors[1], out=vectors[0])
    np.sqrt(vectors[0], out=vectors[0])
    np.abs(vectors[2], out=vectors[2])
    if uncertainty is not None:
        vectors[::2] -= uncertainty
    return np.maximum(vectors[0], vectors[2], out=vectors[0])
