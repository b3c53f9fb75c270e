"""A small grid of a computed flow, written as Gazebo's RotorS wind plugin reads it."""

from collections.abc import Callable

import numpy as np

FACTORS = (0.0, 0.1, 0.4, 1.0)
X_M, Y_M = np.arange(-200.0, 201.0, 100.0), np.arange(-100.0, 101.0, 50.0)
TOP_M = 400.0


def ground_m(x_m: float, _y_m: float) -> float:
    return 20.0 + 0.05 * x_m


def grid_text(u_mps: Callable[..., float], v_mps: Callable[..., float]) -> str:
    """Return the plugin's text; x runs first, then y, then upward. Speeds of x, y and height."""
    columns = [(x, y) for y in Y_M for x in X_M]
    nodes = [(x, y, f * (TOP_M - ground_m(x, y))) for f in FACTORS for x, y in columns]
    values = {
        "min_x": [X_M[0]],
        "min_y": [Y_M[0]],
        "n_x": [X_M.size],
        "n_y": [Y_M.size],
        "res_x": [100.0],
        "res_y": [50.0],
        "vertical_spacing_factors": FACTORS,
        "bottom_z": [ground_m(x, y) for x, y in columns],
        "top_z": [TOP_M] * len(columns),
        "u": [u_mps(*node) for node in nodes],
        "v": [v_mps(*node) for node in nodes],
        "w": [0.0] * len(nodes),
    }
    return "\n".join(f"{key}: \n{' '.join(map(str, row))}" for key, row in values.items())
