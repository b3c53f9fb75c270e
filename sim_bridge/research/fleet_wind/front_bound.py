"""How soon a front could be told at all: ideal sequential tests over the same drawn fronts.

An observer knows the mean wind, and the covariance of the wind and of what members tell of it. By
what was told in the last two minutes it weighs each time at which a front may have begun; the mean
of these likelihood ratios is its statistic (Shiryaev-Roberts: Roberts, Technometrics 8, 1966; among
all tests with as many false alarms it is the quickest in the mean but for a vanishing part: Pollak,
Ann. Stat. 13, 1985). One observer knows of the front all but its time; the other one only how
fronts are drawn. What looks for fronts can be quicker than neither at as few false alarms.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from companion.core.base.arrays import Floats, Ints
from companion.core.wind_field.fronts import GONE_S
from companion.core.wind_field.tellings import TELLING_S
from sim_bridge.research.fleet_wind.alert_study import MATCH_S, Beliefs, felt_s
from sim_bridge.research.fleet_wind.patrols import Patrol
from sim_bridge.research.fleet_wind.worlds import TOLD_STD_MPS
from sim_bridge.truth.fields.coherent_field import Coherence, CoherentField
from sim_bridge.truth.fields.front import PassingFront, drawn_front

LOG_ODDS = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Limits that are judged (natural logarithm)."""
LOOK_S = 2
AGES = 12
"""Of means over 10 s that do not overlap, of each member."""
_PARTS = 3
"""A mean is taken on the way that its drone flew meanwhile: at so many places."""
_BEGAN_S: Floats = np.arange(0.0, 96.0, 4.0)
"""How long ago the front first reached somebody."""
FRONTS_TRIED = 60
"""Drawn as the fronts of a study are, for who knows no more of them; each with changes of four
sizes and in three directions about its normal.
"""
_SIZES, _ASIDE_RAD = (0.125, 0.375, 0.625, 0.875), np.radians([-40.0 / 3.0, 0.0, 40.0 / 3.0])
_SEED = 7
_APART_M: Floats = np.concatenate([[0.0], np.geomspace(20.0, 60_000.0, 60)])
_MOST_LAG_S = 900


@dataclass(frozen=True, slots=True)
class BoundFigures:
    """What an ideal test made of some worlds, one entry for each of `LOG_ODDS`.

    `delays_s`: from the first drone's feeling a front to its being told; negative: before it felt
    3 m/s of it. `missed`: fronts that were not told. `false`: alerts in `hours` without a front.
    """

    delays_s: tuple[tuple[float, ...], ...] = ((),) * len(LOG_ODDS)
    missed: tuple[int, ...] = (0,) * len(LOG_ODDS)
    false: tuple[int, ...] = (0,) * len(LOG_ODDS)
    hours: float = 0.0

    def __add__(self, other: "BoundFigures") -> "BoundFigures":
        return BoundFigures(
            tuple(a + b for a, b in zip(self.delays_s, other.delays_s, strict=True)),
            tuple(a + b for a, b in zip(self.missed, other.missed, strict=True)),
            tuple(a + b for a, b in zip(self.false, other.false, strict=True)),
            self.hours + other.hours,
        )


@dataclass(frozen=True, slots=True)
class AlertBounds:
    """Of who knows the very front but its time, and of who knows how fronts are drawn."""

    front_known: BoundFigures = BoundFigures()
    law_known: BoundFigures = BoundFigures()

    def __add__(self, other: "AlertBounds") -> "AlertBounds":
        return AlertBounds(self.front_known + other.front_known, self.law_known + other.law_known)


NO_BOUNDS = AlertBounds()


