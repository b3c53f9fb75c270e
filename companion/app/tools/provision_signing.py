"""Send a signing key to an autopilot (SETUP_SIGNING) and verify that it signs with the key.

The key is sent unencrypted: use a cable or an isolated network.
"""

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any

from companion.adapters.autopilots.codec import (
    AUTOPILOT,
    SIGNING_EPOCH_US,
    MavlinkCodec,
    mavlink,
)
from companion.adapters.autopilots.link import Link
from companion.adapters.clock import is_due, unix_time_us, wall_s
from companion.adapters.files.signing_files import KEY_BYTES, read_signing_key, write_signing_key
from companion.core.base.errors import LeewayError

WAIT_S = 0.1
HEARTBEAT_S = 1.0
DETECTION_TIMEOUT_S = 30.0
"""Both autopilots send a heartbeat each second after a boot of some seconds."""

SIGNING_TIMEOUT_S = 10.0
REQUEST_INTERVAL_S = 1.0
REQUIRED_HEARTBEATS = 3
"""Required consecutive heartbeats of one system: a stray frame does not identify a vehicle."""


class Provisioning:
    """One autopilot on one link. Each step raises LeewayError on failure."""

    def __init__(self, link: Link, clock_s: Callable[[], float] = wall_s) -> None:
        self._link = link
        self._clock_s = clock_s
        self._plain = MavlinkCodec(datagrams=link.datagrams)

    def send_signing_key_and_verify(self, signing_key: bytes, system_id: int | None = None) -> int:
        """Send the key and return the system id that signs with it."""
        system = self._wait_for_disarmed_autopilot_id(system_id)
        signed = MavlinkCodec(datagrams=self._link.datagrams, signing_key=signing_key)
        stamp = (unix_time_us() - SIGNING_EPOCH_US) // 10
        setup = mavlink.MAVLink_setup_signing_message(system, AUTOPILOT, list(signing_key), stamp)
        requested_s: float | None = None
        until_s = self._clock_s() + SIGNING_TIMEOUT_S
        while self._clock_s() < until_s:
            if is_due(requested_s, REQUEST_INTERVAL_S, self._clock_s()):
                requested_s = self._clock_s()
                self._link.send(self._plain.pack(setup))
            incoming = self._link.receive(WAIT_S)
            for message in (
                signed.parse_valid_messages(incoming.data) if incoming is not None else []
            ):
                if message.get_srcSystem() == system:
                    return system
        raise LeewayError(
            f"system {system} did not begin to sign in {SIGNING_TIMEOUT_S:.0f} s: it is armed, its"
            " firmware accepts no key on this link, or it already has another key"
        )

    def _wait_for_disarmed_autopilot_id(self, system_id_filter: int | None) -> int:
        """Return the system id of the autopilot, which must be disarmed and unsigned."""
        received_systems: list[int] = []
        heartbeat_s: float | None = None
        until_s = self._clock_s() + DETECTION_TIMEOUT_S
        while self._clock_s() < until_s:
            if is_due(heartbeat_s, HEARTBEAT_S, self._clock_s()):
                heartbeat_s = self._clock_s()
                self._link.send(self._plain.pack(_heartbeat_message()))
            incoming = self._link.receive(WAIT_S)
            for message in (
                self._plain.parse_valid_messages(incoming.data) if incoming is not None else []
            ):
                if not _is_autopilot_heartbeat(message, system_id_filter):
                    continue
                self._link.set_reply_peer(incoming.peer if incoming is not None else None)
                if message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
                    raise LeewayError("the vehicle is armed: expected disarmed to set a key")
                received_systems.append(message.get_srcSystem())
                if (
                    received_systems[-REQUIRED_HEARTBEATS:]
                    == [received_systems[-1]] * REQUIRED_HEARTBEATS
                ):
                    return received_systems[-1]
        raise LeewayError(f"no autopilot heartbeat in {DETECTION_TIMEOUT_S:.0f} s")


def read_or_create_key(path: Path) -> tuple[bytes, bool]:
    """Return the key in a file, or a new random key, and whether it is new."""
    if path.exists():
        return read_signing_key(path), False
    key = secrets.token_bytes(KEY_BYTES)
    write_signing_key(path, key)
    return key, True


def _is_autopilot_heartbeat(message: Any, system_id_filter: int | None) -> bool:
    if message.get_type() != "HEARTBEAT" or message.get_srcComponent() != AUTOPILOT:
        return False
    return system_id_filter is None or message.get_srcSystem() == system_id_filter


def _heartbeat_message() -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        *(0, 0),
        mavlink.MAV_STATE_STANDBY,
        3,
    )
