"""Two hypotheses of the air, turbulent and calm, weighted by their likelihoods.

A single filter needs about 20 s to learn the turbulence, and cannot learn trim and drag from
changes that it attributes to gusts: in calm air at 18 m/s its error was 0.8 m/s until the vehicle
turned, that of a filter with known calm 0.3 m/s. Two filters therefore process the same
observations: one starts with the parameters' gusts and learns, the other assumes calm air. The
likelihood of each measurement updates their probabilities by Bayes' rule (Magill 1965, a bank of
filters), and the estimate is their mixture. Gusts refute the calm filter within seconds. The
probabilities leak back slowly, since weather changes.

Calm is a hypothesis in light wind only. In stronger wind, turbulence follows from the wind
(Panofsky and Dutton 1984, ch. 6): a calm filter attributes gusts to wrong drag and remains
self-consistent (on a real flight in 6 m/s: drag gains of 0.5 and 0.4, and 10 m/s for a minute).
"""

import math
from collections.abc import Sequence

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.drag_update import TiltInnovation
from companion.core.wind.ekf import WindEstimatorParams, WindState
from companion.core.wind.turbulence import Turbulence

CALM_RATIO = 0.02
"""Ratio of the gust variance in calm air to the prior's: 0.06 m/s where the prior has 0.45."""
AIR_CHANGE_TIME_S = 1000.0
"""[est] Time constant of changes between calm and turbulent air."""
CALM_MAX_WIND_MPS = 3.0
"""Wind below which gusts are independent of it, as in the filter's `least_wind_mps`."""
CALM_PROBABILITY_AFTER_WIND = 0.1
"""[est] Initial probability of calm after stronger wind."""
NOISE_MEMORY_S = 10.0
MIN_NOISE = 0.05


class AirHypotheses:
    """The turbulent and the calm hypothesis, one filter each, and the probability of calm.

    `calm` is `None` in stronger wind: then there is one filter.
    """

    __slots__ = ("_noise", "calm", "chance_calm", "turbulent")

    def __init__(
        self, turbulent: WindState, calm: WindState | None, chance_calm: float = 0.5
    ) -> None:
        self.turbulent = turbulent
        self.calm = None if calm is None else _set_calm_turbulence_in_place(calm)
        self.chance_calm = 0.0 if calm is None else chance_calm
        self._noise = 1.0

    @classmethod
    def create_before_observations(
        cls, airframe: Airframe, params: WindEstimatorParams
    ) -> "AirHypotheses":
        """Create the filters before any observation."""
        calm = WindState(airframe, params) if params.has_calm_hypothesis else None
        return cls(WindState(airframe, params), calm)

    def copy(self) -> "AirHypotheses":
        """Return an independent copy, for filters with additional measurements."""
        calm = None if self.calm is None else self.calm.copy()
        other = AirHypotheses(self.turbulent.copy(), calm, self.chance_calm)
        other._noise = self._noise
        return other

    @property
    def active_filter_states(self) -> tuple[WindState, ...]:
        """The active filters: the turbulent one, and the calm one if it is a hypothesis."""
        return (self.turbulent,) if self.calm is None else (self.turbulent, self.calm)

    @property
    def likelier_filter_state(self) -> WindState:
        """The filter of the more probable hypothesis."""
        return self.turbulent if self.calm is None or self.chance_calm <= 0.5 else self.calm

    def remove_or_restore_calm_hypothesis(self) -> None:
        """Remove the calm hypothesis when the wind is too strong for it; restore it from the other
        filter when the wind has decreased."""
        turbulent = self.turbulent
        if not turbulent.is_wind_std_below_known_limit:
            return
        if turbulent.mean_wind_speed_minus_std_mps > CALM_MAX_WIND_MPS:
            self.calm, self.chance_calm = None, 0.0
        elif self.calm is None and turbulent.allows_calm_hypothesis:
            self.calm, self.chance_calm = (
                _set_calm_turbulence_in_place(turbulent.copy()),
                CALM_PROBABILITY_AFTER_WIND,
            )

    def update_calm_probability(
        self, innovations: Sequence[TiltInnovation], max_sigmas: float, dt_s: float
    ) -> None:
        """Update the probability of calm by one measurement's innovations: turbulent filter first.

        Readings may be better or worse than their stated noise, regardless of the air: innovations
        are normalised by the recent ones of the turbulent filter.
        """
        share = -math.expm1(-dt_s / NOISE_MEMORY_S)
        self._noise += share * (min(innovations[0].mean_nis, max_sigmas**2) - self._noise)
        if self.calm is None:
            return
        noise = max(self._noise, MIN_NOISE)
        turbulent, calm = (one.capped_log_density(max_sigmas, noise) for one in innovations[:2])
        odds = (
            self.chance_calm
            / (1.0 - self.chance_calm)
            * math.exp(_clamp_log_ratio(calm - turbulent))
        )
        leak = -math.expm1(-dt_s / AIR_CHANGE_TIME_S)
        self.chance_calm = (1.0 - leak) * odds / (1.0 + odds) + 0.5 * leak

    def ten_second_wind_mean_and_cov(self, since_last_update_s: float) -> tuple[Floats, Floats]:
        """Return mean and covariance of the mixture, see
        `WindState.ten_second_wind_mean_and_cov`.
        """
        turbulent, turbulent_cov = self.turbulent.ten_second_wind_mean_and_cov(since_last_update_s)
        if self.calm is None:
            return turbulent, turbulent_cov
        calm, calm_cov = self.calm.ten_second_wind_mean_and_cov(since_last_update_s)
        p = self.chance_calm
        difference = calm - turbulent
        cov = (
            (1.0 - p) * turbulent_cov
            + p * calm_cov
            + p * (1.0 - p) * np.outer(difference, difference)
        )
        return turbulent + p * difference, cov


def _set_calm_turbulence_in_place(state: WindState) -> WindState:
    state.turbulence = Turbulence(CALM_RATIO, is_given=True)
    return state


def _clamp_log_ratio(log_ratio: float) -> float:
    """Limit one measurement's log likelihood ratio: innovations are Gaussian only near the mean."""
    return min(max(log_ratio, -10.0), 10.0)
