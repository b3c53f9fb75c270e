"""A dispatcher's assignment on the vehicle's disk: write, load, resume or reject.

It is loaded before the desk receives `done`, and again before the flight. An assignment that cannot
be loaded is refused with a reason; the companion continues and waits for the next.
"""

import json

import msgspec

from companion.adapters.files.atomic_file import fsync_folder, write_text_atomically
from companion.adapters.files.checkpoint_file import CHECKPOINT_NAME as CHECKPOINT
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions, Settings
from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import Flight
from companion.fleet.messages import Assign

MISSION, OBSTACLES = "flight.json", "obstacles.geojson"


def write_assignment(
    assign_command: Assign, port: FleetPort, options: RunOptions, settings: Settings
) -> LoadedFlight:
    """Write an assigned flight to its folder, load it and return it.

    Raises LeewayError if it is invalid for this vehicle, OSError if it cannot be written.
    """
    folder = port.assignment_folder(assign_command.assignment)
    folder.mkdir(parents=True, exist_ok=True)
    flight = dict(assign_command.flight)
    site = flight.get("site")
    if not isinstance(site, dict):
        raise LeewayError("site: expected a table")
    if site.get("obstacles") is not None:
        raise LeewayError("site.obstacles: expected none, the command contains them")
    terrain = site.get("terrain")
    if isinstance(terrain, dict) and terrain.get("grid") is not None:
        raise LeewayError("site.terrain.grid: expected none, the command contains heights")
    if assign_command.obstacles is not None:
        obstacles_text = json.dumps(assign_command.obstacles)
        write_text_atomically(folder / OBSTACLES, obstacles_text, sync_folder=False)
        flight["site"] = site | {"obstacles": OBSTACLES}
    # Synced, so that they survive a power cut once `current.json` refers to them.
    write_text_atomically(folder / MISSION, msgspec.json.encode(flight).decode())
    fsync_folder(folder.parent)
    loaded = load_assignment(assign_command.assignment, port, options, settings)
    _raise_if_unfit_for_vehicle(loaded.flight, port)
    return loaded


def load_assignment(
    assignment_id: str, port: FleetPort, options: RunOptions, settings: Settings
) -> LoadedFlight:
    """Load the flight in an assignment's folder. Raises LeewayError."""
    folder = port.assignment_folder(assignment_id)
    return LoadedFlight.read_and_validate(
        options.with_mission_and_run_dir(folder / MISSION, folder), settings
    )


def load_current_assignment(
    port: FleetPort, options: RunOptions, settings: Settings
) -> LoadedFlight | None:
    """Return the flight of the loaded assignment; `None`: it ended or is rejected, and unloaded.

    It is validated again after a restart: another version of this program may have accepted it.
    """
    assert port.current is not None
    assignment = port.current.assignment
    if port.member.log.has_stored_outcome(assignment):
        port.unload_assignment()
        return None
    try:
        return load_assignment(assignment, port, options, settings)
    except LeewayError as error:
        port.reject_and_unload_assignment(
            str(error),
            was_flight_started=(port.assignment_folder(assignment) / CHECKPOINT).exists(),
        )
        return None


def _raise_if_unfit_for_vehicle(flight: Flight, port: FleetPort) -> None:
    """Check airframe, payload and depot. Raises LeewayError."""
    vehicle = flight.vehicle
    if vehicle.airframe != port.airframe_name:
        raise LeewayError(f"vehicle.airframe {vehicle.airframe}: this is {port.airframe_name}")
    if vehicle.payload_kg > port.max_payload_kg:
        raise LeewayError(
            f"vehicle.payload_kg = {vehicle.payload_kg:g}: at most {port.max_payload_kg:g}"
        )
    if flight.site.depot is None:
        raise LeewayError("site.depot: expected lat_deg, lon_deg and alt_amsl_m")
