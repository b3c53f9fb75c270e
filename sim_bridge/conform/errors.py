"""Errors in the use of the suite, and behaviours that could not be observed."""


class ConformError(ValueError):
    """An invalid request to the suite; the message states where, what, and what was expected."""


class ObservationError(Exception):
    """The vehicle did not reach the state in which a behaviour can be observed."""


class VehicleSilent(ObservationError):
    """The vehicle has stopped sending."""
