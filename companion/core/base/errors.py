"""The exceptions for mistakes in Leeway's input."""

import math


class LeewayError(Exception):
    """A mistake that a person can correct. States where, what and what was expected."""


class LinkClosedError(LeewayError):
    """A link to the autopilot that does not open now, and may open later: no mistake in the input.

    Another program holds the port, or the other end is not up yet.
    """


class RangeError(LeewayError):
    """A number out of its range, with its `key` and the minimum."""

    def __init__(self, key: str, value: float, low: float, high: float) -> None:
        self.key, self.low = key, low
        super().__init__(f"{key} = {value!r}: expected a number from {low:g} to {high:g}")


def check_range(key: str, value: float, low: float, high: float) -> None:
    """Raise RangeError with `key` unless `value` is a finite number in [low, high]."""
    if not (math.isfinite(value) and low <= value <= high):
        raise RangeError(key, value, low, high)
