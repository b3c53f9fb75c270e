"""Reads a flight file and the files that it names, and estimates the flight."""

from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_estimate import CruiseWind, FlightEstimate, estimate_flight
from ground_station.adapters.files.params import (
    read_airframe,
    read_flight_with_terrain_heights,
    read_json,
    read_wind_process,
)


def estimate_flight_file(
    path: Path, wind: CruiseWind, charge_frac: float | None = None
) -> FlightEstimate:
    """Estimate the flight of a file; raise LeewayError if a file is invalid or without a route."""
    flight = read_flight_with_terrain_heights(path)
    airframe = read_airframe(flight.vehicle.airframe, path.parent)
    obstacles = flight.site.obstacles
    document = None if obstacles is None else read_json(path.parent / obstacles)
    process = read_wind_process(flight.mission.wind_process)
    try:
        return estimate_flight(flight, airframe, process, document, wind, charge_frac)
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error
