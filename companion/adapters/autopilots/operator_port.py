"""What is addressed to us: commands and parameters of an operator, answered as a component does.

An operator names our system and component 191, is neither an autopilot nor an onboard computer, and
is trusted (`OperatorTrust`). PX4 itself sends 1000, 1001 and 2003: those are answered UNSUPPORTED.
"""

from collections.abc import Callable
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, COMPONENT, mavlink
from companion.core.mission.actions import Reply
from companion.core.mission.events import (
    AbortOrdered,
    Authorised,
    ControlHandedBack,
    ControlTaken,
    Event,
    HomeMoved,
    LimitsChanged,
)
from companion.core.pilot.estimates import Limits

PARAMETERS = ("MAX_LOSS", "RESERVE_FRAC")
RANGES = {"MAX_LOSS": (1e-6, 0.5), "RESERVE_FRAC": (0.0, 0.6)}
NOT_OPERATORS = (
    AUTOPILOT,
    COMPONENT,
    mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2,
    mavlink.MAV_COMP_ID_ONBOARD_COMPUTER3,
    mavlink.MAV_COMP_ID_ONBOARD_COMPUTER4,
)
ACK = {
    Reply.ACCEPTED: mavlink.MAV_RESULT_ACCEPTED,
    Reply.LATER: mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    Reply.DENIED: mavlink.MAV_RESULT_DENIED,
}
NAME_LENGTH = 16
GROUND_STATION = 255
"""The system that ground stations speak as unless told otherwise."""

MOST_TOLD = 16
"""Strangers that the operator hears of: a flood of made-up sources is told no further."""


class OperatorTrust:
    """Whose orders count: anybody's that are signed with our key, since others are not heard then;
    without a key those of declared systems, and of the vehicle's own, by the way that the autopilot
    was found on. A stranger who sends to our port comes from another address.
    """

    def __init__(self, operators: frozenset[int] = frozenset({GROUND_STATION})) -> None:
        self._operators = operators
        self._host: Any = None
        self._is_found = False
        self._told: set[tuple[int, int]] = set()

    def found(self, peer: Any) -> None:
        """The autopilot was identified by frames from this peer: its host stays the one."""
        if not self._is_found:
            self._host, self._is_found = _host_of(peer), True

    def trusts(self, message: Any, system_id: int, peer: Any, *, signed: bool) -> bool:
        """Whether an order that came by this peer counts."""
        if signed:
            return True
        declared = message.get_srcSystem() in (*self._operators, system_id)
        return declared and self._is_found and _host_of(peer) == self._host

    def is_new_stranger(self, message: Any) -> bool:
        """Whether to tell of this source, which is not trusted: once, and not of a flood."""
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source in self._told or len(self._told) >= MOST_TOLD:
            return False
        self._told.add(source)
        return True


def _host_of(peer: Any) -> Any:
    """UDP's address without its port, which a router's restart changes; `None` on a wire."""
    return peer[0] if isinstance(peer, tuple) else peer


class OperatorPort:
    """Turns what is addressed to us into events and answers it.

    `ask(event)` hands an order to the pilot and returns its reply.
    """

    def __init__(
        self,
        send: Callable[[Any], None],
        ask: Callable[[Event], Reply],
        limits: Callable[[], Limits],
        say: Callable[[str], None],
        trust: OperatorTrust | None = None,
    ) -> None:
        self._send = send
        self._ask = ask
        self._limits = limits
        self._say = say
        self.trust = trust or OperatorTrust()

    def is_station(self, message: Any, system_id: int, peer: Any, *, signed: bool) -> bool:
        """Whether this is the heartbeat of a ground station whose commands count."""
        if message.get_type() != "HEARTBEAT" or message.type != mavlink.MAV_TYPE_GCS:
            return False
        return self.trust.trusts(message, system_id, peer, signed=signed)

    def on_message(
        self, message: Any, system_id: int, t_s: float, peer: Any = None, *, signed: bool = False
    ) -> bool:
        """Take a message that came by `peer` (`signed`: its signature was checked); tells whether
        it was addressed to us and is dealt with.
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
        if message.target_system != system_id or message.target_component != COMPONENT:
            return False
        trusted = self.trust.trusts(message, system_id, peer, signed=signed)
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._command(message, t_s, trusted=trusted)
        elif trusted or kind != "PARAM_SET":
            self._parameter(message, kind, t_s)
        if not trusted and self.trust.is_new_stranger(message):
            source = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
            self._say(f"{source} is no operator here (--operator)")
        return True

    def _command(self, message: Any, t_s: float, *, trusted: bool) -> None:
        event = self._order(message, t_s)
        if event is None:
            result = mavlink.MAV_RESULT_UNSUPPORTED
        elif not trusted or message.get_srcComponent() in NOT_OPERATORS:
            result = mavlink.MAV_RESULT_DENIED
        else:
            result = ACK[self._ask(event)]
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

    def _order(self, message: Any, t_s: float) -> Event | None:
        by = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        match message.command:
            case mavlink.MAV_CMD_MISSION_START:
                return Authorised(t_s, by)
            case mavlink.MAV_CMD_DO_PAUSE_CONTINUE if message.param1 == 1.0:
                return ControlHandedBack(t_s, by)
            case mavlink.MAV_CMD_DO_PAUSE_CONTINUE if message.param1 == 0.0:
                return ControlTaken(t_s, by)
            case mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                return AbortOrdered(t_s, by)
            case mavlink.MAV_CMD_DO_SET_HOME if message.param1 != 1.0:
                # Not the autopilot's home, where its RTL goes: the truck's stop at this place.
                lat_deg, lon_deg = _place_of(message)
                return HomeMoved(t_s, by, lat_deg=lat_deg, lon_deg=lon_deg)
            case _:
                return None

    def _parameter(self, message: Any, kind: str, t_s: float) -> None:
        if kind == "PARAM_REQUEST_LIST":
            for name in PARAMETERS:
                self._tell(name)
            return
        name = self._named(message, kind)
        if name is None:
            return
        if kind == "PARAM_SET":
            self._set(name, float(message.param_value), message, t_s)
        self._tell(name)

    def _named(self, message: Any, kind: str) -> str | None:
        index = getattr(message, "param_index", -1) if kind == "PARAM_REQUEST_READ" else -1
        if 0 <= index < len(PARAMETERS):
            return PARAMETERS[index]
        return message.param_id if message.param_id in PARAMETERS else None

    def _set(self, name: str, value: float, message: Any, t_s: float) -> None:
        low, high = RANGES[name]
        by = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        if message.get_srcComponent() in NOT_OPERATORS or not low <= value <= high:
            self._say(f"{name} {value:g} from {by} refused: {low:g} to {high:g}")
            return
        if name == "MAX_LOSS":
            self._ask(LimitsChanged(t_s, max_loss=value))
        else:
            self._ask(LimitsChanged(t_s, reserve_frac=value))

    def _tell(self, name: str) -> None:
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


def _place_of(message: Any) -> tuple[float, float]:
    """Latitude and longitude of a command, degrees."""
    if message.get_type() == "COMMAND_INT":
        return message.x / 1e7, message.y / 1e7
    return float(message.param5), float(message.param6)
