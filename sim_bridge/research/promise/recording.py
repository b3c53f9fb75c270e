"""Recordings as `promise` flies them: the companion's checks, then wind at whole seconds.

Faults in a file are found and named as `companion fit-wind` does it
(`companion.core.wind_fit.log_checks`). Each good run is a stretch, if it is long enough.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.adapters.logs.wind_logs import read_wind_log
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.wind_fit.log_checks import Samples

LEAST_STRETCH_S = 120.0


@dataclass(frozen=True, slots=True)
class Stretch:
    """Wind towards north and east, (n, 2) m/s, at whole seconds from `start_s` of its file."""

    name: str
    start_s: float
    wind_ne_mps: Floats

    @property
    def seconds(self) -> int:
        """Duration in s."""
        return self.wind_ne_mps.shape[0] - 1


@dataclass(frozen=True, slots=True)
class WindRecording:
    """A file's good stretches, and the faults found in the rest."""

    path: Path
    stretches: tuple[Stretch, ...]
    troubles: tuple[str, ...]


def read_recording(path: Path) -> WindRecording:
    """Read `t_s, wind_speed_mps, wind_from_deg` (direction it blows from, clockwise from north).

    Raises LeewayError if nothing is usable: no file, not text, other columns, no good stretch.
    """
    found = read_wind_log(path)
    stretches = (_at_whole_seconds(path.stem, run) for run in found.runs)
    good = tuple(s for s in stretches if s is not None and s.seconds >= LEAST_STRETCH_S)
    if not good:
        why = "; ".join(found.findings) or f"{sum(r.t_s.size for r in found.runs)} rows"
        raise LeewayError(
            f"{path}: no stretch of {LEAST_STRETCH_S:.0f} s without a gap to fly in ({why})"
        )
    return WindRecording(path, good, tuple(f"{path}: {words}" for words in found.findings))


def _at_whole_seconds(name: str, run: Samples) -> Stretch | None:
    """Wind vector interpolated linearly at whole seconds; None for less than a second."""
    if run.t_s.size < 2:
        return None
    first, last = math.ceil(run.t_s[0]), math.floor(run.t_s[-1])
    if last <= first:
        return None
    seconds = np.arange(first, last + 1, dtype=np.float64)
    wind = run.wind_to_ne_mps
    axes = [np.interp(seconds, run.t_s, wind[:, axis]) for axis in (0, 1)]
    return Stretch(name, float(first), np.stack(axes, axis=-1))
