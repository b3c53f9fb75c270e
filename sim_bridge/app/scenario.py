"""The simulator's half of a flight file: the true wind and the faults, checked on reading."""

import itertools
import math
from pathlib import Path
from typing import Any, Literal

import msgspec

from companion.core.errors import LeewayError
from companion.core.flight import Flight, check_range

FaultKind = Literal[
    "link_silent",
    "companion_kill",
    "autopilot_reboot",
    "gnss_lost",
    "pilot_takes_over",
    "ground_takes_over",
    "release_fails",
    "pitot_stuck",
    "garbage",
]
Phase = Literal["start", "climb", "outbound", "drop", "return"]


class _Turbulence(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Shared by every kind: shear over height and Dryden turbulence on top of the mean."""

    shear_exponent: float = 0.14
    shear_height_m: float = 40.0
    turbulence: Literal["none", "dryden"] = "none"

    def __post_init__(self) -> None:
        check_range("wind.shear_exponent", self.shear_exponent, 0.0, 0.6)
        check_range("wind.shear_height_m", self.shear_height_m, 1.0, 500.0)


class SteadyWind(_Turbulence, frozen=True, tag_field="kind", tag="steady"):
    """The same mean wind for the whole flight; `from_deg` is where it blows from."""

    speed_mps: float
    from_deg: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("wind.speed_mps", self.speed_mps, 0.0, 40.0)
        check_range("wind.from_deg", self.from_deg, -360.0, 720.0)


class WindPoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The mean wind at one time after the vehicle's power-up."""

    t_s: float
    speed_mps: float
    from_deg: float

    def __post_init__(self) -> None:
        check_range("wind.points.t_s", self.t_s, 0.0, 1e6)
        check_range("wind.points.speed_mps", self.speed_mps, 0.0, 40.0)
        check_range("wind.points.from_deg", self.from_deg, -360.0, 720.0)


class ChangingWind(_Turbulence, frozen=True, tag_field="kind", tag="points"):
    """Ramps and veers: speed and direction run linearly from point to point."""

    points: list[WindPoint]

    def __post_init__(self) -> None:
        super().__post_init__()
        times = [p.t_s for p in self.points]
        if not times or any(b <= a for a, b in itertools.pairwise(times)):
            raise LeewayError("wind.points: expected at least one, with t_s rising")


class LoggedWind(_Turbulence, frozen=True, tag_field="kind", tag="log"):
    """A recording, replayed from `start_s` (a number, or [first, last] to draw from by seed)."""

    log: str
    start_s: float | list[float] | None = None
    rotate_deg: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("wind.rotate_deg", self.rotate_deg, -360.0, 360.0)
        starts = self.start_s if isinstance(self.start_s, list) else [self.start_s or 0.0]
        if len(starts) not in (1, 2) or not all(math.isfinite(s) and s >= 0 for s in starts):
            raise LeewayError("wind.start_s: expected seconds into the log, or [first, last]")


WindSpec = SteadyWind | ChangingWind | LoggedWind


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One thing that goes wrong: `at_s` after take-off, or `after_s` into a phase of the flight."""

    kind: FaultKind
    at_s: float = 0.0
    phase: Phase | None = None
    duration_s: float = 0.0
    restart: bool = True
    vehicle: int = 1

    def __post_init__(self) -> None:
        check_range("faults.at_s", self.at_s, 0.0, 1e6)
        check_range("faults.duration_s", self.duration_s, 0.0, 1e6)
        check_range("faults.vehicle", self.vehicle, 1, 250)


def read_wind(flight: Flight, where: Path) -> WindSpec:
    """The flight file's wind table; LeewayError in one line where it breaks the format."""
    if not flight.wind:
        return SteadyWind(speed_mps=0.0, from_deg=0.0)
    spec = _convert(flight.wind, WindSpec, f"{where}: wind")
    if isinstance(spec, LoggedWind):
        log = Path(spec.log)
        spec = msgspec.structs.replace(
            spec, log=str(log if log.is_absolute() else where.parent / log)
        )
    return spec


def read_faults(flight: Flight, where: Path) -> list[Fault]:
    """The flight file's faults in order of their time."""
    faults = [_convert(f, Fault, f"{where}: faults[{k}]") for k, f in enumerate(flight.faults)]
    return sorted(faults, key=lambda f: f.at_s)


def _convert(value: Any, kind: Any, where: str) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as e:
        raise LeewayError(f"{where}: {e}") from e
