"""The one error that the simulated world raises for a mistake in its input."""


class TruthError(Exception):
    """An invalid input; the one-line message states where, what, and what was expected."""
