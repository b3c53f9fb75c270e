"""Learned avoidance actor (trained by MADDPG) in numpy, so that flights need no torch.

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
    """Actor network: views and vectors of any number of drones -> (heading, speed) in [-1, 1]."""

    weights: Mapping[str, Singles]

    def __post_init__(self) -> None:
        if set(self.weights) != set(SHAPES):
            wrong = sorted(set(self.weights) ^ set(SHAPES))
            raise LeewayError(f"policy: missing or unknown arrays {wrong}")
        for name, shape in SHAPES.items():
            value = self.weights[name]
            if value.shape != shape or not np.isfinite(value).all():
                raise LeewayError(f"policy: {name} is {value.shape}, expected finite {shape}")

    def heading_and_speed_actions(self, views: Bytes, vectors_m: Singles) -> Singles:
        """Return actions (B, 2) for views (B, 3, 155, 155) and vectors (B, 4)."""
        return self.heading_and_speed_actions_from_pooled(max_pooled_view(views), vectors_m)

    def heading_and_speed_actions_from_pooled(
        self, pooled_views: Bytes, vectors_m: Singles
    ) -> Singles:
        """Return actions as `heading_and_speed_actions`, for pooled views (B, 3, 31, 31)."""
        seen = self._apply_convolution_and_relu(pooled_views.astype(np.float32), "encoder.first", 3)
        seen = self._apply_convolution_and_relu(seen, "encoder.second", 2).reshape(
            len(pooled_views), -1
        )
        joined = np.concatenate([seen, vectors_m / np.float32(VECTOR_SCALE_M)], axis=1)
        hidden = np.maximum(self._apply_linear_layer(joined, "encoder.joined"), 0.0)
        hidden = np.maximum(self._apply_linear_layer(hidden, "hidden"), 0.0)
        return np.tanh(self._apply_linear_layer(hidden, "out"))

    def _apply_linear_layer(self, inputs: Singles, layer_name: str) -> Singles:
        return inputs @ self.weights[f"{layer_name}.weight"].T + self.weights[f"{layer_name}.bias"]

    def _apply_convolution_and_relu(self, inputs: Singles, layer_name: str, stride: int) -> Singles:
        kernel = self.weights[f"{layer_name}.weight"]
        window = sliding_window_view(inputs, kernel.shape[2:], axis=(2, 3))[
            :, :, ::stride, ::stride
        ]
        rows = window.transpose(0, 2, 3, 1, 4, 5).reshape(len(inputs), *window.shape[2:4], -1)
        out = rows @ kernel.reshape(len(kernel), -1).T + self.weights[f"{layer_name}.bias"]
        return np.maximum(out, 0.0).transpose(0, 3, 1, 2)


def max_pooled_view(view: Bytes) -> Bytes:
    """Return the maximum of each 5 x 5 cells: (..., 155, 155) -> (..., 31, 31)."""
    rows = reduce(np.maximum, [view[..., k::POOL, :] for k in range(POOL)])
    return reduce(np.maximum, [rows[..., k::POOL] for k in range(POOL)])
