"""The `[wind]` table of a flight file, and the wind field that it describes."""

import itertools
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np

from sim_bridge.truth.dryden import DrydenTurbulence
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.params import Range, RangedTable, check_range
from sim_bridge.truth.wind_field import MeanWind, RampedWind, RecordedWind, SteadyWind, WindField
from sim_bridge.truth.wind_log import load_wind_log

_NEUTRAL_EXPONENT = 1.0 / 7.0  # open ground, neutral air (Counihan, Atmos. Environ. 9, 1975)


class WindPoint(RangedTable, frozen=True, kw_only=True):
    """Wind at one time, in s since the simulation's start."""

    table: ClassVar[str] = "wind.points"

    t_s: Annotated[float, Range(0.0, 1e6)]
    """Time since the simulation's start."""
    speed_mps: Annotated[float, Range(0.0, 60.0)]
    """Speed at the reference height."""
    from_deg: Annotated[float, Range(-720.0, 720.0)]
    """Direction that the wind blows from, clockwise from north."""


class _Common(RangedTable, frozen=True, kw_only=True, tag_field="kind"):
    """Fields common to every kind of wind.

    A recording contains its own gusts, so turbulence is added to one only on request.
    """

    table: ClassVar[str] = "wind"

    profile_exponent: float | None = None
    """Exponent of the wind's growth with height. Absent: 1/7, or 0 for a recording."""
    reference_height_m: Annotated[float, Range(1.0, 500.0)] = 10.0
    """Height above the ground at which speeds are stated."""
    turbulence: Literal["none", "dryden"] = "none"
    """Dryden gusts, or none."""
    turbulence_scale: Annotated[float, Range(0.0, 5.0)] = 1.0
    """Strength of the gusts over what the mean wind gives."""

    def __post_init__(self) -> None:
        RangedTable.__post_init__(self)
        check_range("wind.profile_exponent", self.profile_exponent or 0.0, 0.0, 0.6)


class SteadyWindParams(_Common, frozen=True, tag="steady"):
    """One constant mean wind."""

    speed_mps: Annotated[float, Range(0.0, 60.0)]
    """Speed at the reference height."""
    from_deg: Annotated[float, Range(-720.0, 720.0)]
    """Direction that the wind blows from, clockwise from north."""


class RampedWindParams(_Common, frozen=True, tag="points"):
    """Ramps and veers between points."""

    points: list[WindPoint]
    """At least one point, with increasing times."""

    def __post_init__(self) -> None:
        _Common.__post_init__(self)
        times = [point.t_s for point in self.points]
        if not times or any(b <= a for a, b in itertools.pairwise(times)):
            raise ValueError("wind.points: expected at least one, with rising t_s")


class LogWindParams(_Common, frozen=True, tag="log"):
    """Replay of a recording."""

    log: str
    """CSV file of `t_s`, `wind_speed_mps`, `wind_from_deg`, relative to the flight file's folder.
    """
    start_s: float | None = None
    """Time in the recording at which the wind starts. A flight file may also give [first, last], or
    omit it: `sim-bridge fly` then draws it from the seed.
    """


WindParams = SteadyWindParams | RampedWindParams | LogWindParams


def parse_wind(table: dict[str, Any]) -> WindParams:
    """The typed form of a flight file's `[wind]`; an empty table is still air."""
    if not table:
        return SteadyWindParams(speed_mps=0.0, from_deg=0.0)
    try:
        return msgspec.convert(table, type=WindParams, strict=True)
    except msgspec.ValidationError as error:
        raise TruthError(f"[wind]: {error}") from error


def build_mean_wind(params: WindParams, folder: Path) -> MeanWind:
    """The mean over time; share one among vehicles. `folder` is what a log's path starts from."""
    match params:
        case SteadyWindParams():
            return SteadyWind(params.speed_mps, params.from_deg)
        case RampedWindParams():
            return RampedWind([(p.t_s, p.speed_mps, p.from_deg) for p in params.points])
        case LogWindParams():
            return RecordedWind(load_wind_log(folder / params.log), params.start_s)


def build_wind_field(params: WindParams, mean: MeanWind, rng: np.random.Generator) -> WindField:
    """Build one vehicle's wind: a shared mean, and individual gusts from `rng`."""
    exponent = params.profile_exponent
    if exponent is None:
        exponent = 0.0 if isinstance(params, LogWindParams) else _NEUTRAL_EXPONENT
    gusts = params.turbulence == "dryden"
    return WindField(
        mean,
        profile_exponent=exponent,
        reference_height_m=params.reference_height_m,
        turbulence=DrydenTurbulence(rng, params.turbulence_scale) if gusts else None,
    )
