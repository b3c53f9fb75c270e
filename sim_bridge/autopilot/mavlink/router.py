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

_NOT_FORWARDED_BY_ARDUPILOT = frozenset({109, 166, 246})  # RADIO_STATUS, RADIO, ADSB_VEHICLE
_HEARTBEAT = 0


@dataclass(frozen=True, slots=True)
class Routing:
    """Routing decision: local handling of a message, and the links to forward it to."""

    deliver: bool
    forward_to: tuple[Hashable, ...]


_LOCAL_ONLY = Routing(deliver=True, forward_to=())


class Router(Protocol):
    """Learns the senders on each link, and routes messages."""

    def add_link(self, link_id: Hashable) -> None:
        """A link is up."""
        ...

    def drop_link(self, link_id: Hashable) -> None:
        """A link is gone, and with it what was learned about it."""
        ...

    def learn_sender_and_route(self, link_id: Hashable, message: Message) -> Routing:
        """Learn the sender of `message`, received on `link_id`, and return its routing."""
        ...


def _target_system_and_component(message: Message) -> tuple[int, int]:
    """Return target system and component; 0 means all, also for types without such a field."""
    fields = message.__dict__
    return fields.get("target_system", 0), fields.get("target_component", 0)


class _LearnedRoutes:
    """The (system, component) pairs received on each link, in learning order."""

    def __init__(self, system: int, component: int) -> None:
        self._own = (system, component)
        self._seen_on: dict[Hashable, set[tuple[int, int]]] = {}

    def add_link(self, link_id: Hashable) -> None:
        self._seen_on.setdefault(link_id, set())

    def drop_link(self, link_id: Hashable) -> None:
        self._seen_on.pop(link_id, None)

    def record_sender(self, link_id: Hashable, sender: tuple[int, int]) -> None:
        seen = self._seen_on.setdefault(link_id, set())
        if sender[0] != 0 and sender != self._own:
            seen.add(sender)

    def senders_on_other_links(
        self, link_id: Hashable
    ) -> list[tuple[Hashable, set[tuple[int, int]]]]:
        return [(other, seen) for other, seen in self._seen_on.items() if other != link_id]


class ArduPilotRouter:
    """ArduPilot's routing: HEARTBEATs to every link, the rest to links with a known target."""

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

    def learn_sender_and_route(self, link_id: Hashable, message: Message) -> Routing:
        """Learn the sender and route; `deliver` is false for what is meant for others."""
        sender = (message.src_system, message.src_component)
        if sender == (self._system, self._component):
            return _LOCAL_ONLY  # a routing loop
        self._routes.record_sender(link_id, sender)
        if message.msg_id in _NOT_FORWARDED_BY_ARDUPILOT:
            return _LOCAL_ONLY
        others = self._routes.senders_on_other_links(link_id)
        if message.msg_id == _HEARTBEAT:
            return Routing(True, tuple(link for link, seen in others if sender not in seen))
        system, component = _target_system_and_component(message)
        match_system = system in (0, self._system)
        if system == self._system and component == self._component:
            return _LOCAL_ONLY
        forward_to = tuple(
            link for link, seen in others if self._has_route(seen, system, component)
        )
        for_us = match_system and component in (0, self._component)
        unclaimed = match_system and not forward_to
        return Routing(for_us or system == 0 or unclaimed, forward_to)

    def _has_route(
        self, link_senders: set[tuple[int, int]], target_system: int, target_component: int
    ) -> bool:
        if target_system == 0:
            return bool(link_senders)
        ours = target_system == self._system
        return any(
            s == target_system and (target_component in (0, c) or not ours) for s, c in link_senders
        )


class Px4Router:
    """PX4's routing: all messages not only for itself, to links with a known target."""

    def __init__(self, system: int, component: int) -> None:
        self._system = system
        self._component = component
        self._routes = _LearnedRoutes(system, component)

    def add_link(self, link_id: Hashable) -> None:
        """Register a link; nothing is forwarded to it before a frame is received there."""
        self._routes.add_link(link_id)

    def drop_link(self, link_id: Hashable) -> None:
        """A link is gone, and with it what was learned about it."""
        self._routes.drop_link(link_id)

    def learn_sender_and_route(self, link_id: Hashable, message: Message) -> Routing:
        """Learn the sender and route; PX4's handlers look at the target component themselves."""
        self._routes.record_sender(link_id, (message.src_system, message.src_component))
        system, component = _target_system_and_component(message)
        deliver = system in (0, self._system)
        if (system, component) == (self._system, self._component):
            return _LOCAL_ONLY
        forward_to = tuple(
            link
            for link, seen in self._routes.senders_on_other_links(link_id)
            if (seen if system == 0 else any(s == system and component in (0, c) for s, c in seen))
        )
        return Routing(deliver, forward_to)
