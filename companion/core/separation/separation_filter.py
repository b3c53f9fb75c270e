"""The safety filter: desired velocity set-points in, set-points that keep the separation out.

A new velocity passes only if flying it for one tick and then braking stays, at every instant,
nearer to the vehicle's own braking path than to each neighbour's, by the whole separation and the
uncertainty about the neighbour (`stopping_paths`). Where all vehicles do so, no two paths come
closer than the separation, and braking stays safe at the next tick. The proof and its assumptions
are in docs/explanation/avoidance.md.

Arrays are batched: A vehicles, J neighbours each; (A, ..., 3) local NED as asked and answered,
(3, A, ...) inside.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints, Singles
from companion.core.separation.stopping_paths import (
    Heard,
    Instants,
    Neighbours,
    Reports,
    SeparationParams,
    braking_of,
    flat_of,
    instants_of,
    paths_of,
    reach,
    relevant,
    reports_of,
    slack_of,
)

Clearance = Callable[[Floats, Ints], Floats]
"""Points (a, ..., 3) of the vehicles `rows` (a,) -> a lower bound of the way to an obstacle, m."""

DIRECTIONS = 12
CREEP_MPS = 1.0  # speed at which one may back out of a place too close to be certain
NO_WAY_M2 = 1e-6  # rounding
RIGHT_BIAS_MPS = 0.3  # both give way to the right, as the rules of the air have it (SERA.3210)
DODGE_WEIGHT = 0.3  # of a vertical metre a second beside a horizontal one
ESCAPE_S = 3.0  # how far an escape looks ahead
FEW = 3  # vehicles for which the whole fan is looked at in one go
CHEAPEST = 8  # velocities of more vehicles than that are looked at first
ABOUT_RAD = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS


class FilterAction(IntEnum):
    """What the filter did with the wanted velocity."""

    PASSED = 0
    BENT = 1
    BRAKED = 2
    ESCAPED = 3


@dataclass(frozen=True)
class Filtered:
    """The velocity to be reached at the end of this tick (A, 3), and why it is that one."""

    vel_ned_mps: Floats
    verdict: Ints


@dataclass(frozen=True)
class SeparationFilter:
    """`safe(...)` for any number of vehicles at once; holds nothing between calls."""

    params: SeparationParams = field(default_factory=SeparationParams)

    def allows(
        self, pos_ned_m: Floats, vel_ned_mps: Floats, wanted_ned_mps: Floats, neighbours: Neighbours
    ) -> Bools:
        """Which wanted velocities (A, 3) would pass as they are, whatever stands on the ground."""
        now, vel = instants_of(self.params), vel_ned_mps.T
        paths = paths_of(vel, reach(vel, wanted_ned_mps.T, self.params)[..., None], now)
        reports = reports_of(relevant(pos_ned_m, vel, neighbours, now), now)
        return np.asarray(slack_of(paths, braking_of(vel, now), reports, now)[:, 0] >= 0.0)

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
        now, vel, wanted = instants_of(self.params), vel_ned_mps.T, wanted_ned_mps.T
        if not np.isfinite(wanted).all():
            wanted = np.nan_to_num(wanted)
        first = reach(vel, wanted, self.params)
        heard = relevant(pos_ned_m, vel, neighbours, now)
        reports, braking = reports_of(heard, now), braking_of(vel, now)
        paths = paths_of(vel, first[..., None], now)
        slack = slack_of(paths, braking, reports, now, each=True)[:, 0]
        rows = np.arange(len(pos_ned_m))
        blocked = (slack < 0.0).any(axis=1)
        if clearance is not None:
            blocked |= ~_clear(paths[:, :, 0], pos_ned_m, rows, clearance, self.params)
        verdict = np.zeros(len(rows), dtype=np.int64)
        rows = np.flatnonzero(blocked)
        if len(rows):
            near = reports.picked(rows, slack[rows] < now.most_change)
            scene = _Blocked(
                now, rows, pos_ned_m[rows], vel[:, rows], braking[:, rows], near, clearance
            )
            dodge = _towards_layer(scene.pos_ned_m, layer_down_m[rows], self.params)
            fan = _fan(scene.vel, wanted[:, rows], dodge, self.params)
            cost = _cost(fan, wanted[:, rows], dodge)
            first[:, rows], verdict[rows] = _bent(scene, fan, cost, heard)
        return Filtered(first.T, verdict)


@dataclass(frozen=True)
class _Blocked:
    """Those whose wish is refused: `row` among all asked about, and what is about them."""

    now: Instants
    row: Ints
    pos_ned_m: Floats  # (a, 3)
    vel: Floats  # (3, a)
    braking: Floats  # (3, a, T)
    reports: Reports
    clearance: Clearance | None

    def of(self, some: Ints) -> "_Blocked":
        """Only some of them."""
        return _Blocked(
            self.now,
            self.row[some],
            self.pos_ned_m[some],
            self.vel[:, some],
            self.braking[:, some],
            self.reports.of(some),
            self.clearance,
        )


def _bent(scene: _Blocked, fan: Floats, cost: Floats, heard: Heard) -> tuple[Floats, Ints]:
    """Where the wanted velocity is refused: the cheapest of the fan that is let through.

    The fan (3, a, C) and its cost (a, C) end with braking. A crowd is asked for its cheapest
    velocities first and only who finds none for the others, too: less to reckon, in more calls.
    """
    every = np.arange(len(cost))
    if len(every) <= FEW:
        fine, brake_slack = _fine(scene, fan)
        choice = _cheapest(fine, cost)
    else:
        order = cost.argsort(axis=1, kind="stable")
        choice, brake_slack = _among(scene, fan, cost, order[:, :CHEAPEST])
        left = np.flatnonzero(choice < 0)
        if len(left):
            others = order[left, CHEAPEST:]
            choice[left], _ = _among(scene.of(left), fan[:, left], cost[left], others)
    choice[choice < 0] = cost.shape[1] - 1
    verdict = np.where(choice == cost.shape[1] - 1, FilterAction.BRAKED, FilterAction.BENT)
    lost = np.flatnonzero(brake_slack < 0.0)  # who may brake has a separation to everybody
    if len(lost):
        lost = lost[_evidently_broken(scene.of(lost))]
    if len(lost):
        choice[lost] = _escape(scene.of(lost), fan[:, lost], heard)
        verdict[lost] = FilterAction.ESCAPED
    return fan[:, every, choice], verdict.astype(np.int64)


def _among(scene: _Blocked, fan: Floats, cost: Floats, columns: Ints) -> tuple[Ints, Singles]:
    """The cheapest of these columns (a, c) that is let through, or -1; the slack of braking."""
    rows = np.arange(len(columns))
    braking = np.full((len(columns), 1), cost.shape[1] - 1)
    fine, brake_slack = _fine(scene, fan[:, rows[:, None], np.hstack([columns, braking])])
    best = _cheapest(fine[:, :-1], np.take_along_axis(cost, columns, axis=1))
    return np.where(best < 0, -1, columns[rows, best]), brake_slack


def _cheapest(fine: Bools, cost: Floats) -> Ints:
    """The first of the cheapest that are fine, or -1; (a,)."""
    return np.where(fine.any(axis=1), np.where(fine, cost, np.inf).argmin(axis=1), -1)


def _fine(scene: _Blocked, fan: Floats) -> tuple[Bools, Singles]:
    """Which velocities (3, a, c), braking the last, are let through; (a, c), and its slack (a,)."""
    paths = paths_of(scene.vel, fan, scene.now)
    slack = slack_of(paths, scene.braking, scene.reports, scene.now)
    fine = slack >= 0.0
    brakes = (np.abs(fan[:2] - fan[:2, :, -1:]) < 1e-9).all(axis=0)
    creeps = (np.sqrt((fan**2).sum(axis=0)) <= CREEP_MPS) & (slack[:, -1:] < 0.0)
    a, c = np.nonzero((brakes | creeps) & ~fine)
    if len(a):
        fine[a, c] = _gives_way(scene.of(a), paths[:, a, c])
    if scene.clearance is not None:
        a, c = np.nonzero(fine)
        p = scene.now.params
        fine[a, c] = _clear(paths[:, a, c], scene.pos_ned_m[a], scene.row[a], scene.clearance, p)
    return fine, slack[:, -1]


def _gives_way(scene: _Blocked, paths: Floats) -> Bools:
    """Whether these paths (3, a, T) come no nearer to whom one is not certain of; (a,).

    However the report errs: the way off the braking path leads away from every place where the
    neighbour may be, over the ground and by height. Height is free as long as it is too little for
    anybody to count on it.
    """
    now, reports, p = scene.now, scene.reports, scene.now.params
    slack = slack_of(paths[:, :, None], scene.braking, reports, now, each=True)[:, 0]
    metre = 1.0 / now.shares[:, None, None]
    apart = scene.braking[:, :, None] - metre * reports.braking
    unsure = metre[1:] * np.maximum(reports.unsure, 0.0)
    moved = (paths - scene.braking)[:, :, None]
    flat = moved[0] * apart[0] + moved[1] * apart[1] >= flat_of(moved) * unsure[0] - NO_WAY_M2
    high = moved[2] * apart[2] >= np.abs(moved[2]) * unsure[1] - NO_WAY_M2
    longest = 2.0 * p.climb_accel_mps2 * p.tick_s
    longest *= p.max_climb_mps / p.climb_accel_mps2 + p.tick_s
    most = np.abs(apart[2]) + unsure[1] + longest
    little = (most < p.vertical_m + 2.0 * p.tracking_vertical_m).all(axis=-1)
    away = flat.all(axis=-1) & (little | high.all(axis=-1))
    return np.asarray(((slack >= 0.0) | away).all(axis=-1))


def _evidently_broken(scene: _Blocked) -> Bools:
    """Whether even the kindest reading of a report says that braking is not enough; (a,)."""
    now, reports, p = scene.now, scene.reports, scene.now.params
    metre = 1.0 / now.shares[:, None, None]
    away = scene.braking[:, :, None] - metre * reports.braking
    flat = (flat_of(away) + metre[0] * reports.unsure[0]) / p.horizontal_m
    high = (np.abs(away[2]) + metre[2] * reports.unsure[1]) / p.vertical_m
    close = (np.maximum(flat, high) < 1.0).any(axis=-1) & reports.present
    return np.asarray(close.any(axis=1))


def _escape(scene: _Blocked, fan: Floats, heard: Heard) -> Ints:
    """Which of the fan keeps most distance to neighbours that fly on as reported; (a,)."""
    now, p, rows = scene.now, scene.now.params, scene.row
    soon = now.times_s <= ESCAPE_S
    paths = paths_of(scene.vel, fan, now)
    vel, away = heard.vel_mps[:, rows], heard.away_m[:, rows]
    flown = (heard.age_s[rows][..., None] + now.times_s[soon]) * vel[..., None]
    off = paths[:, :, :, None, soon] - (away[..., None] + flown)[:, :, None]
    # The sum, not the greater: where neither is enough, every metre of either helps.
    apart = flat_of(off) / p.horizontal_m + np.abs(off[2]) / p.vertical_m
    apart = np.where(heard.present[rows][:, None, :, None], apart, np.inf)
    margin = apart.min(axis=(2, 3))
    if scene.clearance is not None:
        a, c = (k.ravel() for k in np.indices(margin.shape))
        clear = _clear(paths[:, a, c], scene.pos_ned_m[a], rows[a], scene.clearance, p)
        margin = np.where(clear.reshape(margin.shape), margin, -np.inf)
    least = np.finfo(margin.dtype).min
    margin[:, -1] = np.maximum(margin[:, -1], least)  # braking is always there
    return margin.argmax(axis=1)


def _clear(
    paths: Floats, pos_ned_m: Floats, rows: Ints, clearance: Clearance, p: SeparationParams
) -> Bools:
    """Whether each path (3, n, T) from (n, 3) stays out of buildings, between instants too."""
    step = flat_of(np.diff(paths, axis=-1))
    half = np.zeros(paths.shape[1:])
    half[:, 1:] = step
    np.maximum(half[:, :-1], step, out=half[:, :-1])
    points = paths.transpose(1, 2, 0) + pos_ned_m[:, None]
    return np.asarray((clearance(points, rows) >= p.obstacle_m + 0.5 * half).all(axis=-1))


def _towards_layer(pos_ned_m: Floats, layer_down_m: Floats, p: SeparationParams) -> Floats:
    """The vertical speed that leads to a vehicle's own layer and stops there; (a,)."""
    off = layer_down_m - pos_ned_m[:, 2]
    most = np.sqrt(p.climb_accel_mps2 * np.abs(off))
    return np.sign(off) * np.minimum(most, p.max_climb_mps)


