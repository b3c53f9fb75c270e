"""What the suite refuses, and why a behaviour could not be seen."""


class ConformError(ValueError):
    """A mistake in what was asked of the suite: says where, what, and what was expected."""


class CannotSee(Exception):
    """The vehicle did not come into the state in which a behaviour can be looked at."""


class VehicleSilent(CannotSee):
    """Nothing is heard of the vehicle any more."""
