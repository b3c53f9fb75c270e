"""The `[wind]` table of a flight file, and the wind field that it describes."""

import itertools
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from sim_bridge.truth.dryden import DrydenTurbulence
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.params import check_range
from sim_bridge.truth.wind_field import MeanWind, RampedWind, RecordedWind, SteadyWind, WindField
from sim_bridge.truth.wind_log import load_wind_log

_NEUTRAL_EXPONENT = 1.0 / 7.0  # open ground, neutral air (Counihan, Atmos. Environ. 9, 1975)


class WindPoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Wind at one time, in s since the simulation's start."""

    t_s: float
    """Time since the simulation's start."""
    speed_mps: float
    """Speed at the reference height."""
    from_deg: float
    """Where it blows from, clockwise from north."""

    def __post_init__(self) -> None:
        check_range("wind.points.t_s", self.t_s, 0.0, 1e6)
        check_range("wind.points.speed_mps", self.speed_mps, 0.0, 60.0)
        check_range("wind.points.from_deg", self.from_deg, -720.0, 720.0)


class _Common(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"
):
    """What every kind of wind has.

    A recording holds its own gusts, so turbulence is added to one only on request.
    """

    profile_exponent: float | None = None
    """Exponent of the wind's growth with height. Absent: 1/7, or 0 for a recording."""
    reference_height_m: float = 10.0
    """Height above the ground at which speeds are stated."""
    turbulence: Literal["none", "dryden"] = "none"
    """Dryden gusts, or none."""
    turbulence_scale: float = 1.0
    """Strength of the gusts over what the mean wind gives."""

    def check_common(self) -> None:
        check_range("wind.profile_exponent", self.profile_exponent or 0.0, 0.0, 0.6)
        check_range("wind.reference_height_m", self.reference_height_m, 1.0, 500.0)
        check_range("wind.turbulence_scale", self.turbulence_scale, 0.0, 5.0)


class SteadyWindParams(_Common, frozen=True, tag="steady"):
    """One mean wind."""

    speed_mps: float
    """Speed at the reference height."""
    from_deg: float
    """Where it blows from, clockwise from north."""

    def __post_init__(self) -> None:
        self.check_common()
        check_range("wind.speed_mps", self.speed_mps, 0.0, 60.0)
        check_range("wind.from_deg", self.from_deg, -720.0, 720.0)


class RampedWindParams(_Common, frozen=True, tag="points"):
    """Ramps and veers between points."""

    points: list[WindPoint]
    """At least one, with rising times."""

    def __post_init__(self) -> None:
        self.check_common()
        times = [point.t_s for point in self.points]
        if not times or any(b <= a for a, b in itertools.pairwise(times)):
            raise ValueError("wind.points: expected at least one, with rising t_s")


class LogWindParams(_Common, frozen=True, tag="log"):
    """Replay of a recording."""

    log: str
    """CSV file of `t_s`, `wind_speed_mps`, `wind_from_deg`, beside the flight file."""
    start_s: float | None = None
    """Time in the recording at which the wind starts. A flight file may also say [first, last], or
    nothing: `sim-bridge fly` then draws it by the seed.
    """

    def __post_init__(self) -> None:
        self.check_common()


WindParams = SteadyWindParams | RampedWindParams | LogWindParams


def parse_wind(table: dict[str, Any]) -> WindParams:
    """The typed form of a flight file's `[wind]`; an empty table is still air."""
    if not table:
        return SteadyWindParams(speed_mps=0.0, from_deg=0.0)
    try:
        return msgspec.convert(table, type=WindParams, strict=True)
    except msgspec.ValidationError as error:
        raise TruthError(f"[wind]: {error}") from error


def mean_wind(params: WindParams, folder: Path) -> MeanWind:
    """The mean over time; share one among vehicles. `folder` is what a log's path starts from."""
    match params:
        case SteadyWindParams():
            return SteadyWind(params.speed_mps, params.from_deg)
        case RampedWindParams():
            return RampedWind([(p.t_s, p.speed_mps, p.from_deg) for p in params.points])
        case LogWindParams():
            return RecordedWind(load_wind_log(folder / params.log), params.start_s)


def build_wind_field(params: WindParams, mean: MeanWind, rng: np.random.Generator) -> WindField:
    """One vehicle's wind: a shared mean, and gusts of its own from `rng`."""
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
