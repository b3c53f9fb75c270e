"""A made field of wind from a file: `wind-field/1`."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.coherent_field import Coherence
from sim_bridge.truth.fields.computed_flow import ComputedFlows, FlowFile
from sim_bridge.truth.fields.lees import Obstacle
from sim_bridge.truth.params import check_range
from sim_bridge.truth.wind_days import day_of_wind, day_process

Floats = NDArray[np.float64]


class WindFieldParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `wind-field/1` file: independent hours of wind over a site, each with a front.

    About a mean that each draw has of its own, three Ornstein-Uhlenbeck processes: weather over the
    hour, large eddies, gusts (`sim_bridge.truth.wind_days`).
    """

    format: Literal["wind-field/1"]
    """The kind of file and its version."""
    name: str
    """The field's name."""
    mean_mps: float
    """Mean wind; of a draw 0.75 to 1.25 of it."""
    seconds: int
    """How long a draw lasts."""
    coherence_along: float
    """Davenport's decay along the wind."""
    coherence_across: float
    """Davenport's decay across the wind."""
    front_least_mps: float
    """Least change of wind behind the front."""
    front_most_mps: float
    """Largest change of wind behind the front."""
    obstacles: tuple[Obstacle, ...] = ()
    """What stands in the wind: slower in its lee, faster around it."""
    flows: tuple[FlowFile, ...] = ()
    """Instead: flows that a solver computed there. Each draw blows from the direction of one."""

    def __post_init__(self) -> None:
        check_range("mean_mps", self.mean_mps, 2.0, 30.0)
        check_range("seconds", self.seconds, 1800, 14_400)
        check_range("coherence_along", self.coherence_along, 0.0, 50.0)
        check_range("coherence_across", self.coherence_across, 0.0, 50.0)
        check_range("front_least_mps", self.front_least_mps, 1.0, 30.0)
        check_range("front_most_mps", self.front_most_mps, self.front_least_mps, 30.0)
        if self.obstacles and self.flows:
            raise ValueError("obstacles and flows: expected one of them")
        directions = [one.from_deg % 360.0 for one in self.flows]
        if len(set(directions)) < len(directions):
            raise ValueError("flows: expected each from_deg once")

    @property
    def coherence(self) -> Coherence:
        """Its loss of coherence."""
        return Coherence(self.coherence_along, self.coherence_across)


def load_wind_field(path: Path) -> WindFieldParams:
    """The field in a TOML file; TruthError names file and key of a mistake."""
    try:
        return msgspec.toml.decode(path.read_bytes(), type=WindFieldParams, strict=True)
    except OSError as error:
        raise TruthError(f"{path}: cannot be read ({error.strerror})") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise TruthError(f"{path}: {error}") from error


def flows_of(params: WindFieldParams, path: Path) -> ComputedFlows | None:
    """The computed flows that the file at `path` names; None: it names none.

    TruthError names file and key where a grid cannot be used.
    """
    return ComputedFlows(params.flows, path.parent) if params.flows else None


def drawn_series(params: WindFieldParams, rng: np.random.Generator) -> Floats:
    """Free wind (seconds + 1, 2) at the site's middle: one draw."""
    process = day_process(params.mean_mps, rng)
    if params.flows:
        heading = params.flows[int(rng.integers(len(params.flows)))].heading
        speed_mps = float(np.hypot(*process.mean_ne_mps))
        process = replace(process, mean_ne_mps=(speed_mps * heading.real, speed_mps * heading.imag))
    return day_of_wind(process, params.seconds, rng)
