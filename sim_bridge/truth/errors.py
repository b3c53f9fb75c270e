"""The one error that the simulated world raises for a mistake in its input."""


class TruthError(Exception):
    """A mistake that a person can mend: says where, what, and what was expected, in one line."""
