"""`companion restore`: restore vehicle settings that an interrupted flight changed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from companion.adapters.clock import wall_s
from companion.adapters.files.vehicle_settings import (
    original_parameters_file_path,
    read_original_parameters,
    write_or_remove_original_parameters,
)
from companion.app.flight.autopilot_client import AutopilotClient
from companion.core.mission.actions import RequestBoardId, RequestParameters, SetParameters
from companion.core.mission.events import (
    AutopilotParameters,
    BoardIdReceived,
    Event,
    ParametersSet,
    VehicleState,
)

RESPONSE_TIMEOUT_S = 10.0
"""Time-out of one request: a setting is requested eight times within it."""


def wait_for_event(
    client: AutopilotClient, event_type: type[Event], timeout_s: float
) -> Any | None:
    """Return the next event of a kind; None after the time-out."""
    end_s = wall_s() + timeout_s
    while wall_s() < end_s:
        events = client.port.tick(client.clock.t_s) if client.clock.is_known else []
        for event in [*events, *client.receive_events()]:
            if isinstance(event, event_type):
                return event
    return None


def restore_stored_vehicle_settings(
    client: AutopilotClient,
    settings_folder: Path,
    vehicle_timeout_s: float,
    print_line: Callable[[str], None],
) -> bool | None:
    """Restore the settings stored in `settings_folder` for this vehicle, and verify them.

    True: all are restored. False: some or all are not; `print_line` states the reason. None: no
    autopilot.
    """
    state = wait_for_event(client, VehicleState, vehicle_timeout_s)
    if state is None or client.port.system_id is None:
        return None
    path = settings_path_by_requested_board_id(client, settings_folder)
    stored_settings = read_original_parameters(path)
    if not stored_settings:
        print_line(f"nothing to restore: no changed settings are stored for this vehicle ({path})")
        return True
    print_line(f"system {client.port.system_id}: settings that a flight changed ({path})")
    if client.telemetry.state is None or client.telemetry.armed:
        print_line("the vehicle is armed: no settings restored; disarm it and repeat")
        return False
    return set_and_verify_settings(client, path, stored_settings, print_line)


def settings_path_by_requested_board_id(client: AutopilotClient, settings_folder: Path) -> Path:
    """Return the vehicle's file: by its board, or by its system id if it reports no board."""
    client.port.execute(RequestBoardId(), client.clock.t_s)
    board_event = wait_for_event(client, BoardIdReceived, RESPONSE_TIMEOUT_S)
    profile, system_id = client.port.profile, client.port.system_id or 0
    kind = "" if profile is None else profile.autopilot_kind.value
    return original_parameters_file_path(
        settings_folder, kind, system_id, board_event.board_id if board_event is not None else ""
    )


def set_and_verify_settings(
    client: AutopilotClient,
    settings_path: Path,
    stored_settings: dict[str, float],
    print_line: Callable[[str], None],
) -> bool:
    """Set and verify the settings; those that fail stay in the file."""
    port, clock = client.port, client.clock
    port.execute(RequestParameters(tuple(stored_settings)), clock.t_s)
    found = wait_for_event(client, AutopilotParameters, RESPONSE_TIMEOUT_S)
    now = found.values if found is not None else {}
    port.execute(SetParameters(stored_settings), clock.t_s)
    done = wait_for_event(client, ParametersSet, RESPONSE_TIMEOUT_S)
    failed = set(stored_settings) if done is None else set(done.failed)
    for name, value in sorted(stored_settings.items()):
        before = now.get(name)
        was = "unknown" if before is None else f"{before:g}"
        word = "NOT SET" if name in failed else "ok     "
        print_line(f"{word}  {name}: {was} -> {value:g}")
    write_or_remove_original_parameters(
        settings_path, {name: value for name, value in stored_settings.items() if name in failed}
    )
    return not failed
