"""Calls from Python of functions that only compiled code can call."""

from typing import Any

from numba import njit


def callable_from_python(inner_function: Any) -> Any:
    """Return a compiled function that calls this one (`compiled_inner`)."""
    return njit(lambda *args: inner_function(*args))
