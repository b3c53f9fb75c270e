"""The error of the simulator's adapters; light, so that a command line can catch it."""


class EndpointError(ValueError):
    """A URL that cannot be opened: names it and says why."""
