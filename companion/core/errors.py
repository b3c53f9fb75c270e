"""The one error that Leeway raises for a mistake in its input."""


class LeewayError(Exception):
    """A mistake that a person can mend: says where, what, and what was expected, in one line."""