@dataclass(frozen=True, slots=True)
class FrontLaw:
    """Fronts that are weighed: slowness (h, 2), times of passing (h,), changes (h, m, 2)."""

    slowness_spm: Floats
    passing_s: Floats
    changes_ne_mps: Floats

    @classmethod
    def known(cls, front: PassingFront) -> "FrontLaw":
        """This one only."""
        slow = _slowness_spm(front)[None, :]
        return cls(slow, np.array([front.passing_s]), np.array([[front.jump_ne_mps]]))

    @classmethod
    def drawn(cls, mean_ne_mps: Floats, least_mps: float, most_mps: float) -> "FrontLaw":
        """As `drawn_front` has it."""
        rng = np.random.default_rng(_SEED)
        fronts = [
            drawn_front(0.0, mean_ne_mps, least_mps, most_mps, rng) for _ in range(FRONTS_TRIED)
        ]
        sizes = least_mps + (most_mps - least_mps) * np.repeat(_SIZES, _ASIDE_RAD.size)
        normals = np.radians([front.towards_deg for front in fronts])
        headings = normals[:, None] + np.tile(_ASIDE_RAD, len(_SIZES))
        changes = sizes[None, :, None] * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
        slow = np.array([_slowness_spm(front) for front in fronts])
        return cls(slow, np.array([front.passing_s for front in fronts]), changes)


def _slowness_spm(front: PassingFront) -> Floats:
    angle = math.radians(front.towards_deg)
    return np.array([math.cos(angle), math.sin(angle)]) / front.speed_mps


def judge_bounds(
    field: CoherentField,
    coherence: Coherence,
    ways: list[Patrol],
    front: PassingFront,
    sizes_mps: tuple[float, float],
    with_front: Beliefs,
    without: Beliefs,
) -> AlertBounds:
    """Ideal tests in one field, with its front and without it, as the same drones tell both.

    `sizes_mps`: between which fronts are drawn.
    """
    laws = FrontLaw.known(front), FrontLaw.drawn(field.mean_ne_mps, *sizes_mps)
    observer = IdealObserver(field, coherence, ways)
    at = range(AGES * int(TELLING_S), without.t_s.size, LOOK_S)
    odds = np.array([observer.log_odds(index, laws, (with_front, without)) for index in at])
    t_s = without.t_s[list(at)]
    first_s = float(felt_s(front, with_front).min())
    known, drawn = (
        _figures(t_s, odds[:, number, 0], odds[:, number, 1], first_s) for number in (0, 1)
    )
    return AlertBounds(known, drawn)


def _figures(t_s: Floats, amid: Floats, calm: Floats, first_s: float) -> BoundFigures:
    delays: list[tuple[float, ...]] = []
    missed, false = list[int](), list[int]()
    felt = math.isfinite(first_s)
    for limit in LOG_ODDS:
        false.append(len(_alerts_s(t_s, calm, limit)))
        told = [s for s in _alerts_s(t_s, amid, limit) if abs(s - first_s) <= MATCH_S]
        delays.append((told[0] - first_s,) if told else ())
        missed.append(int(felt and not told))
    hours = float(np.ptp(t_s)) / 3600.0
    return BoundFigures(tuple(delays), tuple(missed), tuple(false), hours)


def _alerts_s(t_s: Floats, log_odds: Floats, limit: float) -> list[float]:
    """When it is past a limit; then nothing more until the front has gone, as the fleet's watch."""
    found: list[float] = []
    for at_s in t_s[log_odds >= limit]:
        if not found or at_s - found[-1] > GONE_S:
            found.append(float(at_s))
    return found


