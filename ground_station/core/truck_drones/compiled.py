"""Compilation of the inner loops.

numba's own cache looks only at the file of a compiled function, not at the files of those that it
calls: with a changed `simulate.py` a cached `search.py` would still run the old one. So code is
cached only in a folder that belongs to exactly these sources
(`ground_station.adapters.files.compiled_code`); without one each process compiles again.
"""

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core import config

Function = Callable[..., Any]


def compiled(function: Function) -> Function:
    """The function in machine code. It makes no arrays: so none that it is given is counted, which
    had been two thirds of the time of a search.
    """
    # numba's option is not in its documented ones; code that makes an array fails to compile.
    return njit(cache=_kept(), _nrt=False)(function)  # pyright: ignore[reportCallIssue]


def compiled_with_arrays(function: Function) -> Function:
    """As `compiled`, for functions that make arrays of their own."""
    return njit(cache=_kept())(function)


def _kept() -> bool:
    return bool(config.CACHE_DIR)  # pyright: ignore[reportAttributeAccessIssue]
