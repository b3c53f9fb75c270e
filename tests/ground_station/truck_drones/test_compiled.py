"""How the inner loops are compiled."""

from typing import Any, NamedTuple, cast

import numpy as np
import pytest
from numba import typeof, types
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled, compiled_inner
from ground_station.core.truck_drones.tuple_reference import passed_by_reference


@passed_by_reference
class Inner(NamedTuple):
    rows: NDArray[np.float64]
    offset: int


@passed_by_reference
class Outer(NamedTuple):
    scale: float
    inner: Inner


@compiled_inner
def scaled_row(outer, row):
    return outer.scale * outer.inner.rows[row, 0] + outer.inner.offset


@compiled
def sum_of_rows(outer):
    total = scaled_row(outer, 0)
    for row in range(1, outer.inner.rows.shape[0]):
        total += scaled_row(outer, row)
    outer.inner.rows[0, 0] = -1.0
    return total


def test_a_named_tuple_by_reference_is_read_and_its_arrays_written():
    rows = np.array([[1.0], [10.0]])
    assert sum_of_rows(Outer(2.0, Inner(rows, 5))) == 2.0 * 11.0 + 2 * 5
    assert rows[0, 0] == -1.0


def test_an_integer_and_a_literal_share_one_compilation():
    outer, dispatcher = typeof(Outer(2.0, Inner(np.ones((2, 1)), 5))), cast(Any, scaled_row)
    for row_type in (types.literal(0), types.literal(1), types.int64):
        dispatcher.get_call_template([outer, row_type], {})
    assert len(dispatcher.signatures) == 1


def test_an_inner_function_refuses_calls_from_python():
    """Without the refusal, a call would end the process: there is no entry point for Python."""
    outer = Outer(2.0, Inner(np.ones((2, 1)), 5))
    for _ in range(2):
        with pytest.raises(TypeError, match="scaled_row: only compiled code"):
            scaled_row(outer, 0)
        sum_of_rows(outer)
