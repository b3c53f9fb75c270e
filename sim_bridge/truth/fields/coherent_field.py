"""Wind over a site with a given series' spectrum, mean advection and loss of coherence.

Spectral synthesis of correlated series (Shinozuka and Deodatis, Appl. Mech. Rev. 44, 1991). At each
frequency f the series at two positions have the coherence of Davenport (Q. J. R. Meteorol. Soc. 87,
1961), here for separations along and across the mean wind U,

    exp(-(f / U) sqrt((C_along dx)^2 + (C_across dy)^2)),

and the phase of the time dx / U in which the mean carries the air from one to the other. Published
decays are C_along 3 to 5 and C_across 10 to 16. A field without loss along the wind (frozen
turbulence) is more predictable than any real one.

At the site's middle the field equals the given series. Elsewhere it is Gaussian, drawn
conditionally on that series, with the same spectrum smoothed over bands. The series without its
linear trend, which is advected too, is treated as one period. Horizontal wind, equal at all
heights.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.truth.errors import TruthError

Floats = NDArray[np.float64]

_MIN_MEAN_MPS = 0.5
_BANDS_HZ = (0.0, 0.004, 0.015, math.inf)
"""Wind is interpolated between nodes for each band, because interpolation of the sum would reduce
the variance of eddies that are small compared with the spacing."""
_SMOOTHED_FRAC = 0.25
"""The spectrum is smoothed over a quarter of each frequency to either side."""


@dataclass(frozen=True, slots=True)
class Coherence:
    """Davenport's decay constants; 0 along: frozen turbulence."""

    longitudinal: float = 4.0
    across: float = 13.0

    def raise_if_out_of_range(self) -> None:
        """Raises TruthError where one is out of range."""
        for name, value in (("along", self.longitudinal), ("across", self.across)):
            if not 0.0 <= value <= 50.0:
                raise TruthError(f"coherence {name} = {value:g}: expected 0 to 50")

    def compute_coherence(
        self, frequency_hz: float, longitudinal_m: Floats, across_m: Floats, mean_mps: float
    ) -> Floats:
        """Compute the coherence of two series at this separation, without their phase."""
        scaled_distance = np.hypot(self.longitudinal * longitudinal_m, self.across * across_m)
        return np.exp(-frequency_hz / mean_mps * scaled_distance)


