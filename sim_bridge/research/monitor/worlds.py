"""Simulated services: what the flights of many vehicles tell, day by day, true of the world or not.

Draws only; the bets are the companion's own.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats

M100_DAY_STD, M100_FLIGHT_STD = 0.015, 0.024
"""Log ratio of used to modelled energy: 119 flights of an M100 (Rodrigues et al., 2021)."""

FALL_FRAC = 0.55
"""Share of the charge that a flight takes, as the default flight does."""


@dataclass(frozen=True, slots=True)
class World:
    """How a log ratio scatters. `day_memory` is the correlation of one day's part with the next's;
    `flight_dof` of Student's t, None: normal. Each day is a new draw that all its flights share.
    """

    name: str
    mean: float
    day_std: float
    flight_std: float
    day_memory: float = 0.0
    flight_dof: float | None = None

    def days(self, services: int, days: int, rng: np.random.Generator) -> Floats:
        """The shared part of each day, (days, services)."""
        fresh = rng.standard_normal((days, services))
        rho, spread = self.day_memory, math.sqrt(1.0 - self.day_memory**2)
        for day in range(1, days):
            fresh[day] = rho * fresh[day - 1] + spread * fresh[day]
        return self.mean + self.day_std * fresh

    def flights(self, services: int, rng: np.random.Generator) -> Floats:
        """One flight's own part, (services,)."""
        dof = self.flight_dof
        if dof is None:
            return self.flight_std * rng.standard_normal(services)
        unit = rng.standard_t(dof, services) / math.sqrt(dof / (dof - 2.0))
        return self.flight_std * unit


@dataclass(frozen=True, slots=True)
class Season:
    """How long a service is, and when something changes: at the flight of index `change`."""

    flights: int = 500
    per_day: int = 10
    change: int | None = None
    by: float = 0.0

    @property
    def days(self) -> int:
        return -(-self.flights // self.per_day)

    def shift(self, flight: int) -> float:
        """What is added to the log ratio of a flight."""
        return self.by if self.change is not None and flight >= self.change else 0.0
