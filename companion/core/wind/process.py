"""Wind process fitted to recordings: the strict `wind-process/1` schema.

Each axis of the wind (its mean over about 10 s) is a constant level plus a few independent
Ornstein-Uhlenbeck processes, `dx = -x/T dt + noise`, each with its memory T and its stationary
variance. The variances grow with the square of the mean wind, as turbulence does (Panofsky and
Dutton 1984, ch. 6), between limits. Supplied files are in params/wind; `companion fit-wind` creates
them.
"""

import math
from typing import Literal

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError, check_range

MAX_PARTS = 4
MAX_VARIANCE_M2PS2 = 100.0


class WindProcessParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `wind-process/1` file: the change of wind over time at a site.

    Variances are scaled by the square of the mean wind over `reference_wind_mps`, limited to
    `least_scale` and `most_scale`.
    """

    format: Literal["wind-process/1"]
    """File type and version."""
    name: str
    """Name of the process."""
    memory_s: tuple[float, ...]
    """Memory T of each Ornstein-Uhlenbeck process, in ascending order."""
    variance_m2ps2: tuple[float, ...]
    """Stationary variance of each, at a mean wind of `reference_wind_mps`."""
    reference_wind_mps: float
    """Mean wind that the variances refer to."""
    least_scale: float
    """Lower limit of the mean wind over `reference_wind_mps`."""
    most_scale: float
    """Upper limit of the mean wind over `reference_wind_mps`."""
    level_std_mps: float
    """Prior of the level of each axis (one sigma)."""
    seen_noise_std_mps: float
    """Independent part of an estimate's error (one sigma)."""
    recorded_s: float | None = None
    """Recorded wind that the parameters were fitted to. Absent: none, so that no P(home) has
    support."""
    independent_returns: float | None = None
    """Returns that count as independent, fewer than recorded where the sites differ. Absent: every
    300 s of `recorded_s`."""
    tail_dof: float | None = None
    """Degrees of freedom of the Student-t distribution of changes of the wind. Absent: Gaussian."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.memory_s) <= MAX_PARTS:
            raise LeewayError(f"memory_s: {len(self.memory_s)} numbers: expected 1 to {MAX_PARTS}")
        if len(self.variance_m2ps2) != len(self.memory_s):
            raise LeewayError(
                f"variance_m2ps2: {len(self.variance_m2ps2)} numbers:"
                f" expected {len(self.memory_s)}, one for each of memory_s"
            )
        for memory in self.memory_s:
            check_range("memory_s", memory, 1.0, 100_000.0)
        if any(b <= a for a, b in zip(self.memory_s, self.memory_s[1:], strict=False)):
            raise LeewayError("memory_s: expected rising numbers")
        for variance in self.variance_m2ps2:
            check_range("variance_m2ps2", variance, 0.0, MAX_VARIANCE_M2PS2)
        check_range("reference_wind_mps", self.reference_wind_mps, 0.5, 50.0)
        check_range("least_scale", self.least_scale, 0.05, 1.0)
        check_range("most_scale", self.most_scale, 1.0, 10.0)
        check_range("level_std_mps", self.level_std_mps, 1.0, 50.0)
        check_range("seen_noise_std_mps", self.seen_noise_std_mps, 0.01, 5.0)
        if self.recorded_s is not None:
            check_range("recorded_s", self.recorded_s, 1.0, 1e9)
        if self.independent_returns is not None:
            check_range("independent_returns", self.independent_returns, 0.0, 1e7)
        if self.tail_dof is not None:
            check_range("tail_dof", self.tail_dof, 3.0, 1000.0)

    def variance_scale(self, wind_mps: float) -> float:
        """Return the variances at this mean wind over those at the reference wind."""
        return min(max(wind_mps / self.reference_wind_mps, self.least_scale), self.most_scale) ** 2

    def with_scaled_variances(self, variance_factor: float) -> "WindProcessParams":
        """Return the process with its variances multiplied by a factor, up to their limit."""
        most = MAX_VARIANCE_M2PS2
        scaled = tuple(min(each * variance_factor, most) for each in self.variance_m2ps2)
        return msgspec.structs.replace(self, variance_m2ps2=scaled)

    def mean_squared_change_m2ps2(self, lag_s: Floats, averaging_time_s: float) -> Floats:
        """Return E[(w(t + lag) - w(t))^2] of one axis, means over `averaging_time_s`, reference
        wind.
        """
        lag = np.asarray(lag_s, float)[..., None]
        memory, variance = np.array(self.memory_s), np.array(self.variance_m2ps2)
        share = variance_share_after_averaging(memory, averaging_time_s)
        return 2.0 * np.sum(share * variance * -np.expm1(-lag / memory), axis=-1)


def variance_share_after_averaging(memory_s: Floats, averaging_time_s: float) -> Floats:
    """Return the share of each process's variance that a mean over `averaging_time_s` keeps.

    Variance of the mean of an Ornstein-Uhlenbeck process, 2 (T/S) (1 - (T/S) (1 - exp(-S/T)))
    (Taylor 1921 for its exponential autocorrelation).
    """
    ratio = np.asarray(memory_s, float) / averaging_time_s
    return 2.0 * ratio * (1.0 + ratio * np.expm1(-1.0 / ratio))


def wind_process_from_dict(table: dict[str, object], error_location: str) -> WindProcessParams:
    """Convert a parsed TOML table to `wind-process/1`; LeewayError names file and key."""
    try:
        return msgspec.convert(table, WindProcessParams)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{error_location}: {error}") from error


def wind_vector_speed_mps(wind_ne_mps: Floats) -> float:
    """Return the length of a wind vector."""
    return math.hypot(float(wind_ne_mps[0]), float(wind_ne_mps[1]))
