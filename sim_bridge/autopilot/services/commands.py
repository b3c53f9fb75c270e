"""Commands that both autopilots handle in the same way."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.mavlink.commands import Command, int_or_default
from sim_bridge.autopilot.mavlink.enums import Cmd, MavResult
from sim_bridge.autopilot.mavlink.message_table import SPECS_BY_ID
from sim_bridge.autopilot.services.radio import Builder, LinkPolicy, Radio
from sim_bridge.autopilot.state import STEP_S, VehicleState

MAX_HOME_ALT_M = 100_000.0
"""Limit of a valid home altitude; HOME_POSITION cannot represent more."""

Handler = Callable[[Command], MavResult | None]
"""None: no acknowledgement is sent (now)."""


@dataclass(frozen=True, slots=True)
class Firmware:
    """Firmware description of an autopilot, and its response to refused message requests."""

    version: int
    git_hash: bytes
    capabilities: int
    refused_interval: MavResult
    refused_request: MavResult


@dataclass(slots=True)
class CommonCommands:
    """Handlers of the common commands by number, in `handlers`."""

    _state: VehicleState
    _radio: Radio
    _commander: Commander
    _streams: Mapping[str, Builder]
    _habits: LinkPolicy
    _firmware: Firmware
    handlers: dict[int, Handler] = field(init=False)

    def __post_init__(self) -> None:
        self.handlers = {
            Cmd.SET_MESSAGE_INTERVAL: self.set_message_interval,
            Cmd.GET_MESSAGE_INTERVAL: self.send_message_interval,
            Cmd.REQUEST_MESSAGE: self.send_requested_message,
            Cmd.REQUEST_AUTOPILOT_CAPABILITIES: self.send_autopilot_version,
            Cmd.REQUEST_PROTOCOL_VERSION: self.send_protocol_version,
            Cmd.GET_HOME_POSITION: self.send_home_position,
            Cmd.DO_SET_HOME: self.set_home_if_valid,
        }

    def set_message_interval(self, command: Command) -> MavResult:
        """SET_MESSAGE_INTERVAL: messages that the autopilot does not stream are refused."""
        state = self._state
        spec = SPECS_BY_ID.get(int_or_default(command.param1))
        link = self._radio.links.get(command.link_id)
        if spec is None or link is None or spec.name not in self._streams:
            return self._firmware.refused_interval
        if not math.isfinite(command.param2):
            return MavResult.DENIED
        if command.param2 < 0.0:
            link.set_message_interval(spec.name, None, state.t_s)
        elif command.param2 == 0.0:
            default = self._habits.default_message_intervals_s(link.kind).get(spec.name)
            link.set_message_interval(spec.name, default, state.t_s)
        else:
            link.set_message_interval(spec.name, max(command.param2 * 1e-6, STEP_S), state.t_s)
        return MavResult.ACCEPTED

    def send_message_interval(self, command: Command) -> MavResult:
        """Handle GET_MESSAGE_INTERVAL: respond with MESSAGE_INTERVAL."""
        spec = SPECS_BY_ID.get(int_or_default(command.param1))
        link = self._radio.links.get(command.link_id)
        if link is None:
            return MavResult.FAILED
        known = spec is not None and spec.name in self._streams
        interval = link.message_interval_s(spec.name) if known and spec is not None else None
        self._radio.send(
            command.link_id,
            "MESSAGE_INTERVAL",
            message_id=max(int_or_default(command.param1), 0) & 0xFFFF,
            interval_us=0 if not known else -1 if interval is None else round(interval * 1e6),
        )
        return MavResult.ACCEPTED if known else MavResult.FAILED

    def send_requested_message(self, command: Command) -> MavResult:
        """REQUEST_MESSAGE: one message, now."""
        spec = SPECS_BY_ID.get(int_or_default(command.param1))
        if spec is None:
            return self._firmware.refused_request
        if spec.name == "AUTOPILOT_VERSION":
            return self.send_autopilot_version(command)
        if spec.name == "PROTOCOL_VERSION":
            return self.send_protocol_version(command)
        builder = self._streams.get(spec.name)
        if builder is None:
            return self._firmware.refused_request
        fields = builder()
        if fields is None:
            return self._firmware.refused_request
        self._radio.send(command.link_id, spec.name, **fields)
        return MavResult.ACCEPTED

    def send_autopilot_version(self, command: Command) -> MavResult:
        """AUTOPILOT_VERSION: what it can do, and which firmware it is."""
        firmware = self._firmware
        self._radio.send(
            command.link_id,
            "AUTOPILOT_VERSION",
            capabilities=firmware.capabilities,
            flight_sw_version=firmware.version,
            middleware_sw_version=0,
            os_sw_version=0,
            board_version=0,
            flight_custom_version=firmware.git_hash,
            middleware_custom_version=bytes(8),
            os_custom_version=bytes(8),
            vendor_id=0,
            product_id=0,
            uid=self._state.system_id,
            uid2=bytes([self._state.system_id]) + bytes(17),
        )
        return MavResult.ACCEPTED

    def send_protocol_version(self, command: Command) -> MavResult:
        """PROTOCOL_VERSION: MAVLink 2."""
        self._radio.send(
            command.link_id,
            "PROTOCOL_VERSION",
            version=200,
            min_version=100,
            max_version=200,
            spec_version_hash=bytes(8),
            library_version_hash=bytes(8),
        )
        return MavResult.ACCEPTED

    def send_home_position(self, command: Command) -> MavResult:
        """GET_HOME_POSITION."""
        fields = self._streams["HOME_POSITION"]()
        if fields is None:
            return MavResult.FAILED
        self._radio.send(command.link_id, "HOME_POSITION", **fields)
        return MavResult.ACCEPTED

    def set_home_if_valid(self, command: Command) -> MavResult:
        """Handle DO_SET_HOME: here (param1 = 1), or a position with an AMSL altitude."""
        state = self._state
        if not state.has_position:
            return MavResult.FAILED
        if command.param1 == 1.0:
            self._commander.set_home(state.pos_ned_m)
            return MavResult.ACCEPTED
        home_position = (command.lat_deg, command.lon_deg, command.param7)
        limits = (90.0, 180.0, MAX_HOME_ALT_M)
        if not all(
            abs(number) <= limit for number, limit in zip(home_position, limits, strict=True)
        ):
            return MavResult.DENIED  # NaN too
        if command.lat_deg == 0.0 and command.lon_deg == 0.0:
            return MavResult.DENIED
        north, east = state.frame.to_ne_m(command.lat_deg, command.lon_deg)
        self._commander.set_home(
            (north, east, state.frame.alt_amsl_m - command.param7), keep_when_arming=True
        )
        return MavResult.ACCEPTED
