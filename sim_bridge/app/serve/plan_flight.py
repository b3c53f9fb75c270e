"""Flight of a simulated vehicle under a ground station's plan, recorded as a telemetry log (.tlog).

There is no companion: an operator flies such plans to calibrate an airframe. The ground station
uses MAVLink only.
"""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError
from sim_bridge.app.link.client_messages import (
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    MODE_PARAMS,
    ground_heartbeat,
)
from sim_bridge.app.world.companion_link import CompanionLink
from sim_bridge.app.world.station import Station
from sim_bridge.app.world.vehicle_host import EXCHANGE_S, STEPS_PER_EXCHANGE, VehicleHost
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mavlink.enums import Cmd, MissionResult
from sim_bridge.autopilot.mission.items import MissionItem

STATIONARY_S = 20.0  # stationary before arming: the log then holds the avionics' power
LANDED_S = 8.0
REQUEST_INTERVAL_S = 3.0
TAKEOFF_TIMEOUT_S = 120.0
TIME_LIMIT_S = 3600.0
_ARMED = 128
_STREAM_RATES_HZ = {30: 10.0, 33: 10.0, 1: 2.0, 147: 2.0}  # ATTITUDE, GLOBAL_POSITION_INT, battery
_EPOCH_US = 1_700_000_000_000_000


@dataclass(frozen=True, slots=True)
class PlanFlight:
    """Result of a flight from ground truth."""

    duration_s: float
    energy_wh: float
    wind_mean_mps: float


class GroundStation:
    """Ground station that uploads a mission, starts it and logs received frames."""

    def __init__(self, host: VehicleHost, kind: AutopilotKind, log: Any) -> None:
        self.armed = False
        self._host, self._kind, self._log = host, kind, log
        self._link = CompanionLink(host, 1)
        self._station = Station(self._link, (GROUND_SYSTEM, GROUND_COMPONENT))
        self._link.listeners[self._station.link_number] = self._log_and_receive

    def _log_and_receive(self, t_s: float, frame: bytes) -> None:
        self._log.write(struct.pack(">Q", _EPOCH_US + round(t_s * 1e6)) + frame)
        for message in self._station.receive_frame(t_s, frame):
            if message.msg_name == "HEARTBEAT" and message.src_component == 1:
                self.armed = bool(message.base_mode & _ARMED)

    def receive_frames(self) -> None:
        """Receive and log the frames that the autopilot has sent."""
        self._link.discard_companion_frames()

    def send_heartbeat(self) -> None:
        """Send a heartbeat to the autopilot."""
        self._station.send_to_autopilot(ground_heartbeat())

    def upload_and_start_mission(self, items: list[MissionItem]) -> Iterator[None]:
        """Upload the mission after some time on the ground, and arm; each `yield` is a step."""
        for number, rate_hz in _STREAM_RATES_HZ.items():
            interval = (float(number), 1e6 / rate_hz)
            self._station.send_autopilot_command(Cmd.SET_MESSAGE_INTERVAL, *interval)
        yield from self._wait(STATIONARY_S)
        while (ack := (yield from self._station.upload_mission(items))) is None:
            pass
        if ack.type != 0:
            sequence = self._station.last_sent_sequence
            number = sequence + (self._kind is not AutopilotKind.ARDUPILOT)  # its item 0 is home
            raise LeewayError(
                f"mission upload: item {number}, command {items[sequence].command}: refused:"
                f" {MissionResult(ack.type).name} (MISSION_ACK {ack.type})"
            )
        yield from self._wait(REQUEST_INTERVAL_S)
        while not self.armed:
            mode = MODE_PARAMS[self._kind.value]["mission"]
            self._station.send_autopilot_command(Cmd.DO_SET_MODE, *mode)
            self._station.send_autopilot_command(Cmd.COMPONENT_ARM_DISARM, 1.0)
            yield from self._wait(REQUEST_INTERVAL_S)
        yield from self._wait(math.inf)

    def _wait(self, duration_s: float) -> Iterator[None]:
        until_s = self._host.t_s + duration_s
        while self._host.t_s < until_s:
            self._station.received.clear()
            yield


def _mission_items(items: list[dict[str, Any]], kind: AutopilotKind) -> Iterator[MissionItem]:
    """Yield the items to upload; item 0 of ArduPilot is home."""
    is_ardupilot = kind is AutopilotKind.ARDUPILOT
    home = {"command": 16, "frame": 0, "params": [0.0] * 7}
    unknown = 0.0 if is_ardupilot else math.nan
    for item in [home, *items] if is_ardupilot else items:
        params = [unknown if p is None or math.isnan(p) else float(p) for p in item["params"]]
        frame = 6 if item["frame"] == 3 else item["frame"]
        p1, p2, p3, p4, lat_deg, lon_deg, up_m = params
        x, y = round(lat_deg * 1e7), round(lon_deg * 1e7)
        yield MissionItem(item["command"], frame, p1, p2, p3, p4, x, y, up_m)


def fly_plan(
    vehicle_host: VehicleHost,
    autopilot_kind: AutopilotKind,
    items: list[dict[str, Any]],
    tlog_path: Path,
    report_simulated_time_s: Callable[[float], None] = lambda t_s: None,
) -> PlanFlight:
    """Fly a plan's items until landed; write the .tlog as a ground station does."""
    winds: list[float] = []
    with tlog_path.open("wb") as log:
        station = GroundStation(vehicle_host, autopilot_kind, log)
        procedure = station.upload_and_start_mission(list(_mission_items(items, autopilot_kind)))
        has_flown, landed_s, t_s = False, 0.0, 0.0
        for step in range(round(TIME_LIMIT_S / EXCHANGE_S)):
            t_s = (step + 1) * EXCHANGE_S
            vehicle_host.advance(STEPS_PER_EXCHANGE)
            station.receive_frames()
            if step % 10 == 0:
                station.send_heartbeat()
                report_simulated_time_s(t_s)
            next(procedure)
            truth = vehicle_host.truth
            if truth.crashed or truth.motors_failed:
                raise LeewayError(f"simulated vehicle crashed or lost its motors at {t_s:.0f} s")
            if truth.airborne:
                has_flown = True
                winds.append(math.hypot(*truth.wind_to_ned_mps[:2]))
            if not has_flown and t_s > TAKEOFF_TIMEOUT_S:
                raise LeewayError(f"{tlog_path.name}: no take-off within {TAKEOFF_TIMEOUT_S:.0f} s")
            landed_s = landed_s + EXCHANGE_S if has_flown and not station.armed else 0.0
            if landed_s > LANDED_S:
                break
        else:
            raise LeewayError(f"{tlog_path.name}: not landed within {TIME_LIMIT_S:.0f} s")
    truth = vehicle_host.truth
    mean_wind = sum(winds) / len(winds)
    return PlanFlight(t_s, truth.energy_used_wh, mean_wind)
