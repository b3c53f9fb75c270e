"""Fronts told ahead: how many of the drones are warned, how long before, and how often for nothing.

The same field with a front and without one: there every alert is false. Beliefs are told once a
second: 10 s means whose error lasts about 10 s. Among obstacles a front is felt where the free wind
has changed by as much: in a lee less of it arrives.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_belief import LEARNED_S, FieldBelief
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.fronts import (
    BEFORE_S,
    GAP_S,
    FrontAhead,
    FrontNews,
    FrontWatch,
    FrontWithdrawn,
    chance_m2ps2,
)
from companion.core.wind_field.tellings import TELLING_S, WindTelling
from sim_bridge.research.fleet_wind.patrols import HEIGHT_M, Patrol
from sim_bridge.research.fleet_wind.worlds import TOLD_STD_MPS
from sim_bridge.truth.fields.front import PassingFront
from sim_bridge.truth.fields.site_wind import SiteWind

FELT_MPS = 3.0
"""A front is felt where the 10 s mean has changed by so much because of it."""
FALSE_ONCE_IN_H = 10.0
"""What was asked of false alerts."""

MATCH_S = 300.0
"""An alert is of a front that somebody felt first within so long before or after."""


@dataclass(frozen=True, slots=True)
class AlertFigures:
    """What became of the fronts of some worlds. Times in s; one entry each where lists."""

    fronts: int = 0
    noticed: int = 0
    drones_to_warn: int = 0
    drones_warned: int = 0
    delays_s: tuple[float, ...] = ()
    """From the first drone's feeling it to the alert; negative: before it felt 3 m/s of it."""
    leads_s: tuple[float, ...] = ()
    """From the alert to the front's being felt, for each drone that was warned."""
    arrival_errors_s: tuple[float, ...] = ()
    """Stated less true time, for each drone that was warned, as the first alert said it."""
    least_delays_s: tuple[float, ...] = ()
    """As `delays_s`, of the best test of one drone's change alone: see `least_delay_s`."""
    never_told_apart: int = 0
    """Fronts that such a test does not tell from gusts at all."""
    false: int = 0
    hours: float = 0.0
    """Of the fleet in winds without fronts, in which the false ones are counted."""
    false_for_s: tuple[float, ...] = ()
    """How long a false alert stood that was withdrawn, one entry each."""
    withdrawn: int = 0
    """Fronts whose alert was withdrawn."""

    def __add__(self, other: "AlertFigures") -> "AlertFigures":
        return AlertFigures(
            self.fronts + other.fronts,
            self.noticed + other.noticed,
            self.drones_to_warn + other.drones_to_warn,
            self.drones_warned + other.drones_warned,
            self.delays_s + other.delays_s,
            self.leads_s + other.leads_s,
            self.arrival_errors_s + other.arrival_errors_s,
            self.least_delays_s + other.least_delays_s,
            self.never_told_apart + other.never_told_apart,
            self.false + other.false,
            self.hours + other.hours,
            self.false_for_s + other.false_for_s,
            self.withdrawn + other.withdrawn,
        )


NO_ALERTS = AlertFigures()


@dataclass(frozen=True, slots=True)
class Beliefs:
    """What each drone believes at each whole second from 10 s on: (drones, seconds, 2)."""

    t_s: Floats
    places: Floats
    winds: Floats


def beliefs(
    truth: SiteWind, drones: list[Patrol], first_s: float, last_s: float, rng: np.random.Generator
) -> Beliefs:
    """10 s means of the true wind on each drone's way, with an error that lasts about as long."""
    span = int(TELLING_S)
    seconds: Floats = np.arange(math.ceil(first_s), math.floor(last_s), dtype=np.float64) + 0.5
    t_s = seconds[span - 1 :] + 0.5
    places = np.stack([way.at(t_s) for way in drones])
    winds = np.empty((len(drones), t_s.size, 2))
    for number, way in enumerate(drones):
        at = way.at(seconds)
        each = truth.to_ne_mps(seconds, at[:, 0], at[:, 1], HEIGHT_M)
        sums = np.cumsum(np.vstack([np.zeros((1, 2)), each]), axis=0)
        winds[number] = (sums[span:] - sums[:-span]) / span
    return Beliefs(t_s, places, winds + _errors(winds.shape, rng))


