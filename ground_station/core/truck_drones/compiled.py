"""How this package compiles its inner loops.

numba's own cache looks only at the file of the function that it keeps, not at those it calls: a
changed `simulate.py` would go on running as it was inside a kept `anneal.py`. Code is therefore
kept only where somebody has named a folder that belongs to these very sources
(`ground_station.adapters.files.compiled_code`); else each process compiles anew.
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