class CoherentField:
    """Wind (north, east) at any position of a square site and any time of the series."""

    def __init__(
        self,
        series_ne_mps: Floats,
        coherence: Coherence,
        rng: np.random.Generator,
        *,
        half_side_m: float = 1100.0,
        spacing_m: float = 75.0,
    ) -> None:
        """`series_ne_mps` (n, 2): wind at the middle at whole seconds. Raises TruthError where it
        is shorter than a minute or has no mean wind that could carry it."""
        coherence.raise_if_out_of_range()
        seconds = series_ne_mps.shape[0]
        if seconds < 60:
            raise TruthError(f"a series of {seconds} s: expected 60 or more")
        self.mean_ne_mps: Floats = series_ne_mps.mean(axis=0)
        self.mean_mps = float(np.hypot(*self.mean_ne_mps))
        if self.mean_mps < _MIN_MEAN_MPS:
            raise TruthError(f"a mean wind of {self.mean_mps:.2f} m/s carries nothing along")
        self.seconds = seconds - 1
        self._unit = self.mean_ne_mps / self.mean_mps
        self._spacing_m, self._half = spacing_m, math.ceil(half_side_m / spacing_m)
        rotated = _to_along_and_across(series_ne_mps - self.mean_ne_mps, self._unit)
        times = np.arange(seconds) - 0.5 * (seconds - 1)
        self._slope = times @ rotated / float(times @ times)
        flat = rotated - np.outer(times, self._slope)
        nodes = _NodeSeries(coherence, self.mean_mps, spacing_m, self._half)
        drawn = [nodes.draw_series_at_nodes(flat[:, axis], rng) for axis in (0, 1)]
        # (band, second, node along, node across, axis)
        self._parts = np.stack(drawn, axis=-1)
        self._alike = tuple(nodes.corner_correlation_by_band(flat[:, axis]) for axis in (0, 1))
        frequency = _frequencies_hz(seconds)
        self._power = np.stack(
            [
                _smooth_periodogram(np.abs(np.fft.rfft(flat[:, axis])) ** 2, frequency)
                for axis in (0, 1)
            ]
        )

    def to_ne_mps(self, t_s: Floats, north_m: Floats, east_m: Floats) -> Floats:
        """Compute wind (n, 2) at times and positions (n,) relative to the site's middle.

        The series repeats without its trend outside its time range. Raises TruthError outside the
        site.
        """
        t_s, north_m, east_m = np.broadcast_arrays(*np.atleast_1d(t_s, north_m, east_m))
        longitudinal = north_m * self._unit[0] + east_m * self._unit[1]
        across = east_m * self._unit[0] - north_m * self._unit[1]
        here = np.stack([longitudinal, across]) / self._spacing_m + self._half
        if here.min() < 0.0 or here.max() > 2 * self._half:
            far = math.hypot(float(np.abs(north_m).max()), float(np.abs(east_m).max()))
            raise TruthError(f"{far:.0f} m from the middle: outside of the field of wind")
        passed_s = t_s - longitudinal / self.mean_mps
        rotated = self._interpolate_eddies(passed_s, here)
        middle = 0.5 * self.seconds
        rotated += np.outer(np.clip(passed_s, 0.0, self.seconds) - middle, self._slope)
        north = rotated[:, 0] * self._unit[0] - rotated[:, 1] * self._unit[1]
        east = rotated[:, 0] * self._unit[1] + rotated[:, 1] * self._unit[0]
        return np.stack([north, east], axis=1) + self.mean_ne_mps

    def _interpolate_eddies(self, advected_time_s: Floats, grid_position: Floats) -> Floats:
        """Eddies (n, 2) along and across, between nodes and seconds, of the right variance."""
        low = np.minimum(grid_position.astype(int), 2 * self._half - 1)
        share = grid_position - low
        period = self._parts.shape[1]
        second = np.floor(advected_time_s).astype(int)
        part_s = (advected_time_s - second)[:, None]
        corners: list[Floats] = []
        weights: list[Floats] = []
        for da, dc in ((0, 0), (0, 1), (1, 0), (1, 1)):
            at = low[0] + da, low[1] + dc
            now = self._parts[:, second % period, at[0], at[1]]
            later = self._parts[:, (second + 1) % period, at[0], at[1]]
            corners.append(now + part_s * (later - now))
            weights.append(
                (share[0] if da else 1.0 - share[0]) * (share[1] if dc else 1.0 - share[1])
            )
        weight, corner = np.stack(weights), np.stack(corners)
        total = np.zeros((advected_time_s.size, 2))
        for axis, alike in enumerate(self._alike):
            for band, one in enumerate(alike):
                kept = np.sqrt(np.einsum("an,ab,bn->n", weight, one, weight))
                total[:, axis] += (weight * corner[:, band, :, axis]).sum(axis=0) / kept
        return total


