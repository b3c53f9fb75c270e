"""Simulated services: daily log ratios of many vehicles, the companion's tests, and the gate.

The sequential tests are the companion's; this module draws data, runs them over many services, and
counts the flights that the gate allows and loses. One decision per flight, by the rule of the
budget (`Budget.p_enough`): is a mission with a drawn energy need allowed? A loss is an allowed
flight that uses more than its pack provides. No flight turns back or updates its estimates en
route, and the reserve is not used, so that losses are frequent enough to be counted.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from companion.core.base.arrays import Bools, Floats
from companion.core.monitor.e_process import ShareTest, ShiftTest

FULL_WH, PACK_STD_FRAC, MODEL_STD_FRAC = 105.0, 0.02, 0.04
"""Energy of an M100's pack above its reserve, and errors from its airframe file."""

LEAST_NEED, MOST_NEED = 0.7, 1.0
"""Range of the energy need as a share of a full pack, near the limit of the gate."""


@dataclass(frozen=True, slots=True)
class World:
    """Distribution of a log ratio. All flights of a day share one draw of the day."""

    name: str
    mean: float
    day_std: float
    flight_std: float


@dataclass(frozen=True, slots=True)
class ServicePlan:
    """Length of a service, and a change `change_size` from the flight of index `change` on."""

    flights: int = 500
    per_day: int = 10
    change: int | None = None
    change_size: float = 0.0

    @property
    def day_count(self) -> int:
        return -(-self.flights // self.per_day)

    @property
    def log_ratio_shifts(self) -> Floats:
        """Amount added to the log ratio of each flight, (flights,)."""
        first = self.flights if self.change is None else self.change
        return np.where(np.arange(self.flights) >= first, self.change_size, 0.0)


@dataclass(frozen=True, slots=True)
class AlarmHistory:
    """Test results. `alarm` (services,): index of the flight that triggers the alarm, inf if none.
    `log_e` (flights, services): log e-values. `values` (flights, services): log ratios.
    """

    alarm: Floats
    log_e: Floats
    values: Floats


def simulate_shift_alarms(
    test: ShiftTest,
    std: float,
    log_e_limit: float,
    world: World,
    service: ServicePlan,
    service_count: int,
    rng: np.random.Generator,
) -> AlarmHistory:
    """Simulate `service_count` services; an alarm is a log e-value from `log_e_limit`."""
    evidence = test.initial_evidence((service_count,))
    days = rng.standard_normal((service.day_count, service_count))
    shared = world.mean + world.day_std * days
    log_e = np.zeros((service.flights, service_count))
    values = np.zeros_like(log_e)
    for flight, shift in enumerate(service.log_ratio_shifts):
        day, first = divmod(flight, service.per_day)
        if first == 0:
            evidence = test.start_next_day(evidence)
        own = world.flight_std * rng.standard_normal(service_count)
        values[flight] = shared[day] + own + shift
        evidence = test.with_added_flight(evidence, values[flight], std)
        log_e[flight] = test.log_e_value(evidence)
    return AlarmHistory(first_flight_index_at_limit(log_e, log_e_limit), log_e, values)


def simulate_check_failure_alarms(
    test: ShareTest,
    log_e_limit: float,
    failure_probability_by_day: Floats,
    checks_per_flight: int,
    flights_per_day: int,
    rng: np.random.Generator,
) -> Floats:
    """Return the flight index of the alarm, (services,). `failure_probability_by_day` (days,
    services): probability per day that a check fails; `checks_per_flight`: checks per flight.
    """
    days, services = failure_probability_by_day.shape
    evidence = test.initial_evidence((services,))
    log_e = np.zeros((days * flights_per_day, services))
    for flight in range(days * flights_per_day):
        day, first = divmod(flight, flights_per_day)
        if first == 0:
            evidence = test.start_next_day(evidence)
        log_e[flight] = test.log_e_value(evidence)
        failures = rng.binomial(checks_per_flight, failure_probability_by_day[day])
        evidence = test.with_added_flight(evidence, failures, checks_per_flight)
    return first_flight_index_at_limit(log_e, log_e_limit)


def first_flight_index_at_limit(log_e: Floats, limit: float) -> Floats:
    """Return the index of the first flight that reaches `limit`, (services,); inf if none."""
    reached = log_e >= limit
    return np.where(reached.any(axis=0), reached.argmax(axis=0).astype(float), np.inf)


def shift_estimates_after_alarm(
    test: ShiftTest, std: float, alarm_history: AlarmHistory, service: ServicePlan
) -> tuple[Floats, Floats]:
    """Return the (mean, std) that each flight uses, (flights, services): 0 until the alarm, then
    the companion's estimate from all previous flights.
    """
    precision = 1.0 / std**2
    mean_estimates, stds = np.zeros_like(alarm_history.values), np.zeros_like(alarm_history.values)
    information = np.zeros((service.day_count, alarm_history.alarm.size))
    score = np.zeros_like(information)
    for flight in range(service.flights):
        day, first = divmod(flight, service.per_day)
        is_alarmed = flight > alarm_history.alarm
        if is_alarmed.any():
            flown = slice(0, day + 1 if first else day)
            mean, spread = test.mean_and_std_since_change(
                information[flown, is_alarmed], score[flown, is_alarmed]
            )
            mean_estimates[flight, is_alarmed] = np.maximum(mean, 0.0)
            stds[flight, is_alarmed] = spread
        information[day] += precision
        score[day] += precision * (alarm_history.values[flight] - test.tolerance)
    return mean_estimates, stds


def period_masks(alarm_history: AlarmHistory, change: int) -> dict[str, Bools]:
    """Return the flights of each period, (flights, services), by its name."""
    flight = np.arange(len(alarm_history.values))[:, None]
    changed = np.broadcast_to(flight >= change, alarm_history.values.shape)
    after = flight > alarm_history.alarm
    return {
        "before the change": ~changed & ~after,
        "until the alarm": changed & ~after,
        "after the alarm": changed & after,
    }


@dataclass(frozen=True, slots=True)
class Losses:
    """Counts of requested, allowed and lost flights."""

    asked: int
    allowed: int
    lost: int

    @property
    def share(self) -> float:
        """Share of the allowed flights that are lost."""
        return self.lost / max(self.allowed, 1)

    @property
    def allowed_share(self) -> float:
        """Share of the requested flights that are allowed."""
        return self.allowed / self.asked


def count_losses(
    log_energy_ratio: Floats,
    log_capacity_frac: Floats,
    estimated_mean_std_capacity: tuple[Floats, Floats, Floats],
    max_loss: float,
    rng: np.random.Generator,
) -> Losses:
    """Evaluate one mission per flight. `log_energy_ratio`: log ratio of used to modelled energy;
    `log_capacity_frac`: log of the actual capacity share; `estimated_mean_std_capacity`: estimated
    mean and std of `log_energy_ratio`, and estimated capacity share. All arrays have the same
    shape.
    """
    mean, std, share = estimated_mean_std_capacity
    need_wh = FULL_WH * rng.uniform(LEAST_NEED, MOST_NEED, log_energy_ratio.shape)
    expected_wh, left_wh = need_wh * np.exp(mean), FULL_WH * share
    spread_wh = np.hypot(PACK_STD_FRAC * left_wh, np.hypot(MODEL_STD_FRAC, std) * expected_wh)
    allowed = ndtr((left_wh - expected_wh) / spread_wh) >= 1.0 - max_loss
    pack_error = PACK_STD_FRAC * rng.standard_normal(log_energy_ratio.shape)
    has_wh = FULL_WH * np.exp(log_capacity_frac + pack_error)
    lost = allowed & (need_wh * np.exp(log_energy_ratio) > has_wh)
    return Losses(log_energy_ratio.size, int(allowed.sum()), int(lost.sum()))
