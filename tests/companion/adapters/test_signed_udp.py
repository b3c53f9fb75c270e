"""Orders over real UDP to a companion with a signing key: unsigned, re-signed and replayed frames
are rejected. Each check has a canary that accepts them without the guard.

The frames are made by the simulator's own codec, which shares no code with the companion's.
"""

import hashlib
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from companion.adapters.autopilots.codec import SIGNING_EPOCH_US, MavlinkCodec
from companion.adapters.autopilots.link import UdpLink
from companion.adapters.clock import unix_time_us
from sim_bridge.autopilot.mavlink.codec import Encoder, Message
from sim_bridge.autopilot.mavlink.signing import Signing

KEY, OTHER_KEY = bytes(range(32)), bytes(32)
PATIENCE_S = 20.0
LAST = 99
"""The sequence of orders ends with this one, rightly signed: what came before it has been heard."""

SIGNATURE_BYTES = 13


def order(number: int, key: bytes | None = KEY) -> bytes:
    """Return an ARM or DISARM order with a number; each is signed 1 s after the previous one."""
    now = (unix_time_us() - SIGNING_EPOCH_US) // 10 + 100_000 * number
    signing = None if key is None else Signing(key, now).link_signer(7)
    fields = {f"param{n}": 0.0 for n in range(2, 8)}
    told = {"target_system": 1, "target_component": 191, "command": 400, "confirmation": 0}
    return Encoder(255, 190, signing=signing).encode_next_frame(
        Message("COMMAND_LONG", param1=float(number), **told, **fields)
    )


def re_signed(frame: bytes) -> bytes:
    """Return a captured valid frame, signed again with a key of the attacker."""
    return frame[:-SIGNATURE_BYTES] + order(2, OTHER_KEY)[-SIGNATURE_BYTES:]


def altered(frame: bytes) -> bytes:
    """Return a frame with the valid signature of another frame."""
    return order(2)[:-SIGNATURE_BYTES] + frame[-SIGNATURE_BYTES:]


def any_signature(self: Any, msgbuf: Any, system: int, component: int) -> bool:
    return True


def any_time(self: Any, msgbuf: Any, system: int, component: int) -> bool:
    """Accept a correct key with a time stamp of any age."""
    right = hashlib.sha256(bytes(self.signing.secret_key) + bytes(msgbuf[:-6])).digest()[:6]
    return right == bytes(msgbuf[-6:])


Attack = Callable[[bytes], list[bytes]]
ATTACKS: dict[str, tuple[Attack, list[int], Callable[..., bool] | None]] = {
    "unsigned": (lambda true: [order(2, None)], [1, 2], None),
    "signed by another key": (lambda true: [order(2, OTHER_KEY)], [1, 2], any_signature),
    "re-signed": (lambda true: [re_signed(true)], [1, 1], any_signature),
    "altered": (lambda true: [altered(true)], [1, 2], any_signature),
    "replayed": (lambda true: [true, true], [1, 1, 1], any_time),
}
"""What follows a true order; the numbers that are heard where the guard is taken out, and by what
(None: the companion has no key).
"""


@pytest.fixture
def link() -> Iterator[UdpLink]:
    made = UdpLink("127.0.0.1", 0, listen=True)
    yield made
    made.close()


def heard(link: UdpLink, ears: MavlinkCodec, frames: list[bytes]) -> list[int]:
    """Return the numbers of the accepted orders, up to the last."""
    numbers: list[int] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker:
        for frame in frames:
            attacker.sendto(frame, link.address)
        while LAST not in numbers:
            came = link.receive(PATIENCE_S)
            assert came is not None
            numbers += [int(message.param1) for message in ears.parse_valid_messages(came.data)]
    return numbers[:-1]


@pytest.mark.parametrize("guarded", [True, False], ids=["not heard", "canary: heard"])
@pytest.mark.parametrize("attack", ATTACKS)
def test_only_an_order_that_is_rightly_signed_is_heard_and_once(link, monkeypatch, attack, guarded):
    forge, without_guard, taken_out = ATTACKS[attack]
    key = KEY if guarded or taken_out is not None else None
    if not guarded and taken_out is not None:
        monkeypatch.setattr(type(MavlinkCodec(datagrams=True).mav), "check_signature", taken_out)
    true = order(1)
    ears = MavlinkCodec(datagrams=True, signing_key=key)
    found = heard(link, ears, [true, *forge(true), order(LAST)])
    assert found == ([1] if guarded else without_guard)
