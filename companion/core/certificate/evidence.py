"""Limit of evidence: the P(home) that recorded wind and certified days support.

P(home) of the gate holds at the fitted parameters of wind and draw. Both have a spread that few
observations determine. With n independent ones and a vague prior, the posterior of a variance is
scaled inverse chi-square with n degrees of freedom (Gelman and others, Bayesian Data Analysis,
2013, 2.6): with 95 % probability it is at most n / chi2_0.05(n) times the fitted one. The limit of
evidence of a decision is its P(home) with both variances at these bounds, the lower credible bound
over their posterior.

Observations of the wind: the recorded time behind the process, in blocks of one return, or the
fewer independent ones that the process states because its sites differ. Of the draw: the
certificate's days, because flights of one day are not exchangeable; an airframe without a
certificate counts as one with the fewest days.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.probability import chi_square_upper_quantile
from companion.core.certificate.certificate import MIN_DAYS, Certificate, percent_text
from companion.core.certificate.support import COVERAGE
from companion.core.return_budget.assessment import SUPPORTED_LOSS, ModelDoubt
from companion.core.wind.process import WindProcessParams

RETURN_S = 300.0
"""Duration of one observation of the wind: a return, and the horizon up to which changes of the
wind have Student's tails. Changes over successive blocks of this length are nearly uncorrelated."""

MAX_VARIANCE_FACTOR = 1e4  # without observations: no P(home) has support


def variance_upper_factor(observations: float) -> float:
    """Return the upper credible bound of a variance over its estimate."""
    if observations < 1.0:
        return MAX_VARIANCE_FACTOR
    (quantile,) = chi_square_upper_quantile(observations, np.array([COVERAGE]))
    return min(observations / float(quantile), MAX_VARIANCE_FACTOR)


@dataclass(frozen=True, slots=True)
class RiskEvidence:
    """Recorded wind and certified days behind P(home)."""

    wind_process: WindProcessParams
    certificate: Certificate | None = None

    @property
    def doubt(self) -> ModelDoubt:
        """Bounds of the models' spread."""
        days = MIN_DAYS if self.certificate is None else len(self.certificate.days)
        return ModelDoubt(
            variance_upper_factor(self._returns), math.sqrt(variance_upper_factor(days))
        )

    @property
    def _returns(self) -> float:
        recorded = (self.wind_process.recorded_s or 0.0) / RETURN_S
        stated = self.wind_process.independent_returns
        return recorded if stated is None else min(recorded, stated)

    @property
    def sources_text(self) -> str:
        """Hours, flights and days behind the limit, as text."""
        process, certificate = self.wind_process, self.certificate
        wind = (
            f"no recorded wind (wind process {process.name}: recorded_s is missing)"
            if process.recorded_s is None
            else f"{process.recorded_s / 3600.0:.1f} h of recorded wind ({process.name},"
            f" {self._returns:.0f} returns)"
        )
        if certificate is None:
            return f"{wind} and no certified flights"
        flights = sum(day.flights for day in certificate.days)
        return f"{wind} and {flights} certified flights on {len(certificate.days)} days"

    @property
    def summary_text(self) -> str:
        """The evidence and the bounds that it gives, as text."""
        doubt = self.doubt
        return (
            f"{self.sources_text}: with {percent_text(COVERAGE)} probability the wind varies at"
            f" most {math.sqrt(doubt.wind_variance_factor):.1f} times as much as modelled and the"
            f" draw {doubt.model_std_factor:.1f} times"
        )

    def missing_support_text(self, max_loss: float) -> str:
        """Return that this accepted loss is below what can be supported, as text; "": it is not."""
        if max_loss >= SUPPORTED_LOSS:
            return ""
        return (
            f"accepted loss of {percent_text(max_loss)} is below {percent_text(SUPPORTED_LOSS)},"
            f" the smallest that is stated, by {self.sources_text}: it rests on the models"
        )
