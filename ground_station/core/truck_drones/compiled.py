"""Compilation of the inner loops.

numba's cache checks only the file of a compiled function, not the files of its callees: with a
changed `simulate.py` a cached `search.py` would still run the old code. Code is therefore cached
only in a folder specific to these sources (`ground_station.adapters.files.compiled_code`); without
one each process compiles again.

The first plan after an installation waits for the compiler. Its time grows with the number of
compiled signatures and with the values that each call passes: integers have one type, literals are
passed as their type, and the named tuples of arrays are passed by reference.
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core import config
from numba.core.registry import CPUDispatcher

Function = Callable[..., Any]


class _LiteralFreeDispatcher(CPUDispatcher):
    """Compiles a call that passes a literal as one that passes its type; numba compiles each
    literal separately.
    """

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(
            [types.unliteral(arg) for arg in args],
            {name: types.unliteral(arg) for name, arg in kws.items()},
        )


class _InnerDispatcher(_LiteralFreeDispatcher):
    """Has no entry point for Python: a call from there looks for one in vain, then compiles."""

    def _insert(self, *_: object, **__: object) -> None: ...

    def _compile_for_args(self, *_: object, **__: object) -> None:
        raise TypeError(f"{self.py_func.__name__}: only compiled code can call it (compiled_inner)")


def compiled(function: Function) -> Function:
    """Compile a function that creates no arrays. Reference counting of its array arguments is off:
    it takes two thirds of the time of a search.
    """
    # An undocumented numba option; code that creates an array fails to compile.
    return _dispatch(_LiteralFreeDispatcher, function, _nrt=False)


def compiled_inner(function: Function) -> Function:
    """Compile as `compiled` does, for callers that are compiled: without the conversion of
    arguments from Python, which takes a quarter of the compiler's time.

    Raises TypeError if called from Python.
    """
    return _dispatch(_InnerDispatcher, function, _nrt=False, no_cpython_wrapper=True)


def compiled_with_arrays(function: Function) -> Function:
    """Compile a function that creates arrays."""
    return _dispatch(_LiteralFreeDispatcher, function)


def _dispatch(
    dispatcher_class: type[_LiteralFreeDispatcher], function: Function, **options: bool
) -> Function:
    dispatcher = dispatcher_class(function, targetoptions={"nopython": True, **options})
    if config.CACHE_DIR:  # pyright: ignore[reportAttributeAccessIssue]
        dispatcher.enable_caching()
    return dispatcher
