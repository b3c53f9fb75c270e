"""The one error that Leeway raises for a mistake in its input."""

import math


class LeewayError(Exception):
    """A mistake that a person can mend: says where, what, and what was expected, in one line."""


class LinkClosedError(LeewayError):
    """A way to the autopilot that does not open now, and may open later: no mistake in the input.

    Another program holds the port, or its other end is not up yet.
    """


class RangeError(LeewayError):
    """A number out of its range: of which `key`, and the least that is allowed."""

    def __init__(self, key: str, value: float, low: float, high: float) -> None:
        self.key, self.low = key, low
        super().__init__(f"{key} = {value!r}: expected a number from {low:g} to {high:g}")


def check_range(key: str, value: float, low: float, high: float) -> None:
    """Raise RangeError naming `key` when `value` is not a finite number in [low, high]."""
    if not (math.isfinite(value) and low <= value <= high):
        raise RangeError(key, value, low, high)
