"""The error of the simulator's adapters; light, so that a command line can catch it."""


class EndpointError(ValueError):
    """The URL cannot be opened. The message contains the URL and the reason."""
