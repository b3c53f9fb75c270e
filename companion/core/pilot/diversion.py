"""Rule of a diversion from home to a landing site that keeps the promise, and its reason."""

from typing import NamedTuple

from companion.core.base.geo import Ned
from companion.core.base.probability import home_probability_text
from companion.core.mission.flight_plan import FlightPlan
from companion.core.pilot.estimates import FlightEstimates
from companion.core.return_budget.budget import RemainingMission, format_distinct_probabilities
from companion.core.return_budget.outcomes import SiteMargin

MIN_DIVERT_GAIN = 0.02
"""Minimum gain in safety for a diversion to another landing site."""


class SaferRally(NamedTuple):
    """A rally point that keeps the promise where home no longer does, and what decided it."""

    name: str
    cause: str
    sites: tuple[SiteMargin, ...] | None


def safer_rally(
    rally_name: str, remaining: RemainingMission, home_name: str, estimates: FlightEstimates
) -> SaferRally | None:
    """Return the rally point if home does not keep the promise now and it is safer, else None."""
    now = estimates.assess(
        RemainingMission(remaining.current_return_routes, (), remaining.delivered)
    )
    if now is None:
        return None
    home, rally = now.site_by_name(home_name), now.site_by_name(rally_name)
    max_loss = estimates.limits.max_loss
    if home is not None and (
        home.p_home_now >= 1.0 - max_loss
        or rally is None
        or rally.p_home_now <= home.p_home_now + MIN_DIVERT_GAIN
    ):
        return None
    cause = diversion_cause_text(now.sites, rally_name, home_name, max_loss)
    return SaferRally(rally_name, cause, now.sites)


def diversion_cause_text(
    sites: tuple[SiteMargin, ...], rally_name: str, home_name: str, max_loss: float
) -> str:
    """Return the quantities that decided a diversion, as text."""
    p_home = {site.landing: site.p_home_now for site in sites}
    if home_name not in p_home:
        return f"no route to {home_name}"
    low, high = format_distinct_probabilities(p_home[home_name], 1.0 - max_loss)
    margin_wh = next(site.margin_now_wh for site in sites if site.landing == home_name)
    other = home_probability_text(p_home.get(rally_name, 0.0), 1.0)
    return (
        f"{home_name}: P(home) {low} below {high}, margin {margin_wh:.1f} Wh; {rally_name} {other}"
    )


def stop_left_text(
    stop_name: str, p_home: float, max_loss: float, other_name: str, other_p_home: float
) -> str:
    """Return the reason for leaving a stop for another landing site, as text."""
    low, high = format_distinct_probabilities(p_home, 1.0 - max_loss)
    other = home_probability_text(other_p_home, 1.0)
    return f"{stop_name}: P(home) {low} below {high}; {other_name} {other}"


def has_clear_line_to_rally(flight_plan: FlightPlan, rally_name: str, position_ned_m: Ned) -> bool:
    """Return whether the straight line to a rally point is clear, at its flown height."""
    rally = next((r for r in flight_plan.plan.rally if r.name == rally_name), None)
    level = flight_plan.plan.return_ned_m[-1]
    return rally is not None and flight_plan.is_line_clear_with_height_change(
        position_ned_m, rally.arrival_point_above_site(level)
    )
