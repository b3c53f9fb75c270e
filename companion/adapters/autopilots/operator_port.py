"""Commands and parameters from operators, addressed to the companion and acknowledged by it.

An operator addresses the vehicle's system and component 191, is neither an autopilot nor an onboard
computer, and is trusted (`OperatorTrust`). PX4 sends 1000, 1001 and 2003: UNSUPPORTED.
"""

from collections.abc import Callable
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, COMPONENT, mavlink
from companion.core.mission.actions import OperatorResponse, ResponseStatus
from companion.core.mission.alerts import Alert, AlertSink
from companion.core.mission.events import (
    AbortOrdered,
    ControlHandedBack,
    ControlReleaseOrdered,
    Event,
    HomeStopRequested,
    LimitsChanged,
    MissionAuthorised,
)
from companion.core.pilot.estimators.flight_gate import AcceptedLimits

PARAMETERS = ("MAX_LOSS", "RESERVE_FRAC")
PARAMETER_RANGES = {"MAX_LOSS": (1e-6, 0.5), "RESERVE_FRAC": (0.0, 0.6)}
NON_OPERATOR_COMPONENTS = (
    AUTOPILOT,
    COMPONENT,
    mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2,
    mavlink.MAV_COMP_ID_ONBOARD_COMPUTER3,
    mavlink.MAV_COMP_ID_ONBOARD_COMPUTER4,
)
MAV_RESULT_BY_RESPONSE = {
    ResponseStatus.ACCEPTED: mavlink.MAV_RESULT_ACCEPTED,
    ResponseStatus.LATER: mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    ResponseStatus.DENIED: mavlink.MAV_RESULT_DENIED,
}
NAME_LENGTH = 16
GROUND_STATION = 255
"""The default system ID of ground stations."""

MAX_REPORTED_SOURCES = 16
"""Maximum number of untrusted sources that are reported to the operator, against floods."""


class OperatorTrust:
    """Decides which commands are accepted. Signed with the vehicle's key: from any source, and
    unsigned frames are not received. Without a key: from declared systems and the vehicle's own,
    via the host on which the autopilot was found; other senders have another address.
    """

    def __init__(self, operator_system_ids: frozenset[int] = frozenset({GROUND_STATION})) -> None:
        self._operators = operator_system_ids
        self._host: Any = None
        self._is_peer_known = False
        self._reported_sources: set[tuple[int, int]] = set()

    def record_first_autopilot_peer(self, peer: Any) -> None:
        """Record the peer by which the autopilot was identified; the first one stays."""
        if not self._is_peer_known:
            self._host, self._is_peer_known = _host_without_port(peer), True

    def trusts(self, message: Any, vehicle_system_id: int, peer: Any, *, signed: bool) -> bool:
        """Return True if a command received from this peer is accepted."""
        if signed:
            return True
        declared = message.get_srcSystem() in (*self._operators, vehicle_system_id)
        return declared and self._is_peer_known and _host_without_port(peer) == self._host

    def record_untrusted_source_if_new(self, message: Any) -> bool:
        """Return True if this untrusted source is to be reported: once each, up to a maximum."""
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source in self._reported_sources or len(self._reported_sources) >= MAX_REPORTED_SOURCES:
            return False
        self._reported_sources.add(source)
        return True


def _host_without_port(peer: Any) -> Any:
    """Return UDP's address without its port, which a router restart changes; `None` for a wire."""
    return peer[0] if isinstance(peer, tuple) else peer


