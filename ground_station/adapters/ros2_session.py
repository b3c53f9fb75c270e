"""Publishes on ROS 2's zenoh network, in the key format of rmw_zenoh (its design document).

Topic: `DOMAIN/TOPIC/TYPE/HASH`. Publishers are announced by liveliness tokens, so that `ros2 topic
list` shows them. Each message has an attachment: sequence number, time, and the publisher's id.
"""

import json
import struct
import uuid
from dataclasses import dataclass
from typing import Any

import zenoh

from companion.fleet.zenoh_session import open_session
from ground_station.core.fleet.ros2_messages import TYPE_HASHES, RosMessage

NODE_NAME = "leeway"
QOS = "::,10:,:,:,,"
"""Reliable, volatile, the last 10 messages: the default of ROS 2."""
NO_HASH = "TypeHashNotSupported"
"""Humble has no type hashes."""


@dataclass(slots=True)
class _Publisher:
    publisher: zenoh.Publisher
    token: Any
    """The topic is announced while this object lives."""
    id_bytes: bytes
    sent_count: int = 0


class RosSession:
    """A node on ROS 2's network; it subscribes to nothing."""

    def __init__(self, endpoint: str, domain: int, *, is_humble: bool) -> None:
        """Connect as a client to the router of ROS 2, and wait for it.

        Raises LeewayError for an invalid endpoint.
        """
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self._session = open_session(config, None)
        self._domain, self._is_humble = domain, is_humble
        self._publishers: dict[str, _Publisher] = {}
        self._admin = f"@ros2_lv/{domain}/{self._session.info.zid()}/0"
        self._node = f"%/%/{NODE_NAME}"
        self._node_token = self._session.liveliness().declare_token(
            f"{self._admin}/0/NN/{self._node}"
        )

    def publish(self, message: RosMessage, epoch_us: int) -> None:
        """Publish a message. It is dropped while the network does not accept it."""
        known = self._publishers.get(message.topic)
        if known is None:
            known = self._publishers[message.topic] = self._declare_publisher(message)
        known.sent_count += 1
        attachment = struct.pack("<qqB", known.sent_count, 1000 * epoch_us, 16) + known.id_bytes
        known.publisher.put(message.cdr, attachment=attachment)

    def close(self) -> None:
        """Leave the network."""
        self._session.close()

    def _declare_publisher(self, message: RosMessage) -> _Publisher:
        type_hash = NO_HASH if self._is_humble else TYPE_HASHES[message.type_name]
        entity = len(self._publishers) + 1
        mangled = f"%{message.topic.replace('/', '%')}"
        endpoint = f"{mangled}/{message.type_name}/{type_hash}/{QOS}"
        token_key = f"{self._admin}/{entity}/MP/{self._node}/{endpoint}"
        return _Publisher(
            self._session.declare_publisher(
                f"{self._domain}/{message.topic}/{message.type_name}/{type_hash}",
                congestion_control=zenoh.CongestionControl.DROP,
            ),
            self._session.liveliness().declare_token(token_key),
            uuid.uuid4().bytes,
        )
