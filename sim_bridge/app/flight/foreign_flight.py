"""`sim-bridge fly --link URL`: the same flight on vehicles outside this simulator.

Such a vehicle is ArduPilot's SITL, PX4's SIH or a Pixhawk on the bench. One companion process runs
for each link, without lockstep: companions follow the autopilots' clocks at any speed-up factor.
The verdict comes from each companion's record (own_record.py).
"""

import contextlib
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.files.atomic_file import read_checked_json
from companion.adapters.files.checkpoint_file import CHECKPOINT_NAME as CHECKPOINT
from companion.adapters.files.params import read_airframe, read_flight
from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import Flight
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.overheard import StreamMonitor
from sim_bridge.app.flight.own_record import flight_row_from_companion_result
from sim_bridge.app.flight.report import VehicleStatus
from sim_bridge.app.flight.run_folder import create_unique_run_dir, mark_if_interrupted

POLL_PERIOD_S = 0.2  # wall-clock time
EXIT_USAGE, EXIT_NO_LINK, EXIT_LINK_NOT_OPEN = 2, 4, 6
"""Companion exit codes: usage error, no vehicle on the link, link not opened."""

PHASE_CHANGE_MARK = " -> "
"""Marks a phase change in a companion's output line; the live view shows the phase itself."""

ShowVehicles = Callable[[list[VehicleStatus], float], None]
PrintLine = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class ExternalFlightOptions:
    """Options from the command line. `here`: the site is centred on each vehicle's position.

    `steady_wind`: wind of the simulator behind the link, towards north and east (m/s).
    """

    flight_file: Path
    links: tuple[str, ...]
    gate: bool = True
    configure: bool = False
    here: bool = False
    run_root: Path = Path("logs")
    steady_wind: tuple[float, float] | None = None


@dataclass(slots=True)
class _ExternalVehicle:
    """One external vehicle, with its companion process and its monitored telemetry."""

    number: int
    link: str
    companion: CompanionProcess
    monitor: StreamMonitor
    first_contact_s: float | None = field(default=None)

    def build_status(self) -> VehicleStatus:
        monitor = self.monitor
        return VehicleStatus(
            label=f"{self.number} {monitor.autopilot_kind or '-'}",
            phase=self.companion.last_reported_phase or "looking for it",
            distance_m=monitor.distance_m,
            up_m=monitor.up_m,
            named_values=monitor.named_values,
            status_texts=monitor.status_texts or [(0.0, f"(nothing yet, on {self.link})")],
        )

    def time_since_first_message_s(self) -> float:
        """Return the autopilot's time since its first message."""
        if self.first_contact_s is None and self.monitor.t_s > 0.0:
            self.first_contact_s = self.monitor.t_s
        return max(0.0, self.monitor.t_s - (self.first_contact_s or 0.0))


def fly_external_vehicles(
    options: ExternalFlightOptions,
    show_vehicles: ShowVehicles,
    print_line: PrintLine = lambda line: None,
) -> dict[str, Any]:
    """Fly to the end. Return `{"flights": [...]}` from the companions' records.

    `show_vehicles` receives the vehicles several times per second. `print_line` receives each line
    of companion output once: decisions with their reasons, messages and changed vehicle settings.

    Raises LeewayError for invalid input, and if no autopilot answers on a link.
    """
    flight = read_flight(options.flight_file)
    read_airframe(flight.vehicle.airframe)
    _raise_if_options_invalid(options, flight)
    gate = "" if options.gate else "-gate-off"
    run_dir = create_unique_run_dir(options.run_root, f"{flight.name}-link{gate}")
    with contextlib.ExitStack() as stack:
        vehicles = [
            _build_vehicle(options, number, run_dir) for number in range(1, len(options.links) + 1)
        ]
        for vehicle in vehicles:
            stack.callback(vehicle.companion.terminate_or_kill)
            vehicle.companion.start()
        with mark_if_interrupted(run_dir):
            _show_until_all_companions_end(vehicles, show_vehicles, print_line)
    for vehicle in vehicles:
        _raise_if_start_failed(vehicle)
    rows = [
        flight_row_from_companion_result(
            vehicle.companion.read_result_json_or_empty(),
            vehicle=f"{flight.vehicle.airframe}-{vehicle.number}",
            autopilot=vehicle.monitor.autopilot_kind or "-",
            run=os.path.relpath(vehicle.companion.run_dir),
            steady_wind_to_ne_mps=options.steady_wind,
        )
        | {"died": _describe_kill_by_signal(vehicle)}
        for vehicle in vehicles
    ]
    result = {"flights": rows}
    (run_dir / "flights.json").write_bytes(msgspec.json.format(msgspec.json.encode(result)))
    return result


