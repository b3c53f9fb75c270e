"""The one error that the simulated world raises for a mistake in its input."""


class TruthError(Exception):
    """A mistake in the input: says where, what, and what was expected, in one line."""
