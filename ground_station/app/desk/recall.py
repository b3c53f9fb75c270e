"""Recalls through the companion, or directly to an autopilot whose companion is silent.

A recall needs no store: it is sent first, and stored as soon as the store is reachable. The stored
record is also a hold: a recalled vehicle is not launched again before the operator releases it.
"""

import secrets
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.core.base.errors import LeewayError
from companion.fleet.messages import FINAL_STATUSES, Command, CommandStatus, Recall
from ground_station.adapters.clock import WallClock
from ground_station.adapters.direct_line import connect_and_command_return_to_launch
from ground_station.app.desk.exchange import RESPONSE_TIMEOUT_S, RETRY_DELAY_S
from ground_station.app.desk.recall_record import RecallRecord
from ground_station.core.fleet.fleet_link import (
    Clock,
    CommandResponse,
    FleetInput,
    FleetLink,
    LivelinessChanged,
    StateReceived,
)
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.holds import ALL_DRONES

RECEIVE_TIMEOUT_S = 0.2
DISCOVERY_TIME_S = 2.0
"""Listening time before the received vehicles are counted."""

SILENCE_REPORT_DELAY_S = 0.5
"""Delay before the operator is informed that no vehicle is received. Members on the network have
responded by then; programs on one machine discover each other within 0.5 s.
"""


class NoVehicleReceivedError(LeewayError):
    """A recall of all vehicles received no vehicle to recall."""


@dataclass(slots=True)
class Recaller:
    """Receives the fleet's states and sends recalls; `issuer`: name of the operator."""

    fleet: FleetLink
    log: Callable[[str], None]
    issuer: str
    clock: Clock = field(default_factory=WallClock)
    status: FleetStatus = field(default_factory=FleetStatus)
    responses: dict[str, CommandStatus] = field(default_factory=dict)
    _sent_s: dict[str, float] = field(default_factory=dict)

    def request_states(self) -> None:
        """Request the state of the whole fleet."""
        self.fleet.request_states(RESPONSE_TIMEOUT_S)

    def receive_and_process_messages(self, wait_s: float = RECEIVE_TIMEOUT_S) -> None:
        """Process received messages, waiting this long for the first."""
        for received in self.fleet.receive(wait_s):
            self._process_message(received)

    def _process_message(self, received: FleetInput) -> None:
        match received:
            case LivelinessChanged():
                self.status.record_liveliness_change(
                    received.vehicle, received.instance_id, has_joined=received.has_joined
                )
                if received.has_joined:
                    self.fleet.request_states(RESPONSE_TIMEOUT_S)
            case StateReceived():
                now_s, now_us = self.clock.monotonic_s(), self.clock.epoch_us()
                self.status.record_state_and_new_doubts(received.state, now_s, now_us)
            case CommandResponse() if received.result is not None:
                self._record_final_response(received.command_id, received.result.status)
                result_text = f"{received.result.status.value} {received.result.reason}"
                self.log(f"{received.result.vehicle}: recall {result_text}")
            case _:
                return

    def _record_final_response(self, command_id: str, response: CommandStatus) -> None:
        if response in FINAL_STATUSES:
            self.responses[command_id] = response

    def names_of_received_drones(self) -> set[str]:
        """Return the names of the received drones."""
        return {name for name in self.status.vehicles if self.is_drone_received(name)}

    def is_drone_received(self, vehicle: str) -> bool:
        """Whether a drone has reported its state and is on the network."""
        vehicle_status = self.status.status_of(vehicle)
        return (
            vehicle_status.state is not None
            and bool(vehicle_status.instance_ids)
            and vehicle != TRUCK
        )

    def listen_until_vehicles_received(self, vehicle: str | None, wait_s: float) -> None:
        """Listen until the vehicle is received, or (None) for `DISCOVERY_TIME_S`; report
        silence.
        """
        start_s, is_logged = self.clock.monotonic_s(), False
        while self.clock.monotonic_s() - start_s < min(wait_s, DISCOVERY_TIME_S):
            if vehicle is not None and self.is_drone_received(vehicle):
                return
            self.receive_and_process_messages()
            if self.clock.monotonic_s() - start_s > SILENCE_REPORT_DELAY_S and not is_logged:
                is_logged = self._log_vehicles_not_received_yet(vehicle)

    def _log_vehicles_not_received_yet(self, vehicle: str | None) -> bool:
        received_names = ", ".join(sorted(self.names_of_received_drones()))
        if received_names and vehicle is None:
            return False
        others_text = f"{vehicle}: not connected yet; connected: {received_names or 'none'}"
        self.log("no vehicle connected yet" if vehicle is None else others_text)
        return True

    def send_recall_if_due(self, command_id: str, vehicle: str) -> None:
        """Send an unanswered recall; to a silent vehicle as soon as it is received."""
        state, now_s = self.status.status_of(vehicle).state, self.clock.monotonic_s()
        sent_s = self._sent_s.get(command_id)
        if state is None or command_id in self.responses:
            return
        if sent_s is not None and now_s - sent_s < RETRY_DELAY_S:
            return
        self._sent_s[command_id] = now_s
        command = Command(
            id=command_id,
            vehicle=vehicle,
            instance_id=state.instance_id,
            as_of_s=state.uptime_s,
            by=self.issuer,
            action=Recall(),
        )
        self.fleet.send(command, RESPONSE_TIMEOUT_S)


