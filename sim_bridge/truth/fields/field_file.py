"""A made field of wind from a file: `wind-field/1`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from sim_bridge.truth.fields.coherent_field import Coherence
from sim_bridge.truth.fields.computed_flow import ComputedFlows, FlowFile
from sim_bridge.truth.fields.lees import Obstacle
from sim_bridge.truth.params import Range, RangedTable, check_range, load_table
from sim_bridge.truth.wind_days import draw_day_process, draw_day_wind_series

Floats = NDArray[np.float64]


class WindFieldParams(RangedTable, frozen=True, kw_only=True):
    """A `wind-field/1` file: independent hours of wind over a site, each with a front.

    About a mean that each draw has of its own, three Ornstein-Uhlenbeck processes: weather over the
    hour, large eddies, gusts (`sim_bridge.truth.wind_days`).
    """

    format: Literal["wind-field/1"]
    """The kind of file and its version."""
    name: str
    """The field's name."""
    mean_mps: Annotated[float, Range(2.0, 30.0)]
    """Mean wind; of a draw 0.75 to 1.25 of it."""
    seconds: Annotated[int, Range(1800, 14_400)]
    """Duration of one random draw."""
    coherence_along: Annotated[float, Range(0.0, 50.0)]
    """Davenport's decay along the wind."""
    coherence_across: Annotated[float, Range(0.0, 50.0)]
    """Davenport's decay across the wind."""
    front_least_mps: Annotated[float, Range(1.0, 30.0)]
    """Least change of wind behind the front."""
    front_most_mps: float
    """Largest change of wind behind the front."""
    obstacles: tuple[Obstacle, ...] = ()
    """Obstacles in the wind: slower flow in their lee, faster flow around them."""
    flows: tuple[FlowFile, ...] = ()
    """Instead: flows that a solver computed there. Each draw blows from the direction of one."""

    def __post_init__(self) -> None:
        RangedTable.__post_init__(self)
        check_range("front_most_mps", self.front_most_mps, self.front_least_mps, 30.0)
        if self.obstacles and self.flows:
            raise ValueError("obstacles and flows: expected one of them")
        directions = [one.from_deg % 360.0 for one in self.flows]
        if len(set(directions)) < len(directions):
            raise ValueError("flows: expected each from_deg once")

    @property
    def coherence(self) -> Coherence:
        """Coherence parameters of the field."""
        return Coherence(self.coherence_along, self.coherence_across)


def load_wind_field(path: Path) -> WindFieldParams:
    """The field in a TOML file; TruthError names file and key of a mistake."""
    return load_table(path, WindFieldParams)


def load_flows(params: WindFieldParams, path: Path) -> ComputedFlows | None:
    """Load the computed flows named in the file at `path`; return None if it names no flow.

    Raises TruthError with file and key for an unusable grid.
    """
    return ComputedFlows(params.flows, path.parent) if params.flows else None


def draw_free_wind_series(params: WindFieldParams, rng: np.random.Generator) -> Floats:
    """Free wind (seconds + 1, 2) at the site's middle: one draw."""
    process = draw_day_process(params.mean_mps, rng)
    if params.flows:
        heading = params.flows[int(rng.integers(len(params.flows)))].downwind_unit_complex
        speed_mps = float(np.hypot(*process.mean_ne_mps))
        process = replace(process, mean_ne_mps=(speed_mps * heading.real, speed_mps * heading.imag))
    return draw_day_wind_series(process, params.seconds, rng)
