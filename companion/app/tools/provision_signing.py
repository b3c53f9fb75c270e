"""Give an autopilot a signing key (SETUP_SIGNING) and see that it signs with it.

The key goes over the link in the clear: a wire, or a network that nobody else hears.
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
from companion.adapters.clock import epoch_us, is_due, wall_s
from companion.adapters.files.signing_files import KEY_BYTES, read_signing_key, write_signing_key
from companion.core.base.errors import LeewayError

WAIT_S = 0.1
HEARTBEAT_S = 1.0
FOUND_LIMIT_S = 30.0
"""Both autopilots send a heartbeat each second once they have booted, which takes some seconds."""

SIGNED_LIMIT_S = 10.0
ASK_AGAIN_S = 1.0
HEARTBEATS = 3
"""Of one system, none of another between: a stray frame is not the vehicle."""


class Provisioning:
    """One autopilot on one link. Every step raises LeewayError with what is wrong."""

    def __init__(self, link: Link, clock_s: Callable[[], float] = wall_s) -> None:
        self._link = link
        self._clock_s = clock_s
        self._plain = MavlinkCodec(datagrams=link.datagrams)

    def provision(self, key: bytes, system_id: int | None = None) -> int:
        """Hand over the key; the system that signs with it now."""
        system = self._find(system_id)
        signed = MavlinkCodec(datagrams=self._link.datagrams, signing_key=key)
        stamp = (epoch_us() - SIGNING_EPOCH_US) // 10
        setup = mavlink.MAVLink_setup_signing_message(system, AUTOPILOT, list(key), stamp)
        asked_s: float | None = None
        until_s = self._clock_s() + SIGNED_LIMIT_S
        while self._clock_s() < until_s:
            if is_due(asked_s, ASK_AGAIN_S, self._clock_s()):
                asked_s = self._clock_s()
                self._link.send(self._plain.pack(setup))
            incoming = self._link.receive(WAIT_S)
            for message in signed.parse(incoming.data) if incoming is not None else []:
                if message.get_srcSystem() == system:
                    return system
        raise LeewayError(
            f"system {system} did not begin to sign in {SIGNED_LIMIT_S:.0f} s: it is armed, its"
            " firmware takes no key on this link, or it has another key already"
        )

    def _find(self, wanted: int | None) -> int:
        """The autopilot's system, which must be disarmed and not sign yet."""
        heard: list[int] = []
        beat_s: float | None = None
        until_s = self._clock_s() + FOUND_LIMIT_S
        while self._clock_s() < until_s:
            if is_due(beat_s, HEARTBEAT_S, self._clock_s()):
                beat_s = self._clock_s()
                self._link.send(self._plain.pack(_heartbeat()))
            incoming = self._link.receive(WAIT_S)
            for message in self._plain.parse(incoming.data) if incoming is not None else []:
                if not _is_autopilots(message, wanted):
                    continue
                self._link.answer_to(incoming.peer if incoming is not None else None)
                if message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
                    raise LeewayError("the vehicle is armed: a key is given on the ground only")
                heard.append(message.get_srcSystem())
                if heard[-HEARTBEATS:] == [heard[-1]] * HEARTBEATS:
                    return heard[-1]
        raise LeewayError(f"no autopilot heard in {FOUND_LIMIT_S:.0f} s")


def key_of(path: Path) -> tuple[bytes, bool]:
    """The key of a file, made at random where there is none; whether it is new."""
    if path.exists():
        return read_signing_key(path), False
    key = secrets.token_bytes(KEY_BYTES)
    write_signing_key(path, key)
    return key, True


def _is_autopilots(message: Any, wanted: int | None) -> bool:
    if message.get_type() != "HEARTBEAT" or message.get_srcComponent() != AUTOPILOT:
        return False
    return wanted is None or message.get_srcSystem() == wanted


def _heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        *(0, 0),
        mavlink.MAV_STATE_STANDBY,
        3,
    )