class IdealObserver:
    """Knows one field, and the law of a front."""

    def __init__(self, field: CoherentField, coherence: Coherence, ways: list[Patrol]) -> None:
        self._field, self._coherence, self._ways = field, coherence, ways
        cov = field.covariances_m2ps2(_APART_M, TELLING_S / _PARTS)
        self._cov = cov[:, :, :_MOST_LAG_S]

    def log_odds(self, index: int, laws: Sequence[FrontLaw], told: Sequence[Beliefs]) -> Floats:
        """By what was told until a second (its index): (laws, told)."""
        at = index - int(TELLING_S) * np.arange(AGES)
        ends_s = np.tile(told[0].t_s[at], len(self._ways))
        parts_s = ends_s[:, None] - TELLING_S * (np.arange(_PARTS) + 0.5) / _PARTS
        each = AGES * _PARTS
        flat_s = parts_s.ravel()
        place = np.concatenate(
            [way.at(flat_s[k * each : (k + 1) * each]) for k, way in enumerate(self._ways)]
        )
        expected = _mean_of(self._field.expected_turned_mps(flat_s, *place.T))
        roots = [
            cholesky(cov, lower=True, overwrite_a=True)
            for cov in self._covariances(flat_s, place, self._noise(at))
        ]
        winds = [self._field.turned(one.winds[:, at].reshape(-1, 2)) - expected for one in told]
        white = [
            solve_triangular(root, np.stack([wind[:, axis] for wind in winds], axis=1), lower=True)
            for axis, root in enumerate(roots)
        ]
        return np.array([self._odds_of(law, flat_s, place, roots, white) for law in laws])

    def _odds_of(
        self,
        law: FrontLaw,
        t_s: Floats,
        place: Floats,
        roots: Sequence[Floats],
        white: Sequence[Floats],
    ) -> list[float]:
        shares = _shares(law, t_s, place)
        tried = law.changes_ne_mps.shape[:2]
        changes = self._field.turned(law.changes_ne_mps.reshape(-1, 2)).reshape(*tried, 1, 2)
        logs = np.zeros((white[0].shape[1], *tried, _BEGAN_S.size))
        for axis, (root, wind) in enumerate(zip(roots, white, strict=True)):
            whitened = solve_triangular(root, shares, lower=True)
            fits = (wind.T @ whitened).reshape(-1, tried[0], 1, _BEGAN_S.size)
            square = np.square(whitened).sum(axis=0).reshape(tried[0], 1, _BEGAN_S.size)
            change = changes[..., axis]
            logs += change * fits - 0.5 * change**2 * square
        most = logs.max(axis=(1, 2, 3))
        mean = np.exp(logs - most[:, None, None, None]).mean(axis=(1, 2, 3))
        return list(most + np.log(mean))

    def _covariances(self, t_s: Floats, place: Floats, noise: Floats) -> list[Floats]:
        """Of the means along and across (n, n)."""
        turned = self._field.turned(place)
        off = np.abs(turned[:, None, :] - turned[None, :, :])
        apart_m = np.hypot(
            self._coherence.along * off[..., 0], self._coherence.across * off[..., 1]
        )
        carried_s = t_s - turned[:, 0] / self._field.mean_mps
        lag_s = np.minimum(np.abs(np.subtract.outer(carried_s, carried_s)), _MOST_LAG_S - 1.001)
        row = np.interp(apart_m, _APART_M, np.arange(_APART_M.size))
        low, second = np.minimum(row.astype(int), _APART_M.size - 2), lag_s.astype(int)
        up, later = row - low, lag_s - second
        count = t_s.size // _PARTS
        found: list[Floats] = []
        for table in self._cov:
            near = table[low, second] * (1.0 - later) + table[low, second + 1] * later
            far = table[low + 1, second] * (1.0 - later) + table[low + 1, second + 1] * later
            cov = near + up * (far - near)
            mean = cov.reshape(count, _PARTS, count, _PARTS).mean(axis=(1, 3))
            found.append(mean + noise)
        return found

    def _noise(self, at: Ints) -> Floats:
        """Of what is told, as `alert_study` makes it: it goes over from one value to the next."""
        share = (at % TELLING_S) / TELLING_S
        size = share**2 + (1.0 - share) ** 2
        one = np.eye(AGES)
        beside = share[:-1] * (1.0 - share[:-1]) / size[:-1]
        one += np.diag(beside, 1) + np.diag(beside, -1)
        return np.asarray(TOLD_STD_MPS**2 * np.kron(np.eye(len(self._ways)), one), np.float64)


def _mean_of(parts: Floats) -> Floats:
    """Of the places on the way of each mean."""
    return parts.reshape(-1, _PARTS, *parts.shape[1:]).mean(axis=1)


def _shares(law: FrontLaw, t_s: Floats, place: Floats) -> Floats:
    """Of the change in each mean, had a front reached the first one so long ago: (n, h beginnings).

    Smooth (cubic) while it passes, as the truth has it.
    """
    lag_s = place @ law.slowness_spm.T
    newest = np.arange(0, t_s.size, AGES * _PARTS)
    since_s = (t_s - t_s.max())[:, None] - lag_s + lag_s[newest].min(axis=0)
    x = (since_s[:, :, None] + _BEGAN_S) / law.passing_s[:, None]
    x = np.clip(x, 0.0, 1.0)
    return _mean_of((x * x * (3.0 - 2.0 * x)).reshape(t_s.size, -1))
