"""Wind recordings for `promise`: checked by the companion, interpolated to whole seconds.

Faults in a file are detected and reported as in `companion fit-wind`
(`companion.analysis.wind_fit.log_checks`). Each good run of sufficient length is a stretch.
"""

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.adapters.logs.wind_logs import read_wind_log
from companion.analysis.wind_fit.log_checks import Samples
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError

MIN_STRETCH_S = 120.0


@dataclass(frozen=True, slots=True)
class Stretch:
    """Wind towards north and east, (n, 2) m/s, at whole seconds from `start_s` of its file."""

    start_s: float
    wind_ne_mps: Floats

    @property
    def seconds(self) -> int:
        """Duration in s."""
        return self.wind_ne_mps.shape[0] - 1


@dataclass(frozen=True, slots=True)
class WindRecording:
    """Valid stretches of a file, and the faults found in the rest."""

    stretches: tuple[Stretch, ...]
    faults: tuple[str, ...]


def read_recording(path: Path) -> WindRecording:
    """Read `t_s, wind_speed_mps, wind_from_deg` (direction it blows from, clockwise from north).

    Raises LeewayError if unusable: no file, not text, other columns, no valid stretch.
    """
    found = read_wind_log(path)
    stretches = (_interpolate_at_whole_seconds(run) for run in found.segments)
    good = tuple(s for s in stretches if s.seconds >= MIN_STRETCH_S)
    if not good:
        fault_text = "; ".join(found.findings) or f"{sum(r.t_s.size for r in found.segments)} rows"
        raise LeewayError(
            f"{path}: no stretch of {MIN_STRETCH_S:.0f} s or more without a gap ({fault_text})"
        )
    return WindRecording(good, tuple(f"{path}: {fault}" for fault in found.findings))


def _interpolate_at_whole_seconds(run: Samples) -> Stretch:
    """Interpolate the wind vector linearly at whole seconds."""
    seconds = np.arange(math.ceil(run.t_s[0]), math.floor(run.t_s[-1]) + 1, dtype=np.float64)
    wind = run.wind_to_ne_mps
    axes = [np.interp(seconds, run.t_s, wind[:, axis]) for axis in (0, 1)]
    return Stretch(float(math.ceil(run.t_s[0])), np.stack(axes, axis=-1))


def file_sha256_prefix(path: Path) -> str:
    """Return the first 16 hex digits of a file's SHA-256. Raises LeewayError if unreadable."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise LeewayError(f"{path}: cannot be read ({error.strerror})") from None
