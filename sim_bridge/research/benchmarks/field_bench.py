"""What one update of the fleet's wind costs: tellings of all drones in, field settled."""

from dataclasses import dataclass

import numpy as np

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.field_belief import FieldBelief
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.fronts import FeltChange, FrontAhead
from companion.core.wind_field.tellings import TELLING_S, WindTelling
from sim_bridge.research.benchmarks.timing import Samples, cpu_time_s
from sim_bridge.research.results.sheet import Sheet

DRONES = (1, 8, 24, 100)
ROUNDS, WARM = 120, 60
HEIGHT_M, SPEED_MPS, SITE_M = 40.0, 12.0, 1500.0
ASKED = 20
"""Points of a forecast: a way home at some times to come."""


@dataclass(frozen=True)
class FieldCost:
    """CPU times with so many drones: to take all tellings and settle, and to forecast, s."""

    drones: int
    update: Samples
    forecast: Samples
    front: bool = False


def measured(drones: int, seed: int, *, front: bool = False) -> FieldCost:
    """All drones tell every 10 s for twenty minutes; the first ten are not counted.

    `front`: one passes all that time.
    """
    rng = np.random.default_rng([seed, drones])
    belief = FieldBelief(FieldProcess(read_wind_process("coast")))
    place = rng.uniform(-SITE_M, SITE_M, (drones, 2))
    course = rng.uniform(0.0, 2.0 * np.pi, drones)
    step = SPEED_MPS * TELLING_S * np.stack([np.cos(course), np.sin(course)], axis=1)
    updates: list[float] = []
    forecasts: list[float] = []
    for index in range(ROUNDS):
        now_s = TELLING_S * index
        place = (place + step + SITE_M) % (2.0 * SITE_M) - SITE_M
        wind = np.array([-8.0, 1.0]) + rng.standard_normal((drones, 2))
        tellings = [
            WindTelling(
                f"d{k}",
                now_s,
                (float(place[k, 0]), float(place[k, 1])),
                HEIGHT_M,
                (float(wind[k, 0]), float(wind[k, 1])),
                (0.25, 0.02, 0.3),
            )
            for k in range(drones)
        ]

        if front:
            belief.expect_front(_front_in_the_middle(now_s))

        def update(now_s: float = now_s, tellings: list[WindTelling] = tellings) -> None:
            for telling in tellings:
                belief.tell(telling, now_s)
            belief.settle(now_s)

        spent_s = cpu_time_s(update)
        field = belief.settle(now_s)
        where = rng.uniform(-SITE_M, SITE_M, (ASKED, 2))
        asked = FieldPoints(where, np.full(ASKED, HEIGHT_M), now_s + np.linspace(0, 300.0, ASKED))
        asked_s = cpu_time_s(lambda field=field, asked=asked: field.forecast(asked))
        if index >= WARM:
            updates.append(spent_s)
            forecasts.append(asked_s)
    return FieldCost(drones, Samples.of(updates, 1e3), Samples.of(forecasts, 1e3), front)


def _front_in_the_middle(now_s: float) -> FrontAhead:
    """Felt by the first drone; it comes from the north at 10 m/s and is over the middle now."""
    felt = FeltChange("d0", now_s, (0.0, 0.0), (-8.0, 0.0), (-16.0, 1.0), 30.0)
    slow = np.array([-0.1, 0.0])
    return FrontAhead(now_s, (felt,), np.zeros(2), now_s, slow, np.diag([25.0, 1e-4, 1e-4]))


def sheet(costs: list[FieldCost]) -> Sheet:
    """Least, median and 99 % of each."""
    cells = [
        [
            f"{one.drones}{', a front' if one.front else ''}",
            *(f"{v:.2f}" for v in (one.update.least, one.update.median, one.update.p99)),
            f"{one.forecast.median:.2f}",
        ]
        for one in costs
    ]
    head = ["drones", "update ms, least", "median", "99 %", f"forecast of {ASKED} points ms"]
    note = (
        f"CPU time of one core. Every {TELLING_S:g} s all drones tell, and the field is settled;"
        " the least is what a quiet machine takes."
    )
    return Sheet("The wind of a fleet: one update", head, cells, note)