def _fan(vel: Floats, wanted: Floats, dodge: Floats, p: SeparationParams) -> Floats:
    """Velocities within reach of one tick, the wanted one first and braking last; (3, a, C).

    Between them, at the speed of dodging: the wanted one, two rings about the present velocity, the
    present one and braking; and without a climb: the wanted one, braking, and the present one.
    """
    brake, first = reach(vel, np.zeros_like(vel), p), reach(vel, wanted, p)
    angle = np.arctan2(wanted[1] - vel[1], wanted[0] - vel[0])[:, None] + ABOUT_RAD
    about = np.stack([np.cos(angle), np.sin(angle)]) * (p.accel_mps2 * p.tick_s)
    near, far = 2 + DIRECTIONS, 2 + 2 * DIRECTIONS
    fan = np.empty((3, vel.shape[1], far + 6))
    fan[:, :, 0] = first
    fan[:2, :, 1] = first[:2]
    fan[:2, :, 2:near] = vel[:2, :, None] + about
    fan[:2, :, near:far] = vel[:2, :, None] + 0.5 * about
    for column, flat in enumerate((vel, brake, first, brake, vel), start=far):
        fan[:2, :, column] = flat[:2]
    fan[2, :, 1 : far + 2] = dodge[:, None]
    fan[2, :, far + 2 :] = 0.0
    fan[:, :, -1] = brake
    return reach(vel[..., None], fan, p)


def _cost(fan: Floats, wanted: Floats, dodge: Floats) -> Floats:
    """How far from the wanted velocity and from leaving for one's own layer; (a, C)."""
    bias = RIGHT_BIAS_MPS / np.maximum(flat_of(wanted), 1e-9)
    north = fan[0] - (wanted[0] - bias * wanted[1])[:, None]
    east = fan[1] - (wanted[1] + bias * wanted[0])[:, None]
    off = np.sqrt(north * north + east * east)
    return off + DODGE_WEIGHT * np.abs(fan[2] - dodge[:, None])
