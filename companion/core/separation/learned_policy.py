"""The learned avoidance actor in numpy: what MADDPG trained, flown without torch.

Observation as in the paper (IV-B): a 155 x 155 view of three binary channels and two vectors.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from companion.core.base.arrays import Bytes, Singles
from companion.core.base.errors import LeewayError

VIEW_CELLS = 155
POOL = 5
VECTOR_SCALE_M = 200.0

SHAPES: dict[str, tuple[int, ...]] = {
    "encoder.first.weight": (8, 3, 5, 5),
    "encoder.first.bias": (8,),
    "encoder.second.weight": (16, 8, 3, 3),
    "encoder.second.bias": (16,),
    "encoder.joined.weight": (64, 260),
    "encoder.joined.bias": (64,),
    "hidden.weight": (64, 64),
    "hidden.bias": (64,),
    "out.weight": (2, 64),
    "out.bias": (2,),
}


@dataclass(frozen=True)
class AvoidancePolicy:
    """Views and vectors of any number of drones -> (heading, speed) in [-1, 1]."""

    weights: Mapping[str, Singles]

    def __post_init__(self) -> None:
        if set(self.weights) != set(SHAPES):
            wrong = sorted(set(self.weights) ^ set(SHAPES))
            raise LeewayError(f"policy: arrays {wrong} missing or unknown")
        for name, shape in SHAPES.items():
            value = self.weights[name]
            if value.shape != shape or not np.isfinite(value).all():
                raise LeewayError(f"policy: {name} is {value.shape}, expected finite {shape}")

    def act(self, view: Bytes, vectors_m: Singles) -> Singles:
        """Actions (B, 2) for views (B, 3, 155, 155) and vectors (B, 4)."""
        return self.act_pooled(pooled(view), vectors_m)

    def act_pooled(self, view: Bytes, vectors_m: Singles) -> Singles:
        """As `act`, for views that are pooled already (B, 3, 31, 31)."""
        seen = self._convolved(view.astype(np.float32), "encoder.first", 3)
        seen = self._convolved(seen, "encoder.second", 2).reshape(len(view), -1)
        joined = np.concatenate([seen, vectors_m / np.float32(VECTOR_SCALE_M)], axis=1)
        hidden = np.maximum(self._linear(joined, "encoder.joined"), 0.0)
        hidden = np.maximum(self._linear(hidden, "hidden"), 0.0)
        return np.tanh(self._linear(hidden, "out"))

    def _linear(self, x: Singles, name: str) -> Singles:
        return x @ self.weights[f"{name}.weight"].T + self.weights[f"{name}.bias"]

    def _convolved(self, x: Singles, name: str, stride: int) -> Singles:
        kernel = self.weights[f"{name}.weight"]
        window = sliding_window_view(x, kernel.shape[2:], axis=(2, 3))[:, :, ::stride, ::stride]
        rows = window.transpose(0, 2, 3, 1, 4, 5).reshape(len(x), *window.shape[2:4], -1)
        out = rows @ kernel.reshape(len(kernel), -1).T + self.weights[f"{name}.bias"]
        return np.maximum(out, 0.0).transpose(0, 3, 1, 2)


def pooled(view: Bytes) -> Bytes:
    """The greatest of each 5 x 5 cells: (..., 155, 155) -> (..., 31, 31)."""
    rows = reduce(np.maximum, [view[..., k::POOL, :] for k in range(POOL)])
    return reduce(np.maximum, [rows[..., k::POOL] for k in range(POOL)])
