"""Routing of messages between the links of an autopilot.

A ground station on one link reaches the companion on another through the autopilot. Both routers
follow the rules of the real autopilots.
Sources: ArduPilot, libraries/GCS_MAVLink/MAVLink_routing.cpp (check_and_forward); PX4,
src/modules/mavlink (Mavlink::forward_message, MavlinkReceiver::component_was_seen).
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Protocol

from sim_bridge.autopilot.mavlink.codec import Message

_NEVER_FORWARDED_BY_ARDUPILOT = frozenset({109, 166, 246})  # RADIO_STATUS, RADIO, ADSB_VEHICLE
_HEARTBEAT = 0


@dataclass(frozen=True, slots=True)
class Routing:
    """Whether the autopilot itself handles a message, and the links that it is passed on to."""

    deliver: bool
    forward_to: tuple[Hashable, ...]


_OURS = Routing(deliver=True, forward_to=())


class Router(Protocol):
    """Learns the senders on each link, and routes messages."""

    def add_link(self, link_id: Hashable) -> None:
        """A link is up."""
        ...

    def drop_link(self, link_id: Hashable) -> None:
        """A link is gone, and with it what was learned about it."""
        ...

    def route(self, link_id: Hashable, message: Message) -> Routing:
        """Learn the sender of `message`, arrived on `link_id`, and say where the message goes."""
        ...


def _targets(message: Message) -> tuple[int, int]:
    """Target system and component; 0 stands for all, also where the type has no such field."""
    fields = message.__dict__
    return fields.get("target_system", 0), fields.get("target_component", 0)


class _LearnedRoutes:
    """The (system, component) pairs heard on each link, in the order of learning."""

    def __init__(self, system: int, component: int) -> None:
        self._own = (system, component)
        self._seen_on: dict[Hashable, set[tuple[int, int]]] = {}

    def add_link(self, link_id: Hashable) -> None:
        self._seen_on.setdefault(link_id, set())

    def drop_link(self, link_id: Hashable) -> None:
        self._seen_on.pop(link_id, None)

    def learn(self, link_id: Hashable, sender: tuple[int, int]) -> None:
        seen = self._seen_on.setdefault(link_id, set())
        if sender[0] != 0 and sender != self._own:
            seen.add(sender)

    def others(self, link_id: Hashable) -> list[tuple[Hashable, set[tuple[int, int]]]]:
        return [(other, seen) for other, seen in self._seen_on.items() if other != link_id]


class ArduPilotRouter:
    """As ArduPilot routes: HEARTBEATs to every link, the rest where its target was heard."""

    def __init__(self, system: int, component: int) -> None:
        self._system = system
        self._component = component
        self._routes = _LearnedRoutes(system, component)

    def add_link(self, link_id: Hashable) -> None:
        """A link is up: HEARTBEATs of others go there from now on."""
        self._routes.add_link(link_id)

    def drop_link(self, link_id: Hashable) -> None:
        """A link is gone, and with it what was learned about it."""
        self._routes.drop_link(link_id)

    def route(self, link_id: Hashable, message: Message) -> Routing:
        """Learn the sender and route; `deliver` is false for what is meant for others."""
        sender = (message.src_system, message.src_component)
        if sender == (self._system, self._component):
            return _OURS  # a routing loop
        self._routes.learn(link_id, sender)
        if message.msg_id in _NEVER_FORWARDED_BY_ARDUPILOT:
            return _OURS
        others = self._routes.others(link_id)
        if message.msg_id == _HEARTBEAT:
            return Routing(True, tuple(link for link, seen in others if sender not in seen))
        system, component = _targets(message)
        match_system = system in (0, self._system)
        if system == self._system and component == self._component:
            return _OURS
        forward_to = tuple(
            link for link, seen in others if self._is_reached(seen, system, component)
        )
        for_us = match_system and component in (0, self._component)
        unclaimed = match_system and not forward_to
        return Routing(for_us or system == 0 or unclaimed, forward_to)

    def _is_reached(self, seen: set[tuple[int, int]], system: int, component: int) -> bool:
        if system == 0:
            return bool(seen)
        ours = system == self._system
        return any(s == system and (component in (0, c) or not ours) for s, c in seen)


class Px4Router:
    """As PX4 routes: everything not only for itself to the links where its target was heard."""

    def __init__(self, system: int, component: int, *, forward_heartbeats: bool = True) -> None:
        self._system = system
        self._component = component
        self._forward_heartbeats = forward_heartbeats  # MAV_HB_FORW_EN, on by default
        self._routes = _LearnedRoutes(system, component)

    def add_link(self, link_id: Hashable) -> None:
        """A link is up; nothing is forwarded to it before somebody was heard there."""
        self._routes.add_link(link_id)

    def drop_link(self, link_id: Hashable) -> None:
        """A link is gone, and with it what was learned about it."""
        self._routes.drop_link(link_id)

    def route(self, link_id: Hashable, message: Message) -> Routing:
        """Learn the sender and route; PX4's handlers look at the target component themselves."""
        self._routes.learn(link_id, (message.src_system, message.src_component))
        system, component = _targets(message)
        deliver = system in (0, self._system)
        if (system, component) == (self._system, self._component):
            return _OURS
        if message.msg_id == _HEARTBEAT and not self._forward_heartbeats:
            return _OURS
        forward_to = tuple(
            link
            for link, seen in self._routes.others(link_id)
            if (seen if system == 0 else any(s == system and component in (0, c) for s, c in seen))
        )
        return Routing(deliver, forward_to)
