"""Replaying the bytes of a flight gives the same decisions and the same bytes."""

import math
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.autopilots.codec import MavlinkCodec, mavlink
from companion.adapters.files.params import (
    flight_configuration_digest,
    params_dir,
    read_airframe,
    read_flight,
    read_wind_process,
)
from companion.app.flight.loaded_flight import autopilot_parameter_requirements
from companion.app.flight.loop import Loop
from companion.app.flight.recorder import Recorder
from companion.core.mission.actions import Action, Decision
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.pilot import Pilot
from sim_bridge.app.world.memory_link import MemoryLink
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import SteadyWind, WindField

FLIGHT_TOML = """
format = "flight/1"
[site]
depot = { lat_deg = 55.47, lon_deg = 8.45, alt_amsl_m = 12.0 }
customer = { name = "customer", north_m = 250.0, east_m = 0.0 }
[vehicle]
airframe = "m100"
payload_kg = 0.6
[mission]
cruise_height_m = 20.0
leg_length_m = 100.0
wind_settle_s = 4.0
"""


class Ears:
    """A companion on a recorded link, with its decisions and messages."""

    def __init__(self, folder: Path) -> None:
        path = folder / "flight.toml"
        folder.mkdir()
        path.write_text(FLIGHT_TOML)
        flight, airframe = read_flight(path), read_airframe("m100")
        wind_process = read_wind_process("coast")
        self.tape, self.decisions, self.said = MemoryLink(), [], []
        self.pilot = Pilot(
            flight, airframe, wind_process, obstacles=None,
            requirements=autopilot_parameter_requirements,
            flight_digest=flight_configuration_digest(path, airframe, wind_process),
            options=PilotOptions(configure=True, authorise=True, without_operator=True),
        )  # fmt: skip
        self.recorder = Recorder(folder, synchronous=True, on_action=self.note)
        self.loop = Loop(
            self.tape, MavlinkCodec(datagrams=True), self.recorder, self.pilot,
            system_id=None, silence_limit_s=1e9,
            plan_synchronously=True,  # the recording waits for the plan, as the simulator does
        )  # fmt: skip

    def note(self, action: Action) -> None:
        if isinstance(action, Decision):
            self.decisions.append(action)

    def hear(self, datagrams: list[bytes]) -> list[bytes]:
        self.tape.received += datagrams
        while self.tape.received and self.loop.finished is None:
            self.loop.step()
        sent = self.tape.take_sent_datagrams()
        self.said += sent
        return sent

    def payloads(self) -> list[str]:
        """Return the sent messages without heartbeats, which follow wall time at first."""
        ear = mavlink.MAVLink(None)
        heard = [m for data in self.said for m in ear.parse_buffer(data) or []]
        return [repr(m.to_dict()) for m in heard if m.get_type() != "HEARTBEAT"]  # equates NaN


@pytest.mark.sample
@pytest.mark.parametrize("autopilot_kind", list(AutopilotKind))
def test_a_recorded_flight_heard_again_gives_the_same_decisions_and_bytes(autopilot_kind, tmp_path):
    vehicle = Vehicle(
        load_airframe(params_dir() / "truth" / "m100.toml"),
        WindField(SteadyWind(4.0, 200.0)),
        np.random.default_rng(2),
        payload_kg=0.6,
        depot_alt_amsl_m=12.0,
    )
    parameters = read_parameters(params_dir() / "autopilots" / f"{autopilot_kind.value}.toml")
    autopilot = Autopilot(autopilot_kind, (55.47, 8.45, 12.0), parameters)
    autopilot.add_link(0)
    ears = Ears(tmp_path / "live")
    tape: list[list[bytes]] = []
    actuation = autopilot.actuation
    for step in range(1, 1200):
        for _ in range(5):
            actuation = autopilot.process_readings(
                vehicle.advance_and_read_sensors(actuation, 0.02), 0.02
            )
        sync = mavlink.MAVLink_timesync_message(0, round(step * 1e8))
        frames = [data for _, data in autopilot.take_frames_to_send()]
        frames.append(bytes(sync.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1))))
        tape.append(frames)
        for data in ears.hear(frames):
            autopilot.process_received_datagram(0, data)
        if "onward" in {d.kind for d in ears.decisions}:
            break
    kinds = [d.kind for d in ears.decisions]
    assert kinds[:5] == ["planned", "read_back", "authorised", "take_off", "go"]
    assert math.hypot(*vehicle.truth.pos_ned_m[:2]) > 10.0

    again = Ears(tmp_path / "again")
    for frames in tape:
        again.hear(frames)
    assert again.decisions == ears.decisions
    assert again.payloads() == ears.payloads()
    for made in (ears, again):
        made.recorder.close()
