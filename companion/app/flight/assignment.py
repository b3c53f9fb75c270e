"""A dispatcher's assignment on this vehicle's disk: written, loaded whole, taken up or given back.

It is loaded before the desk hears `done`, and again by whoever flies it. One that cannot be loaded
is refused with its reason; it never ends the companion, which stands by for the next.
"""

import json
import os
from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import settle_folder
from companion.adapters.files.checkpoint_file import NAME as CHECKPOINT
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions, Settings
from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import Flight
from companion.fleet.messages import Assign

MISSION, OBSTACLES = "flight.json", "obstacles.geojson"


def write_assignment(
    deed: Assign, port: FleetPort, options: RunOptions, settings: Settings
) -> LoadedFlight:
    """Put an assigned flight into its folder; the flight, once this vehicle can begin it.

    Raises LeewayError with what is wrong with it, OSError where the disk does not take it.
    """
    folder = port.folder_of(deed.assignment)
    folder.mkdir(parents=True, exist_ok=True)
    flight = dict(deed.flight)
    site = flight.get("site")
    if not isinstance(site, dict):
        raise LeewayError("site: expected a table")
    if site.get("obstacles") is not None:
        raise LeewayError("site.obstacles: expected none, the command carries them itself")
    terrain = site.get("terrain")
    if isinstance(terrain, dict) and terrain.get("grid") is not None:
        raise LeewayError("site.terrain.grid: expected none, the command carries heights itself")
    if deed.obstacles is not None:
        _settled(folder / OBSTACLES, json.dumps(deed.obstacles).encode())
        flight["site"] = site | {"obstacles": OBSTACLES}
    _settled(folder / MISSION, msgspec.json.encode(flight))
    settle_folder(folder)
    settle_folder(folder.parent)
    loaded = load_assignment(deed.assignment, port, options, settings)
    _check_vehicle(loaded.flight, port)
    return loaded


def load_assignment(
    assignment: str, port: FleetPort, options: RunOptions, settings: Settings
) -> LoadedFlight:
    """The flight that lies in an assignment's folder. Raises LeewayError."""
    folder = port.folder_of(assignment)
    return LoadedFlight.read(options.of_flight(folder / MISSION, folder), settings)


def take_up(port: FleetPort, options: RunOptions, settings: Settings) -> LoadedFlight | None:
    """The flight of the assignment aboard; `None`: it is over, or refused, and none is aboard.

    After a restart this is the first that is known of it: whoever took it may have been another
    version of this program.
    """
    assert port.current is not None
    assignment = port.current.assignment
    if port.log.has_outcome(assignment):
        port.put_ashore()
        return None
    try:
        return load_assignment(assignment, port, options, settings)
    except LeewayError as error:
        port.give_back(str(error), flew=(port.folder_of(assignment) / CHECKPOINT).exists())
        return None


def _check_vehicle(flight: Flight, port: FleetPort) -> None:
    """It is for a vehicle of this kind, and says where it starts."""
    vehicle = flight.vehicle
    if vehicle.airframe != port.airframe_name:
        raise LeewayError(f"vehicle.airframe {vehicle.airframe}: this is {port.airframe_name}")
    if vehicle.payload_kg > port.max_payload_kg:
        raise LeewayError(
            f"vehicle.payload_kg = {vehicle.payload_kg:g}: at most {port.max_payload_kg:g}"
        )
    if flight.site.depot is None:
        raise LeewayError("site.depot: expected lat_deg, lon_deg and alt_amsl_m")


def _settled(path: Path, content: bytes) -> None:
    """On the disk before `current.json` says that it is there, even after a power cut."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
