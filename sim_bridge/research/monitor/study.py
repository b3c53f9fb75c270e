"""The monitor's study: false alarms where all is right, flights to find what is wrong, losses."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Bools, Floats
from companion.core.monitor.promises import (
    DRAW,
    DRAW_STD,
    DRAW_TEST,
    PACK,
    PACK_TEST,
    WIND,
    WIND_TEST,
    threshold,
)
from companion.core.monitor.tally import FALL_STD_FRAC
from sim_bridge.research.monitor.following import (
    Followed,
    believed_after,
    follow,
    follow_shares,
)
from sim_bridge.research.monitor.gate import Losses, judge
from sim_bridge.research.monitor.worlds import (
    FALL_FRAC,
    M100_DAY_STD,
    M100_FLIGHT_STD,
    Season,
    World,
)
from sim_bridge.research.promise.verdict import wilson95

PACK_STD = FALL_STD_FRAC / FALL_FRAC
PACKS, PACK_SEASON = 4, Season(flights=125, per_day=3)
"""Packs of a vehicle, taken in turn."""

WIND_CHECKS = 5
"""Forecasts that a flight of six minutes checks."""

AS_MEASURED = World("as measured on the M100", 0.0, M100_DAY_STD, M100_FLIGHT_STD)
AT_THE_EDGE = World("at the edge of the null", DRAW_TEST.tolerance, DRAW_TEST.day_std, DRAW_STD)
HARSH = (
    replace(AS_MEASURED, name="cold spells: days correlated by 0.9", day_memory=0.9),
    replace(AS_MEASURED, name="flights of Student's t, 4 degrees", flight_dof=4.0),
    replace(AS_MEASURED, name="days scatter by 3 %, twice as measured", day_std=0.03),
)
CHANGE = 203
"""In the middle of a season and of a day."""

FINDING_SERVICES = 2000
"""Enough for a median to a flight."""

MAX_LOSS = 0.01
WITHOUT_DAYS = replace(DRAW_TEST, day_std=0.0)
"""What a monitor is that takes all flights as independent; told the whole scatter of a flight."""


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """Services with an alarm, of `services`, where nothing was wrong."""

    world: str
    what: str
    alarms: int
    services: int

    @property
    def interval(self) -> tuple[float, float]:
        return wilson95(self.alarms, self.services)


@dataclass(frozen=True, slots=True)
class Found:
    """Flights from a change to its alarm: median, and those within which 90 % were found."""

    what: str
    per_day: int
    median: float
    most: float
    missed: float


@dataclass(frozen=True, slots=True)
class LossRow:
    """Losses of the flights that a gate allowed."""

    what: str
    when: str
    with_monitor: Losses
    without: Losses


def false_alarms(services: int, seed: int) -> Iterator[FalseAlarms]:
    """Whole services as measured and at the edge of the null, then harsher worlds of the draw."""
    worlds = ((AS_MEASURED, 0.0, 0.05), (AT_THE_EDGE, PACK_TEST.tolerance, WIND_TEST.allowed))
    for number, (world, pack_mean, share) in enumerate(worlds):
        rng = np.random.default_rng([seed, 1, number])
        draw = _draw(world, Season(), services, rng).alarm
        packs = [
            _pack_null(order, pack_mean, world, services, rng) for order in range(1, PACKS + 1)
        ]
        wind = _wind_null(share, services, rng)
        parts = {"draw": draw, "packs": np.min(packs, axis=0), "wind": wind}
        parts["the whole service"] = np.min([*parts.values()], axis=0)
        for what, alarm in parts.items():
            yield _counted(world.name, what, alarm)
    for number, world in enumerate(HARSH):
        rng = np.random.default_rng([seed, 2, number])
        yield _counted(world.name, "draw", _draw(world, Season(), services, rng).alarm)
    rng = np.random.default_rng([seed, 3])
    std = math.hypot(DRAW_TEST.day_std, DRAW_STD)
    blind = follow(WITHOUT_DAYS, std, threshold(DRAW), AS_MEASURED, Season(), services, rng)
    yield _counted(AS_MEASURED.name, "draw, flights taken as independent", blind.alarm)
    blind = follow(WITHOUT_DAYS, std, threshold(DRAW), AT_THE_EDGE, Season(), services, rng)
    yield _counted(AT_THE_EDGE.name, "draw, flights taken as independent", blind.alarm)


def times_to_find(seed: int) -> Iterator[Found]:
    """A draw that rises in mid-season, and packs that come, or turn out, aged."""
    for number, rise in enumerate((0.05, 0.10, 0.20)):
        rng = np.random.default_rng([seed, 4, number])
        season = Season(change=CHANGE, by=math.log1p(rise))
        seen = _draw(AS_MEASURED, season, FINDING_SERVICES, rng)
        yield _found(f"draw +{100 * rise:.0f} %", season, seen)
        blind_std = math.hypot(DRAW_TEST.day_std, DRAW_STD)
        blind = follow(
            WITHOUT_DAYS, blind_std, threshold(DRAW), AS_MEASURED, season, FINDING_SERVICES, rng
        )
        yield _found(f"draw +{100 * rise:.0f} %, flights taken as independent", season, blind)
    for number, (health, per_day) in enumerate(((0.9, 10), (0.8, 10), (0.9, 3), (0.8, 3))):
        rng = np.random.default_rng([seed, 5, number])
        season = Season(flights=300, per_day=per_day, change=0, by=-math.log(health))
        seen = _pack(1, 0.0, season, FINDING_SERVICES, rng)
        yield _found(f"a pack at {100 * health:.0f} % from its first flight", season, seen)
        aged = replace(season, change=61)
        seen = _pack(1, 0.0, aged, FINDING_SERVICES, rng)
        yield _found(f"a pack at {100 * health:.0f} % after 61 flights", aged, seen)


def losses(services: int, seed: int) -> Iterator[LossRow]:
    """Losses before, between change and alarm, and after it, with the monitor and without."""
    for number, rise in enumerate((0.05, 0.10, 0.20)):
        rng = np.random.default_rng([seed, 6, number])
        season = Season(flights=400, change=CHANGE, by=math.log1p(rise))
        seen = _draw(AS_MEASURED, season, services, rng)
        mean, std = believed_after(DRAW_TEST, DRAW_STD, seen, season)
        none = np.zeros_like(mean)
        whole = np.ones_like(mean)
        for when, flights in _spans(seen, season):
            told = seen.values[flights], none[flights]
            knows = judge(*told, (mean[flights], std[flights], whole[flights]), MAX_LOSS, rng)
            not_ = judge(*told, (none[flights], none[flights], whole[flights]), MAX_LOSS, rng)
            yield LossRow(f"draw +{100 * rise:.0f} %", when, knows, not_)
    for number, health in enumerate((0.9, 0.8)):
        rng = np.random.default_rng([seed, 7, number])
        season = Season(flights=200, change=61, by=-math.log(health))
        seen = _pack(1, 0.0, season, services, rng)
        mean, std = believed_after(PACK_TEST, PACK_STD, seen, season)
        share = np.minimum(np.exp(-mean - std), 1.0)
        fell = np.array([season.shift(flight) for flight in range(season.flights)])
        has = np.broadcast_to(-fell[:, None], mean.shape)
        used = AS_MEASURED.mean + math.hypot(M100_DAY_STD, M100_FLIGHT_STD) * rng.standard_normal(
            mean.shape
        )
        none = np.zeros_like(mean)
        for when, flights in _spans(seen, season):
            told = used[flights], has[flights]
            knows = judge(*told, (none[flights], none[flights], share[flights]), MAX_LOSS, rng)
            not_ = judge(*told, (none[flights], none[flights], 1.0 + none[flights]), MAX_LOSS, rng)
            yield LossRow(f"a pack at {100 * health:.0f} %", when, knows, not_)


def fading_pack(seed: int) -> tuple[Floats, Floats, Followed, Floats]:
    """A pack that loses a quarter of its capacity over 150 flights: true share (flights,), believed
    share (flights,), the services followed, and the alarm's limit by flight.
    """
    season = Season(flights=150, per_day=3)
    truth = 1.0 - 0.25 * np.arange(season.flights) / season.flights
    rng = np.random.default_rng([seed, 8])
    seen = _pack(1, 0.0, season, 1, rng)
    values = seen.values - np.log(truth)[:, None]
    test, evidence = PACK_TEST, PACK_TEST.none((1,))
    log_e = np.zeros_like(values)
    for flight in range(season.flights):
        if flight % season.per_day == 0:
            evidence = test.next_day(evidence)
        evidence = test.take(evidence, values[flight], PACK_STD)
        log_e[flight] = test.log_e(evidence)
    limit = threshold(PACK)
    reached = np.flatnonzero(log_e[:, 0] >= limit)
    alarm = np.array([float(reached[0]) if reached.size else np.inf])
    followed = Followed(alarm, log_e, values)
    mean, std = believed_after(test, PACK_STD, followed, season)
    believed = np.where(mean[:, 0] > 0.0, np.exp(-mean[:, 0] - std[:, 0]), 1.0)
    return truth, believed, followed, np.full(season.flights, limit)


def _draw(world: World, season: Season, services: int, rng: np.random.Generator) -> Followed:
    return follow(DRAW_TEST, DRAW_STD, threshold(DRAW), world, season, services, rng)


def _pack(
    order: int, mean: float, season: Season, services: int, rng: np.random.Generator
) -> Followed:
    world = World("pack", mean, M100_DAY_STD, PACK_STD)
    return follow(PACK_TEST, PACK_STD, threshold(PACK, order), world, season, services, rng)


def _pack_null(
    order: int, mean: float, world: World, services: int, rng: np.random.Generator
) -> Floats:
    at_edge = replace(world, mean=mean, flight_std=PACK_STD)
    limit = threshold(PACK, order)
    return follow(PACK_TEST, PACK_STD, limit, at_edge, PACK_SEASON, services, rng).alarm


def _wind_null(share: float, services: int, rng: np.random.Generator) -> Floats:
    """Days differ: their shares are of a beta distribution with the mean `share`, as wide as one
    with two such checks.
    """
    days = rng.beta(2.0 * share, 2.0 * (1.0 - share), (Season().days, services))
    return follow_shares(WIND_TEST, threshold(WIND), days, WIND_CHECKS, 10, rng)


def _counted(world: str, what: str, alarm: Floats) -> FalseAlarms:
    return FalseAlarms(world, what, int(np.isfinite(alarm).sum()), alarm.size)


def _found(what: str, season: Season, seen: Followed) -> Found:
    change = season.change or 0
    late = seen.alarm[seen.alarm >= change] - change + 1.0
    missed = float(np.isinf(late).mean())
    return Found(
        what, season.per_day, float(np.median(late)), float(np.percentile(late, 90)), missed
    )


def _spans(seen: Followed, season: Season) -> Iterator[tuple[str, Bools]]:
    """Masks over (flights, services)."""
    flight = np.arange(season.flights)[:, None]
    changed = flight >= (season.change or 0)
    after = np.broadcast_to(flight > seen.alarm, seen.values.shape)
    yield "before the change", np.broadcast_to(~changed, after.shape) & ~after
    yield "until the alarm", changed & ~after
    yield "after the alarm", changed & after