def _raise_if_options_invalid(options: ExternalFlightOptions, flight: Flight) -> None:
    if flight.faults:
        raise LeewayError(
            f"{options.flight_file}: [[faults]] need the simulated world: remove them to fly an"
            " external vehicle (--link)"
        )
    duplicates = {link for link in options.links if options.links.count(link) > 1}
    if duplicates:
        raise LeewayError(f"--link {', '.join(sorted(duplicates))}: named twice")
    if len(options.links) > 1 and flight.site.depot is not None and not options.here:
        raise LeewayError(
            "several --link and one site.depot: the vehicles would share a route; --here"
            " centres the site on each vehicle"
        )


def _build_vehicle(options: ExternalFlightOptions, number: int, run_dir: Path) -> _ExternalVehicle:
    link = options.links[number - 1]
    vehicle_dir = run_dir if len(options.links) == 1 else run_dir / f"vehicle{number}"
    arguments = [
        f"--link={link}",
        f"--mission={options.flight_file}",
        f"--gate={'on' if options.gate else 'off'}",
        "--authorise",  # --link on the command line authorises this vehicle to fly this mission
        "--no-operator",  # the user of this command monitors the flight
    ]
    arguments += ["--configure"] if options.configure else []
    arguments += ["--here"] if options.here else []
    companion = CompanionProcess(run_dir=vehicle_dir, arguments=arguments)
    return _ExternalVehicle(number, link, companion, StreamMonitor(vehicle_dir / "stream.tlog"))


def _show_until_all_companions_end(
    vehicles: list[_ExternalVehicle], show_vehicles: ShowVehicles, print_line: PrintLine
) -> None:
    """Show states and output lines until every companion process has ended."""
    is_multiple = len(vehicles) > 1
    running = True
    while running:
        running = any(vehicle.companion.is_running for vehicle in vehicles)
        for vehicle in vehicles:
            vehicle.monitor.read_new_frames_and_update_state()
            for line in vehicle.companion.read_new_output_lines():
                if PHASE_CHANGE_MARK not in line:
                    print_line(f"{vehicle.number} {line}" if is_multiple else line)
        show_vehicles(
            [vehicle.build_status() for vehicle in vehicles],
            max(vehicle.time_since_first_message_s() for vehicle in vehicles),
        )
        next((g for g in vehicles if g.companion.is_running), vehicles[0]).companion.wait(
            POLL_PERIOD_S
        )


def _raise_if_start_failed(vehicle: _ExternalVehicle) -> None:
    """Raise LeewayError if the companion exited for a usage error or a link without autopilot."""
    code = vehicle.companion.exit_code
    if code in (EXIT_USAGE, EXIT_LINK_NOT_OPEN):
        raise LeewayError(f"companion {vehicle.number}: {vehicle.companion.last_output_lines(1)}")
    if code == EXIT_NO_LINK and vehicle.monitor.autopilot_kind is None:
        raise LeewayError(f"--link {vehicle.link}: no autopilot on this link")


def _describe_kill_by_signal(vehicle: _ExternalVehicle) -> str | None:
    """Describe a companion killed by a signal: signal, position and unrestored settings."""
    code = vehicle.companion.exit_code
    if code is None or code >= 0:
        return None
    try:
        by = signal.Signals(-code).name
    except ValueError:
        by = f"signal {-code}"
    monitor = vehicle.monitor
    checkpoint = read_checked_json(vehicle.companion.run_dir / CHECKPOINT, "checkpoint") or {}
    message = f"the companion was killed ({by}) with the vehicle {monitor.distance_m:.0f} m away"
    message += f" and {monitor.up_m:.0f} m up"
    if checkpoint.get("flying"):
        message += ": the onboard mission flies it home"
    settings = checkpoint.get("settings_before") or {}
    if settings:
        before = ", ".join(f"{name} {value:g}" for name, value in sorted(settings.items()))
        message += f"; settings not restored, previous values: {before}"
    return message
