"""Continuous turbulence with the Dryden spectra of MIL-F-8785C at low altitude.

One-sided spectra over spatial frequency Omega (rad/m), 3.7.1.2 of MIL-F-8785C:
  Phi_u = sigma_u^2 2 L_u / pi  1 / (1 + (L_u Omega)^2)
  Phi_v = sigma_v^2   L_v / pi  (1 + 3 (L_v Omega)^2) / (1 + (L_v Omega)^2)^2, and likewise w.
Scales and intensities below 1000 ft, 3.7.3: L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2,
sigma_w = 0.1 W_20, sigma_u / sigma_w = 1 / (0.177 + 0.000823 h)^0.4, h in feet, W_20 the mean
wind at 20 ft. MIL-HDBK-1797 gives the same field in other letters (its L_v, L_w are halved).

Frozen field: a vehicle meets it at its speed through the air, omega = V Omega. Unlike the usual
Euler method, the filters here are discretised exactly: variance and spectrum do not depend on
the step.
"""

import math

import numpy as np

from sim_bridge.truth.noise import GaussianStream

_M_PER_FT = 0.3048
_MIN_HEIGHT_FT = 10.0  # where MIL-F-8785C starts
_MAX_HEIGHT_FT = 1000.0
_MIN_SPEED_MPS = 0.5  # hovering in still air, the eddies still drift
_ROOT3 = math.sqrt(3.0)


def dryden_scales_m(height_m: float) -> tuple[float, float]:
    """L_u = L_v and L_w in m at a height above ground; heights clamped to 10 to 1000 ft."""
    feet = min(max(height_m / _M_PER_FT, _MIN_HEIGHT_FT), _MAX_HEIGHT_FT)
    return _M_PER_FT * feet / (0.177 + 0.000823 * feet) ** 1.2, _M_PER_FT * feet


def dryden_intensities_mps(height_m: float, wind_at_20ft_mps: float) -> tuple[float, float]:
    """sigma_u = sigma_v and sigma_w in m/s at a height above ground (clamped likewise)."""
    feet = min(max(height_m / _M_PER_FT, _MIN_HEIGHT_FT), _MAX_HEIGHT_FT)
    sigma_w = 0.1 * wind_at_20ft_mps
    return sigma_w / (0.177 + 0.000823 * feet) ** 0.4, sigma_w


class _LongitudinalFilter:
    """White noise through sqrt(2 tau) / (1 + tau s): unit variance."""

    __slots__ = ("_gauss", "value")

    def __init__(self, gauss: GaussianStream) -> None:
        self._gauss = gauss
        self.value = gauss()

    def advance_and_get_value(self, time_step_over_tau: float) -> float:
        """Advance by `time_step_over_tau` = dt / tau."""
        keep = math.exp(-time_step_over_tau)
        self.value = keep * self.value + math.sqrt(1.0 - keep * keep) * self._gauss()
        return self.value


class _LateralFilter:
    """White noise through sqrt(tau) (1 + sqrt(3) tau s) / (1 + tau s)^2: unit variance.

    Two states in a row, x1 = n / (1 + tau s) and x2 = x1 / (1 + tau s), with the exact
    covariance of their noise over a step (integrals of s^k exp(-2 s), k = 0, 1, 2).
    """

    __slots__ = ("_first", "_gauss", "_second")

    def __init__(self, gauss: GaussianStream) -> None:
        self._gauss = gauss
        # stationary covariance [[1/2, 1/4], [1/4, 1/4]]
        self._first = math.sqrt(0.5) * gauss()
        self._second = 0.5 * self._first + math.sqrt(0.125) * gauss()

    def advance_and_get_value(self, time_step_over_tau: float) -> float:
        """Advance by `time_step_over_tau` = dt / tau."""
        keep = math.exp(-time_step_over_tau)
        keep2 = keep * keep
        q11 = 0.5 * (1.0 - keep2)
        q12 = 0.25 - keep2 * (0.5 * time_step_over_tau + 0.25)
        q22 = 0.25 - keep2 * (0.5 * time_step_over_tau * (time_step_over_tau + 1.0) + 0.25)
        root11 = math.sqrt(q11)
        cross = q12 / root11
        rest = q22 - cross * cross
        noise1 = self._gauss()
        first = self._first
        self._first = keep * first + root11 * noise1
        self._second = keep * (self._second + time_step_over_tau * first) + cross * noise1
        if rest > 0.0:
            self._second += math.sqrt(rest) * self._gauss()
        return _ROOT3 * self._first + (1.0 - _ROOT3) * self._second


class DrydenTurbulence:
    """Gusts along one vehicle's path. Axes: along the mean wind, to its right, down."""

    __slots__ = ("_across", "_longitudinal", "_scale", "_vertical")

    def __init__(self, rng: np.random.Generator, intensity_scale: float = 1.0) -> None:
        """`intensity_scale` multiplies the standard's intensities (1: as published)."""
        gauss = GaussianStream(rng)
        self._scale = intensity_scale
        self._longitudinal = _LongitudinalFilter(gauss)
        self._across = _LateralFilter(gauss)
        self._vertical = _LateralFilter(gauss)

    def advance_and_get_gust_mps(
        self, dt_s: float, height_m: float, wind_at_20ft_mps: float, airspeed_mps: float
    ) -> tuple[float, float, float]:
        """Gust in m/s (along the mean wind, right of it, down) after another `dt_s`."""
        travel_m = dt_s * max(airspeed_mps, _MIN_SPEED_MPS)
        scale_uv_m, scale_w_m = dryden_scales_m(height_m)
        sigma_uv, sigma_w = dryden_intensities_mps(height_m, wind_at_20ft_mps)
        sigma_uv *= self._scale
        phase = travel_m / scale_uv_m
        return (
            sigma_uv * self._longitudinal.advance_and_get_value(phase),
            sigma_uv * self._across.advance_and_get_value(phase),
            sigma_w * self._scale * self._vertical.advance_and_get_value(travel_m / scale_w_m),
        )
