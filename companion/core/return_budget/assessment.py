"""Parameters and result of the return budget's gate."""

from dataclasses import dataclass

from companion.core.return_budget.outcomes import SiteMargin

SUPPORTED_LOSS = 1.0 / 256.0
"""Smallest loss that is stated to people: recorded wind supports no smaller one
(docs/results/promise.md)."""


@dataclass(frozen=True, slots=True)
class GateParams:
    """Risk parameters of the gate. `reserve_wh` is the energy that must remain after landing.

    `min_success`: the gate turns back, at departure and in flight, if P(success) is lower: without
    a delivery there is no reason to fly, however safe. Default: less than one delivery in twenty
    flights; the 128 policy samples have a standard error of 0.02 there, so that it is not 0.
    """

    max_loss: float
    reserve_wh: float
    min_success: float = 0.05
    samples: int = 384


@dataclass(frozen=True, slots=True)
class ModelDoubt:
    """Upper credible bounds of the variance of changes of the wind and of the standard deviation of
    the energy model, in multiples of the modelled ones (`RiskEvidence`).
    """

    wind_variance_factor: float = 1.0
    model_std_factor: float = 1.0


@dataclass(frozen=True, slots=True)
class Assessment:
    """Result of the gate; probabilities as in docs/reference/outcomes.md.

    `turn_back`: fly home now, to `best_landing`. `p_home_unattended`: P(home) without further
    commands (None if no route home has unattended legs). `margin_wh`: energy above the need of
    `required_p_home` by way of the best landing site, from the next decision point or, on the
    return flight, from the current position. `energy_need_wh`: mean need of the whole remaining
    mission.

    The gate's decision follows from `required_p_home`, `p_home_next` (from the next decision point,
    or a better one beyond it), `p_home_onward` and `p_success_onward` (if it flies on now) and
    `p_home_now`, a diversion from `sites` (docs/reference/outcomes.md).
    """

    t_s: float
    p_home: float
    p_home_now: float
    p_success: float
    margin_wh: float
    turn_back: bool
    best_landing: str
    p_home_unattended: float | None
    energy_left_wh: float
    energy_need_wh: float
    reason: str
    p_home_limit: float = 1.0
    required_p_home: float = 1.0
    p_home_next: float = 0.0
    p_home_onward: float = 0.0
    p_success_onward: float = 0.0
    sites: tuple[SiteMargin, ...] = ()

    @property
    def p_home_stated(self) -> float:
        """P(home) as stated to people: at most the limit of evidence."""
        return min(self.p_home, self.p_home_limit)

    def site_by_name(self, landing: str) -> SiteMargin | None:
        """Return P(home) and margins of a landing site; None if no route leads there."""
        return next((site for site in self.sites if site.landing == landing), None)
