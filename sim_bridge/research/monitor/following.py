"""Follows many services at once by the companion's bets: when alarms come, what is believed."""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.monitor.e_process import ShareTest, ShiftTest
from sim_bridge.research.monitor.worlds import Season, World


@dataclass(frozen=True, slots=True)
class Followed:
    """`alarm` (services,): the index of the flight after which it came, infinite without one.
    `log_e` (flights, services). `values` the log ratios, (flights, services).
    """

    alarm: Floats
    log_e: Floats
    values: Floats

    def share(self) -> float:
        """Of the services, with an alarm."""
        return float(np.isfinite(self.alarm).mean())

    def flights_to_find(self, change: int) -> float:
        """Median number of flights from the change to the alarm, of services without an earlier."""
        return float(np.median(self.alarm[self.alarm >= change] - change + 1.0))


def follow(
    test: ShiftTest,
    std: float,
    limit: float,
    world: World,
    season: Season,
    services: int,
    rng: np.random.Generator,
) -> Followed:
    """Fly `services` seasons of a world; an alarm is a log e-value of `limit` or more."""
    evidence = test.none((services,))
    shared = world.days(services, season.days, rng)
    log_e = np.zeros((season.flights, services))
    values = np.zeros((season.flights, services))
    for flight in range(season.flights):
        day, first = divmod(flight, season.per_day)
        if first == 0:
            evidence = test.next_day(evidence)
        values[flight] = shared[day] + world.flights(services, rng) + season.shift(flight)
        evidence = test.take(evidence, values[flight], std)
        log_e[flight] = test.log_e(evidence)
    return Followed(first_reached(log_e, limit), log_e, values)


def follow_shares(
    test: ShareTest,
    limit: float,
    shares: Floats,
    checks: int,
    per_day: int,
    rng: np.random.Generator,
) -> Floats:
    """Flight of the alarm, (services,): `shares` (days, services) is each day's chance that a check
    fails, of `checks` a flight.
    """
    days, services = shares.shape
    evidence = test.none((services,))
    log_e = np.zeros((days * per_day, services))
    for flight in range(days * per_day):
        day, first = divmod(flight, per_day)
        if first == 0:
            evidence = test.next_day(evidence)
        log_e[flight] = test.log_e(evidence)
        evidence = test.take(evidence, rng.binomial(checks, shares[day]), checks)
    return first_reached(log_e, limit)


def first_reached(log_e: Floats, limit: float) -> Floats:
    """Index of the first flight with at least `limit`, (services,); infinite where none has."""
    reached = log_e >= limit
    return np.where(reached.any(axis=0), reached.argmax(axis=0).astype(float), np.inf)


def believed_after(
    test: ShiftTest, std: float, seen: Followed, season: Season
) -> tuple[Floats, Floats]:
    """(mean, std) that each flight believes, (flights, services): 0 before the alarm, then what the
    companion would, from all flights before this one.
    """
    precision = 1.0 / std**2
    means, stds = np.zeros_like(seen.values), np.zeros_like(seen.values)
    information = np.zeros((season.days, seen.alarm.size))
    score = np.zeros_like(information)
    for flight in range(season.flights):
        day = flight // season.per_day
        told = flight > seen.alarm
        if told.any():
            flown = slice(0, day + 1 if flight % season.per_day else day)
            mean, spread = test.since_change(information[flown, told], score[flown, told])
            means[flight, told], stds[flight, told] = np.maximum(mean, 0.0), spread
        information[day] += precision
        score[day] += precision * (seen.values[flight] - test.tolerance)
    return means, stds
