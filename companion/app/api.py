"""Functions of the Python interface that read logs and flight files (docs/reference/api.md)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.files import params
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.analysis.replay.flight_replay import ReplayConfig, replay_flight
from companion.analysis.replay.recorded_flight import RecordedFlight
from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError, check_range
from companion.core.base.location import Location
from companion.core.base.plugin import AIRFRAMES, load_plugin_file
from companion.core.certificate.evidence import RiskEvidence
from companion.core.mission.flight_estimate import CruiseWind, FlightEstimate, estimate_flight
from companion.core.mission.flight_file import Flight, Site, Vehicle
from companion.core.return_budget.budget import (
    Assessment,
    Gate,
    GateParams,
    RemainingMission,
    ReturnRoute,
)
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.checked_filter import WindFilterFactory, checked_filter_factory
from companion.core.wind.forecast import WindOutlook
from companion.core.wind.observation import WindBelief

MIN_STD, MAX_WIND_STD_MPS, MAX_ENERGY_WH, MAX_PAYLOAD_KG = 1e-6, 50.0, 1e6, 1e3
"""Limits of the arguments of `can_return`."""


@dataclass(frozen=True, slots=True)
class WindSeries:
    """Estimated wind of a log, one row for each tick from the first valid estimate on.

    Shapes: `t_s` and `airborne` (n,), `to_ne_mps` (n, 2) in the direction of air motion, its
    covariance `cov_ne_m2ps2` (n, 2, 2).
    """

    t_s: Floats
    to_ne_mps: Floats
    cov_ne_m2ps2: Floats
    airborne: Bools

    @property
    def speed_mps(self) -> Floats:
        """Wind speed, shape (n,)."""
        return np.hypot(self.to_ne_mps[:, 0], self.to_ne_mps[:, 1])

    @property
    def from_deg(self) -> Floats:
        """Direction from which the wind blows, clockwise from north, 0 to 360; shape (n,)."""
        return np.degrees(np.arctan2(-self.to_ne_mps[:, 1], -self.to_ne_mps[:, 0])) % 360.0

    def to_dict(self) -> dict[str, list[Any]]:
        """Return plain columns, as a table or data frame takes them."""
        north, east = self.to_ne_mps.T
        nn, ne, ee = (self.cov_ne_m2ps2[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
        columns = {
            "t_s": self.t_s, "to_n_mps": north, "to_e_mps": east, "nn_m2ps2": nn, "ne_m2ps2": ne,
            "ee_m2ps2": ee, "speed_mps": self.speed_mps, "from_deg": self.from_deg,
            "airborne": self.airborne,
        }  # fmt: skip
        return {name: column.tolist() for name, column in columns.items()}


def read_log(path: str | Path) -> RecordedFlight:
    """Read a ULog, dataflash, tlog, MCAP or CSV file; raise LeewayError if it is none."""
    return read_log_of_any_format(Path(path))


def read_airframe(name_or_file: str | Path) -> Airframe:
    """Read an airframe: a name in params/airframes, a TOML file, or a plug-in."""
    return params.read_airframe(str(airframe_file(name_or_file)))


def airframe_file(name_or_file: str | Path) -> Path:
    """Return the file of an airframe: a name in params/airframes, a file, or a plug-in."""
    try:
        return params.airframe_file_path(str(name_or_file))
    except LeewayError:
        names = sorted(path.stem for path in (params.params_dir() / "airframes").glob("*.toml"))
        return load_plugin_file(AIRFRAMES, str(name_or_file), tuple(names))


def estimate_wind(
    log: str | Path | RecordedFlight,
    airframe: str | Path | Airframe = "generic",
    *,
    payload_kg: float = 0.0,
    estimator: str | WindFilterFactory | None = None,
) -> WindSeries:
    """Estimate the wind along a recorded flight.

    `estimator`: a plug-in by name, or a class constructed with the airframe; default
    `WindEstimator`. Raises LeewayError if the log cannot be used.
    """
    recorded = log if isinstance(log, RecordedFlight) else read_log(log)
    frame = airframe if isinstance(airframe, Airframe) else read_airframe(airframe)
    config = ReplayConfig(
        airframe=frame,
        flight=Flight(
            format="flight/1",
            site=Site(customer=Location(east_m=0.0, north_m=0.0)),
            vehicle=Vehicle(airframe=frame.name, payload_kg=payload_kg),
        ),
        wind_process=params.read_wind_process("coast"),
        at_planned_site=False,
        with_energy=False,
        wind_filter=None if estimator is None else checked_filter_factory(estimator)(frame),
    )
    found = replay_flight(recorded, config)
    return WindSeries(found.wind_t_s, found.wind_to_ne_mps, found.wind_cov_m2ps2, found.in_air)


def can_return(
    airframe: str | Path | Airframe,
    here_neu_m: Sequence[float],
    energy_left_wh: float,
    wind_to_ne_mps: Sequence[float],
    *,
    home_neu_m: Sequence[float] = (0.0, 0.0, 0.0),
    energy_std_wh: float = 2.0,
    wind_std_mps: float = 0.5,
    payload_kg: float = 0.0,
    reserve_wh: float = 0.0,
    max_loss: float = 0.01,
    wind_process: str = "coast",
) -> Assessment:
    """Assess the direct way home from a position in the air, and the landing.

    Positions are north, east, up (m); the wind in the direction of air motion. `p_home` and
    `margin_wh` answer; `turn_back` is always True. The decision about a mission is
    `assess_flight`.
    """
    numbers = _finite("here_neu_m", here_neu_m, 3), _finite("home_neu_m", home_neu_m, 3)
    (north, east, up), (home_north, home_east, home_up) = numbers
    wind = _finite("wind_to_ne_mps", wind_to_ne_mps, 2)
    check_range("energy_left_wh", energy_left_wh, 0.0, MAX_ENERGY_WH)
    check_range("energy_std_wh", energy_std_wh, MIN_STD, MAX_ENERGY_WH)
    check_range("reserve_wh", reserve_wh, 0.0, MAX_ENERGY_WH)
    check_range("wind_std_mps", wind_std_mps, MIN_STD, MAX_WIND_STD_MPS)
    check_range("payload_kg", payload_kg, 0.0, MAX_PAYLOAD_KG)
    check_range("max_loss", max_loss, 0.0, 1.0)
    if up <= home_up:
        raise LeewayError(f"here_neu_m: {up} m up: expected above home ({home_up} m)")
    frame = airframe if isinstance(airframe, Airframe) else read_airframe(airframe)
    here, above_home = (north, east, -up), (home_north, home_east, -up)
    legs = [Leg(LegKind.LAND, above_home, (home_north, home_east, -home_up), payload_kg)]
    if (north, east) != (home_north, home_east):
        legs.insert(0, Leg(LegKind.CRUISE, here, above_home, payload_kg))
    belief = WindBelief(0.0, wind, wind_std_mps**2 * np.eye(2), ("stated",), True)
    process = params.read_wind_process(wind_process)
    outlook = WindOutlook(process)
    outlook.update_from_estimate(belief)
    full_wh = max(energy_left_wh, reserve_wh, 1e-9)
    energy = EnergyBelief(0.0, energy_left_wh, energy_std_wh, full_wh, "stated")
    gate = Gate(RouteEnergy(frame), GateParams(max_loss, reserve_wh))
    remaining = RemainingMission((ReturnRoute("home", tuple(legs)),), ())
    models = remaining, belief, outlook, energy
    return gate.with_evidence_limit(gate.assess(*models), RiskEvidence(process).doubt, *models)


def _finite(name: str, values: Sequence[float], count: int) -> Floats:
    numbers = np.asarray(values, dtype=float)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise LeewayError(f"{name} = {numbers.tolist()}: expected {count} numbers")
    return numbers


def assess_flight(
    flight: str | Path,
    *,
    wind_speed_mps: float,
    wind_from_deg: float,
    wind_std_mps: float = 1.0,
    charge_frac: float | None = None,
) -> FlightEstimate:
    """Plan the mission of a flight file, or of a name in params/flights, and assess it.

    The wind is that at cruise height. `charge_frac` None: as in the file. Raises LeewayError if a
    file is invalid or there is no route.
    """
    path = params.flight_file_path(flight)
    mission = params.read_flight_with_terrain_heights(path)
    airframe = params.read_airframe(mission.vehicle.airframe)
    process = params.read_wind_process(mission.mission.wind_process)
    obstacles = params.read_obstacle_document(mission, path)
    wind = CruiseWind(wind_speed_mps, wind_from_deg, wind_std_mps)
    try:
        return estimate_flight(mission, airframe, process, obstacles, wind, charge_frac)
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error
