"""zenoh on loopback for tests: explicit endpoints, no multicast, vehicles that only reply."""

import json
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from companion.adapters.files.params import read_airframe
from companion.app.flight.fleet_port import FleetPort
from companion.core.mission.events import Position
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.separation.track_cells import cell_name_or_none
from companion.fleet.command_log import CommandReply
from companion.fleet.messages import Command, CommandStatus
from companion.fleet.network import MemberLink
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_link import ZenohLink

FLEET = "harbour"
AT_HARBOUR = Position(0.0, 55.47, 8.45, 12.0, 0.0, 0.0, 0.0, 0.0)
"""Depot of params/days/harbour.toml."""

CELL = cell_name_or_none(AT_HARBOUR.lat_deg, AT_HARBOUR.lon_deg)
HERE = {"lat_deg": AT_HARBOUR.lat_deg, "lon_deg": AT_HARBOUR.lon_deg}
"""Position of a track that all vehicles of these tests receive."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def config_file(
    path: Path, *, listen: int | None = None, connect: int | None = None, **more: Any
) -> Path:
    """Write a configuration of a peer that listens at, or connects to, a loopback port."""
    table: dict[str, Any] = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "listen": {"endpoints": [f"tcp/127.0.0.1:{listen or 0}"]},
        "connect": {
            "endpoints": [f"tcp/127.0.0.1:{connect}"] if connect else [],
            "retry": {"period_init_ms": 50, "period_max_ms": 200},
        },
    }
    path.write_text(json.dumps(table | more))
    return path


class Vehicle:
    """A FleetPort in its own thread that executes and records every command."""

    def __init__(self, name: str, folder: Path, config: Path) -> None:
        keys, loaded = VehicleKeys(FLEET, name), read_and_check_zenoh_config(config)
        self.begin(name, folder, lambda life: ZenohLink(loaded, keys, life, lambda: None))

    @classmethod
    def on(cls, name: str, folder: Path, link_of: Callable[[str], MemberLink]) -> "Vehicle":
        """Create a vehicle on a link supplied by the test."""
        vehicle = cls.__new__(cls)
        vehicle.begin(name, folder, link_of)
        return vehicle

    def begin(self, name: str, folder: Path, link_of: Callable[[str], MemberLink]) -> None:
        """Start the thread on this link."""
        self.done: list[Command] = []
        self.answer = CommandReply(CommandStatus.DONE, "done")
        self.woken = threading.Event()
        self.port = FleetPort.open(name, "m100", read_airframe("m100"), folder, link_of)
        self.port.member.link.set_request_callback(self.woken.set)
        self.replan_key = TelemetryState(position=AT_HARBOUR)
        self.phase = "standby"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            self.port.process_commands(self.carry_out)
            self.port.publish_state_if_due(self.phase, self.replan_key)
            self.woken.wait(0.05)
            self.woken.clear()

    def carry_out(self, command: Command) -> CommandReply:
        self.done.append(command)
        return self.answer

    def stop(self) -> None:
        """Stop the thread; the port stays open."""
        self._stop.set()
        self._thread.join()

    def close(self) -> None:
        self.stop()
        self.port.close()