def _errors(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Of the told size, new after 10 s."""
    drones, seconds, axes = shape
    span = int(TELLING_S)
    fresh = rng.standard_normal((drones, seconds // span + 2, axes))
    at = np.arange(seconds) / span
    low = at.astype(int)
    share = (at - low)[None, :, None]
    mixed = (1.0 - share) * fresh[:, low] + share * fresh[:, low + 1]
    return TOLD_STD_MPS * mixed / np.sqrt(share**2 + (1.0 - share) ** 2)


@dataclass(frozen=True, slots=True)
class Alert:
    """A front as it was first told, and when it was withdrawn."""

    front: FrontAhead
    withdrawn_s: float | None = None

    @property
    def stood_s(self) -> float | None:
        """How long it stood; None: it was not withdrawn."""
        return None if self.withdrawn_s is None else self.withdrawn_s - self.front.noticed_s


def alerts_in(news: Iterable[FrontNews]) -> list[Alert]:
    """New fronts, in order of time; what is better known later is left out."""
    found: dict[float, Alert] = {}
    for one in news:
        if isinstance(one, FrontWithdrawn):
            noticed_s = one.front.noticed_s
            found[noticed_s] = Alert(found[noticed_s].front, one.t_s)
        else:
            found.setdefault(one.noticed_s, Alert(one))
    return list(found.values())


def front_news(told: Beliefs, names: list[str], process: WindProcessParams) -> list[FrontNews]:
    """Fronts each time that they are new, better known or withdrawn, in order of time, as a desk's
    watch tells them that learns from its field what the ground does."""
    found: list[FrontNews] = []
    watch, field = FrontWatch(process), FieldBelief(FieldProcess(process))
    settled_s = -math.inf
    variance = TOLD_STD_MPS**2
    for k, t_s in enumerate(told.t_s):
        for number, name in enumerate(names):
            north, east = told.places[number, k]
            wind = told.winds[number, k]
            told_now = WindTelling(
                name,
                float(t_s),
                (float(north), float(east)),
                HEIGHT_M,
                (float(wind[0]), float(wind[1])),
                (variance, 0.0, variance),
            )
            field.tell(told_now, float(t_s))
            front = watch.hear(told_now)
            if front is not None:
                found.append(front)
        if t_s - settled_s >= LEARNED_S:
            settled_s = float(t_s)
            field.settle(settled_s)
            watch.expect_ground(field.standing_share)
    return found


def felt_s(front: PassingFront, told: Beliefs) -> Floats:
    """When each drone first feels a front (inf: never): 10 s mean of its share, (drones,)."""
    span = int(TELLING_S)
    found = np.full(told.places.shape[0], math.inf)
    for number, place in enumerate(told.places):
        share = np.hypot(*front.to_ne_mps(told.t_s, place[:, 0], place[:, 1]).T)
        mean = np.convolve(share, np.ones(span) / span)[: share.size]
        felt = np.flatnonzero(mean >= FELT_MPS)
        if felt.size:
            found[number] = told.t_s[felt[0]]
    return found


def least_delay_s(front: PassingFront, told: Beliefs, process: WindProcessParams) -> float:
    """From the first one's feeling a front to where its own change alone may be told from gusts.

    The change is known without noise and gusts are Gaussian with the variance that the process
    gives; each drone is looked at but once a minute, and may be wrong once in ten hours of the
    fleet. Then a change squared over its variance, chi-square of two degrees, has to pass
    -2 ln(1 / looks) (inf: it never does). Real gusts have heavier tails, and are looked at once a
    second.
    """
    looks = told.places.shape[0] * 60.0 * FALSE_ONCE_IN_H
    limit = -2.0 * math.log(1.0 / looks)
    span, before = int(TELLING_S), slice(int(GAP_S), int(GAP_S + BEFORE_S))
    soonest = math.inf
    for number, place in enumerate(told.places):
        wind = np.stack(
            [
                np.convolve(axis, np.ones(span) / span)[: axis.size]
                for axis in front.to_ne_mps(told.t_s, place[:, 0], place[:, 1]).T
            ]
        )
        weights = np.zeros(before.stop)
        weights[before] = 1.0 / (before.stop - before.start)
        change = wind - np.stack([np.convolve(axis, weights)[: axis.size] for axis in wind])
        blown_mps = float(np.hypot(*told.winds[number].mean(axis=0)))
        variance = process.variance_scale(blown_mps) * chance_m2ps2(process) + TOLD_STD_MPS**2
        told_apart = np.flatnonzero(np.square(change).sum(axis=0) / variance >= limit)
        if told_apart.size:
            soonest = min(soonest, float(told.t_s[told_apart[0]]))
    return soonest - float(felt_s(front, told).min())


def judge_front(
    front: PassingFront, told: Beliefs, found: list[Alert], process: WindProcessParams
) -> AlertFigures:
    """What the alerts of a world with one front were worth."""
    felt = felt_s(front, told)
    first_s = float(felt.min())
    if not math.isfinite(first_s):
        return NO_ALERTS
    least_s = least_delay_s(front, told, process)
    least = (least_s,) if math.isfinite(least_s) else ()
    never = 1 - len(least)
    others = np.flatnonzero(np.isfinite(felt) & (felt > first_s))
    near = [one for one in found if abs(one.front.noticed_s - first_s) <= MATCH_S]
    if not near:
        return AlertFigures(
            fronts=1, drones_to_warn=others.size, least_delays_s=least, never_told_apart=never
        )
    alert = near[0].front
    ahead = [int(k) for k in others if felt[k] > alert.noticed_s]
    leads = tuple(float(felt[k]) - alert.noticed_s for k in ahead)
    errors = []
    for k in ahead:
        at = int(np.searchsorted(told.t_s, felt[k]))
        north, east = told.places[k, at]
        errors.append(alert.arrives((float(north), float(east)))[0] - float(felt[k]))
    delay = (alert.noticed_s - first_s,)
    told_s = delay, leads, tuple(errors), least
    withdrawn = int(near[0].stood_s is not None)
    return AlertFigures(1, 1, others.size, len(ahead), *told_s, never, withdrawn=withdrawn)
