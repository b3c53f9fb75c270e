"""Functions of the Python interface that fly simulated missions (docs/reference/api.md)."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from companion.adapters.files.params import flight_file_path
from companion.adapters.logs.decision_log import SCHEMAS, read_mcap_rows
from companion.app.api import airframe_file
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError, check_range
from companion.core.wind.checked_filter import WindFilterFactory
from sim_bridge.app.flight.craft_building import FlyOptions
from sim_bridge.app.flight.fly import fly_vehicles_and_evaluate
from sim_bridge.app.flight.wind_plugin import checked_wind
from sim_bridge.truth.wind_field import MeanWind


@dataclass(frozen=True, slots=True)
class FlightResult:
    """One vehicle's flight; the fields are the keys of docs/reference/flight-json.md."""

    vehicle: str
    autopilot: str
    judged_by: str
    charge_frac: float
    outcome: str
    delivered: bool
    home: bool
    energy_used_wh: float
    margin_wh: float
    flight_time_s: float
    least_clearance_m: float | None
    least_clearance_at: tuple[float, float] | None
    wind_rmse_mps: float | None
    wind_nees: float | None
    p_home_min: float | None
    p_home_stated_min: float | None
    clairvoyant: str
    clairvoyant_margin_wh: float
    decisions: list[dict[str, Any]]
    run: Path

    def table(self, kind: str) -> dict[str, Floats | list[Any]]:
        """Return the columns of one kind of message in the run's decisions.mcap.

        `kind`: assessment, wind, energy, decision, phase, said, or the telemetry as received,
        heard_position and so on. Columns of numbers are arrays (n,), NaN where unknown; others are
        lists.
        """
        if kind not in SCHEMAS:
            raise LeewayError(f"table {kind!r}: expected one of {', '.join(sorted(SCHEMAS))}")
        path = self.run / "decisions.mcap"
        try:
            rows = [row for topic, row in read_mcap_rows(path).rows if topic == kind]
        except OSError as error:
            raise LeewayError(f"{path}: {error.strerror}") from error
        return {name: _column([row.get(name) for row in rows]) for name in SCHEMAS[kind]}


def _column(values: list[Any]) -> Floats | list[Any]:
    if all(value is None or isinstance(value, int | float) for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype=float)
    return values


def fly(
    flight: str | Path = "default",
    *,
    autopilot: Literal["px4", "ardupilot", "mixed"] = "px4",
    seed: int = 1,
    gate: bool = True,
    vehicles: int = 1,
    airframe: str | Path | None = None,
    wind: str | MeanWind | None = None,
    estimator: str | WindFilterFactory | None = None,
    runs: str | Path = "logs",
) -> list[FlightResult]:
    """Fly a mission to its end with simulated vehicles and a companion process for each.

    `flight`: a name in params/flights, or a file. `airframe` and `estimator`: those of the
    companions; default: the true airframe and `companion.WindEstimator`. A class as `estimator` is
    imported by the companion, so it is in a module. `wind`: the true mean wind, a plug-in by name
    or an object. `runs`: folder for run folders. Raises LeewayError on invalid input.
    """
    if autopilot not in ("px4", "ardupilot", "mixed"):
        raise LeewayError(f"autopilot {autopilot!r}: expected px4, ardupilot or mixed")
    check_range("vehicles", vehicles, 1, 100)
    check_range("seed", seed, 0, 2**63)
    options = FlyOptions(
        flight_file=flight_file_path(flight),
        autopilot=autopilot,
        seed=seed,
        gate=gate,
        vehicles=vehicles,
        run_root=Path(runs),
        picture=False,
        companion_airframe=None if airframe is None else str(airframe_file(airframe)),
        mean_wind=None if wind is None else checked_wind(wind),
        estimator=_importable_name(estimator),
    )
    names = [field.name for field in fields(FlightResult)]
    found = fly_vehicles_and_evaluate(options)["flights"]
    return [
        FlightResult(**{**{n: row[n] for n in names}, "run": Path(row["run"])}) for row in found
    ]


def _importable_name(estimator: str | WindFilterFactory | None) -> str | None:
    if estimator is None or isinstance(estimator, str):
        return estimator
    module = getattr(estimator, "__module__", "__main__")
    name = getattr(estimator, "__qualname__", "<lambda>")
    if module == "__main__" or "<" in name:
        raise LeewayError(f"estimator {name}: expected a class in a module that can be imported")
    return f"{module}:{name}"