class OperatorPort:
    """Converts messages addressed to the companion into events and responds to them.

    `submit_event(event)` passes a command to the pilot and returns its reply.
    """

    def __init__(
        self,
        send: Callable[[Any], None],
        submit_event: Callable[[Event], OperatorResponse],
        read_limits: Callable[[], AcceptedLimits],
        report_alert: AlertSink,
        trust: OperatorTrust | None = None,
    ) -> None:
        self._send = send
        self._submit_event = submit_event
        self._limits = read_limits
        self._report = report_alert
        self.trust = trust or OperatorTrust()

    def is_trusted_ground_station_heartbeat(
        self, message: Any, vehicle_system_id: int, peer: Any, *, signed: bool
    ) -> bool:
        """Return True for the heartbeat of a trusted ground station."""
        if message.get_type() != "HEARTBEAT" or message.type != mavlink.MAV_TYPE_GCS:
            return False
        return self.trust.trusts(message, vehicle_system_id, peer, signed=signed)

    def process_if_addressed_to_companion(
        self,
        message: Any,
        vehicle_system_id: int,
        t_s: float,
        peer: Any = None,
        *,
        signed: bool = False,
    ) -> bool:
        """Process a message from `peer` (`signed`: its signature was verified); return True if it
        was addressed to the companion.
        """
        kind = message.get_type()
        if kind not in (
            "COMMAND_LONG",
            "COMMAND_INT",
            "PARAM_REQUEST_LIST",
            "PARAM_REQUEST_READ",
            "PARAM_SET",
        ):
            return False
        if message.target_system != vehicle_system_id or message.target_component != COMPONENT:
            return False
        trusted = self.trust.trusts(message, vehicle_system_id, peer, signed=signed)
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._process_command_and_send_ack(message, t_s, trusted=trusted)
        elif trusted or kind != "PARAM_SET":
            self._answer_parameter_message(message, kind, t_s)
        if not trusted and self.trust.record_untrusted_source_if_new(message):
            source = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
            self._report(Alert.STRANGER_REFUSED, source=source)
        return True

    def _process_command_and_send_ack(self, message: Any, t_s: float, *, trusted: bool) -> None:
        event = self._event_from_command(message, t_s)
        if event is None:
            result = mavlink.MAV_RESULT_UNSUPPORTED
        elif not trusted or message.get_srcComponent() in NON_OPERATOR_COMPONENTS:
            result = mavlink.MAV_RESULT_DENIED
        else:
            result = MAV_RESULT_BY_RESPONSE[self._submit_event(event).status]
        self._send(
            mavlink.MAVLink_command_ack_message(
                message.command,
                result,
                0,
                0,
                message.get_srcSystem(),
                message.get_srcComponent(),
            )
        )

    def _event_from_command(self, message: Any, t_s: float) -> Event | None:
        by = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        match message.command:
            case mavlink.MAV_CMD_MISSION_START:
                return MissionAuthorised(t_s, by)
            case mavlink.MAV_CMD_DO_PAUSE_CONTINUE if message.param1 == 1.0:
                return ControlHandedBack(t_s, by)
            case mavlink.MAV_CMD_DO_PAUSE_CONTINUE if message.param1 == 0.0:
                return ControlReleaseOrdered(t_s, by)
            case mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                return AbortOrdered(t_s, by)
            case mavlink.MAV_CMD_DO_SET_HOME if message.param1 != 1.0:
                # Not the autopilot's home, the target of its RTL: the truck's stop at this
                # position.
                lat_deg, lon_deg = _lat_lon_deg(message)
                return HomeStopRequested(t_s, by, lat_deg=lat_deg, lon_deg=lon_deg)
            case _:
                return None

    def _answer_parameter_message(self, message: Any, message_type: str, t_s: float) -> None:
        if message_type == "PARAM_REQUEST_LIST":
            for name in PARAMETERS:
                self._send_parameter_value(name)
            return
        name = self._requested_parameter_name(message, message_type)
        if name is None:
            return
        if message_type == "PARAM_SET":
            self._submit_or_refuse_parameter_change(name, float(message.param_value), message, t_s)
        self._send_parameter_value(name)

    def _requested_parameter_name(self, message: Any, message_type: str) -> str | None:
        index = getattr(message, "param_index", -1) if message_type == "PARAM_REQUEST_READ" else -1
        if 0 <= index < len(PARAMETERS):
            return PARAMETERS[index]
        return message.param_id if message.param_id in PARAMETERS else None

    def _submit_or_refuse_parameter_change(
        self, name: str, value: float, message: Any, t_s: float
    ) -> None:
        low, high = PARAMETER_RANGES[name]
        by = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        if message.get_srcComponent() in NON_OPERATOR_COMPONENTS or not low <= value <= high:
            limits = {"low": low, "high": high}
            self._report(Alert.PARAMETER_REFUSED, name=name, value=value, source=by, **limits)
            return
        if name == "MAX_LOSS":
            self._submit_event(LimitsChanged(t_s, max_loss=value))
        else:
            self._submit_event(LimitsChanged(t_s, reserve_frac=value))

    def _send_parameter_value(self, name: str) -> None:
        limits = self._limits()
        value = limits.max_loss if name == "MAX_LOSS" else limits.reserve_frac
        self._send(
            mavlink.MAVLink_param_value_message(
                name.encode()[:NAME_LENGTH],
                value,
                mavlink.MAV_PARAM_TYPE_REAL32,
                len(PARAMETERS),
                PARAMETERS.index(name),
            )
        )


def _lat_lon_deg(message: Any) -> tuple[float, float]:
    """Return latitude and longitude of a command in degrees."""
    if message.get_type() == "COMMAND_INT":
        return message.x / 1e7, message.y / 1e7
    return float(message.param5), float(message.param6)
