"""Random numbers in compiled code: a separate stream, seeded by a numpy Generator."""

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled_inner

RandomStream = NDArray[np.uint64]


def seeded_stream_from_generator(rng: np.random.Generator) -> RandomStream:
    """Return a stream seeded by the generator."""
    return rng.integers(1, 2**63, size=1, dtype=np.uint64)


@compiled_inner
def draw_uniform(stream):
    """Draw from [0, 1): xorshift64* (Vigna, "An experimental exploration of Marsaglia's xorshift
    generators, scrambled", ACM TOMS 42, 2016)."""
    x = stream[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    stream[0] = x
    return ((x * np.uint64(0x2545F4914F6CDD1D)) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled_inner
def draw_integer_below(stream, bound):
    """Draw an integer from 0 .. most - 1."""
    return int(draw_uniform(stream) * bound)