class _NodeSeries:
    """Draws series at nodes of a grid along and across the wind, (2 half + 1) squared."""

    def __init__(self, coherence: Coherence, mean_mps: float, spacing_m: float, half: int) -> None:
        self._coherence, self._mean_mps, self._spacing_m = coherence, mean_mps, spacing_m
        self._side = 2 * half + 1
        self._half = half
        self._round = 4 * half + 2  # a torus: no node is near two others
        steps = np.arange(self._round)
        self._steps_m: Floats = spacing_m * np.minimum(steps, self._round - steps).astype(
            np.float64
        )

    def draw_series_at_nodes(self, series: Floats, rng: np.random.Generator) -> Floats:
        """Compute the series passing each node, (bands, seconds, side, side), at the time of
        passing.

        It excludes the phase of advection: readers look up at the time minus dx / U.
        """
        count = series.size
        series_spectrum = np.fft.rfft(series)
        frequency = _frequencies_hz(count)
        power = _smooth_periodogram(np.abs(series_spectrum) ** 2, frequency)
        spectrum = np.zeros((frequency.size, self._side, self._side), np.complex64)
        for k in range(1, frequency.size):
            unit, conditional_gain = self._draw_unit_field_and_coherence(float(frequency[k]), rng)
            root = math.sqrt(power[k]) if power[k] > 0.0 else 0.0
            if root > 0.0:
                given = series_spectrum[k] / root - unit[self._half, self._half]
                spectrum[k] = root * (unit + conditional_gain * given)
        parts = []
        for low, high in itertools.pairwise(_BANDS_HZ):
            inside = (frequency >= low) & (frequency < high)
            only = np.where(inside[:, None, None], spectrum, 0.0)
            parts.append(np.fft.irfft(only, count, axis=0).astype(np.float32))
        return np.stack(parts)

    def corner_correlation_by_band(self, series: Floats) -> tuple[Floats, ...]:
        """Compute the correlation (4, 4) of a cell's corners for each band, in reading order."""
        frequency = _frequencies_hz(series.size)
        power = np.abs(np.fft.rfft(series)) ** 2
        longitudinal = np.array([0, 0, 1, 1]) * self._spacing_m
        across = np.array([0, 1, 0, 1]) * self._spacing_m
        separations_m = (
            np.subtract.outer(longitudinal, longitudinal),
            np.subtract.outer(across, across),
        )
        found: list[Floats] = []
        for low, high in itertools.pairwise(_BANDS_HZ):
            inside = np.flatnonzero((frequency >= max(low, 1e-9)) & (frequency < high))
            total, weight = np.zeros((4, 4)), 0.0
            for k in inside:
                total += power[k] * self._coherence.compute_coherence(
                    float(frequency[k]), *separations_m, self._mean_mps
                )
                weight += power[k]
            found.append(total / weight if weight > 0.0 else np.ones((4, 4)))
        return tuple(found)

    def _draw_unit_field_and_coherence(
        self, frequency_hz: float, rng: np.random.Generator
    ) -> tuple[NDArray[np.complex128], Floats]:
        """A complex field of unit variance and its coherence with the middle, (side, side) each.

        Circulant embedding (Dietrich and Newsam, SIAM J. Sci. Comput. 18, 1997); the few negative
        eigenvalues of slow, wide eddies are left out.
        """
        cov = self._coherence.compute_coherence(
            frequency_hz, self._steps_m[:, None], self._steps_m[None, :], self._mean_mps
        )
        values = np.maximum(np.fft.fft2(cov).real, 0.0)
        values *= values.size / values.sum()
        shape = (2, self._round, self._round)
        noise = rng.standard_normal(shape, np.float32) * math.sqrt(0.5)
        whole = np.fft.ifft2(np.sqrt(values) * (noise[0] + 1j * noise[1]), norm="ortho")
        offset: Floats = self._spacing_m * (np.arange(self._side, dtype=np.float64) - self._half)
        middle = self._coherence.compute_coherence(
            frequency_hz, offset[:, None], offset[None, :], self._mean_mps
        )
        return whole[: self._side, : self._side], middle


def _frequencies_hz(seconds: int) -> Floats:
    return np.arange(seconds // 2 + 1, dtype=np.float64) / seconds


def _smooth_periodogram(power: Floats, frequency: Floats) -> Floats:
    """A periodogram's means over bands that widen with the frequency (Daniell 1946)."""
    sums = np.concatenate([[0.0], np.cumsum(power)])
    step = frequency[1]
    index = np.arange(power.size)
    wide = np.floor(_SMOOTHED_FRAC * frequency / step).astype(int)
    low = np.maximum(index - wide, 1)
    high = np.minimum(index + wide, power.size - 1)
    found = (sums[high + 1] - sums[low]) / np.maximum(high + 1 - low, 1)
    found[0] = 0.0
    return found


def _to_along_and_across(wind_ne: Floats, unit_ne: Floats) -> Floats:
    """North and east as along and across (to the right of) a unit vector."""
    longitudinal = wind_ne @ unit_ne
    across = wind_ne[:, 1] * unit_ne[0] - wind_ne[:, 0] * unit_ne[1]
    return np.stack([longitudinal, across], axis=1)