def recall_and_hold_vehicles(
    recaller: Recaller, record: RecallRecord, vehicle: str | None, wait_s: float
) -> set[str]:
    """Recall one vehicle, or (None) all that are received; return those that did not accept it.

    Recalled vehicles are held; with None every drone is, received or not. Raises
    NoVehicleReceivedError if all are recalled and none is received.
    """
    recaller.listen_until_vehicles_received(vehicle, wait_s)
    names = {vehicle} if vehicle else recaller.names_of_received_drones()
    commands = {f"recall-{name}-{secrets.token_hex(6)}": name for name in sorted(names)}
    for id_, name in commands.items():
        recaller.send_recall_if_due(id_, name)
    record.place_hold_and_store_commands(ALL_DRONES if vehicle is None else vehicle, commands)
    until_s = recaller.clock.monotonic_s() + wait_s
    while recaller.clock.monotonic_s() < until_s and not (
        record.is_hold_placed_and_commands_stored and commands.keys() <= recaller.responses.keys()
    ):
        recaller.receive_and_process_messages()
        for id_, name in commands.items():
            recaller.send_recall_if_due(id_, name)
        record.store_responses_and_missed_entries(recaller.responses)
    record.void_unanswered_commands()  # must not be sent later without the operator's knowledge
    if not names:
        raise NoVehicleReceivedError(
            f"no vehicle connected in {min(wait_s, DISCOVERY_TIME_S):g} s: none recalled:"
            " command RTL by RC or ground station"
        )
    return {
        name
        for id_, name in commands.items()
        if recaller.responses.get(id_) is not CommandStatus.DONE
    }


def command_return_to_launch_if_silent(
    recaller: Recaller, vehicle: str, autopilot_url: str, min_silence_s: float
) -> set[str]:
    """Command return to launch over MAVSDK after its companion has been silent for this time.

    Returns the vehicle, or an empty set if its companion is alive: a recall then needs it.
    """
    recaller.log(f"{vehicle}: direct RTL after {min_silence_s:.0f} s without its companion")
    start_s = recaller.clock.monotonic_s()
    while recaller.clock.monotonic_s() - start_s < min_silence_s:
        recaller.receive_and_process_messages()
        vehicle_status = recaller.status.status_of(vehicle)
        if vehicle_status.instance_ids or (
            vehicle_status.received_s is not None and vehicle_status.received_s > start_s
        ):
            recaller.log(f"{vehicle}: its companion is connected: direct RTL not sent")
            return set()
    system = connect_and_command_return_to_launch(autopilot_url)
    recaller.log(f"{vehicle}: autopilot {system} returns to launch, commanded directly")
    return {vehicle}
