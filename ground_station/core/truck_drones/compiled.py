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
    """The function in machine code."""
    kept = bool(config.CACHE_DIR)  # pyright: ignore[reportAttributeAccessIssue]
    return njit(cache=kept)(function)
