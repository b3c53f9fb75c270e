"""Texts on risk and decisions for operators: "1 in 2,400" instead of a probability of return."""

import math
import re

import msgspec

from companion.core.base.probability import home_probability_text
from companion.core.mission.event_text import DecisionEvent

MIN_STATED_LOSS = 1e-5
"""Smaller risks are stated as below this one: no evidence supports them."""

PERCENT_ABOVE_LOSS = 0.1
_P_HOME = re.compile(r"P\(home\)((?: from the next point| at [\w.-]+)?)(?: (?=[01]))?([01]\.\d+)?")
_BELOW = re.compile(r"(?<=% )(is below )([01]\.\d+|[01])")
_LIMIT = re.compile(r"below (?:the (?:accepted|required) )?([01]\.\d+)")
_SITE_AFTER_LIMIT = re.compile(r"(; [\w.-]+ )([01]\.\d+)")
_P_SUCCESS = re.compile(r"P\(success\) ([01](?:\.\d+)?)")
_REQUIRED = re.compile(r"required ([01]\.\d+) at one decision, ([01]\.\d+) over")
_KIND_TEXT = {
    "go": "Cleared to fly",
    "looked_again": "Checked again",
    "turn_back": "Turns back",
    "divert": "Diverts",
    "move_home": "Lands at another stop",
    "onward_again": "Flies on to the customer",
    "last_resort": "Lands at once",
    "link_back": "Radio contact is back",
}


def format_loss(loss: float) -> str:
    """Return a risk with two significant figures; above 1 in 10 in per cent."""
    if loss > PERCENT_ABOVE_LOSS * (1.0 + 1e-9):
        return f"{100.0 * min(loss, 1.0):.0f} %"
    if loss < MIN_STATED_LOSS * (1.0 - 1e-9):
        return f"below 1 in {1.0 / MIN_STATED_LOSS:,.0f}"
    count = 1.0 / loss
    step = 10.0 ** (math.floor(math.log10(count) + 1e-9) - 1)
    return f"1 in {round(count / step) * step:,.0f}"


def format_risk(
    p_home: float | None, p_home_limit: float | msgspec.UnsetType = msgspec.UNSET
) -> str:
    """Return the risk of not returning, at least that of the limit of evidence; empty: unknown."""
    if p_home is None:
        return ""
    if p_home_limit and p_home_limit < p_home:
        return home_probability_text(p_home, p_home_limit).removeprefix("risk ")
    return format_loss(1.0 - p_home)


def format_decision(text: str) -> str:
    """Return a decision event as a sentence that names the quantity that decided."""
    event = DecisionEvent.parse(text)
    reason = format_reason(event.reason)
    kind = _KIND_TEXT.get(event.kind, event.kind.replace("_", " ").capitalize())
    site = event.diversion_site
    if site is not None:
        kind, reason = f"{kind} to {site}", reason.partition(": ")[2]
    return f"{kind}: {reason}" if reason else kind


def format_reason(reason: str) -> str:
    """Return a reason of the return gate with risks instead of probabilities of return."""
    text = _P_SUCCESS.sub(lambda m: f"chance to deliver {_percent(m[1])}", reason)
    text = _BELOW.sub(lambda m: f"{m[1]}{_percent(m[2])}", text)
    if "P(home)" not in text:
        return text
    text = _P_HOME.sub(
        lambda m: f"risk{m[1]}{f' {format_risk(float(m[2]))}' if m[2] else ''}", text
    )
    text = _LIMIT.sub(lambda m: f"above the limit {format_risk(float(m[1]))}", text)
    text = _SITE_AFTER_LIMIT.sub(lambda m: m[1] + format_risk(float(m[2])), text)
    both = _REQUIRED.search(text)
    if both:
        limits = [format_risk(float(value)) for value in both.groups()]
        text = text.replace(both[0], f"limit {limits[0]} at one decision, {limits[1]} over")
    return text


def _percent(share: str) -> str:
    return f"{100.0 * float(share):.0f} %"
