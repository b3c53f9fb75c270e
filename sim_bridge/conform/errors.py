"""Mistakes in the use of the suite, and why a behaviour could not be observed."""


class ConformError(ValueError):
    """A mistake in what was asked of the suite: says where, what, and what was expected."""


class CannotSee(Exception):
    """The vehicle did not reach the state in which a behaviour can be observed."""


class VehicleSilent(CannotSee):
    """The vehicle sends nothing any more."""
