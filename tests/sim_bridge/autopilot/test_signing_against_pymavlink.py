"""The simulator's MAVLink 2 signing against pymavlink's, both ways."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as reference

from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.autopilot.mavlink.signing import SignatureCheck, Signing

KEY = bytes(range(32))
OTHER_KEY = bytes(32)
NOW_10US = 370_000_000 * 100_000  # September 2026
ONE_MINUTE = 60 * 100_000


def heartbeat(custom_mode: int) -> Message:
    return Message(
        "HEARTBEAT", type=2, autopilot=3, base_mode=81, custom_mode=custom_mode, system_status=3
    )


def sender(key: bytes = KEY, timestamp_10us: int = NOW_10US, link_id: int = 3) -> Encoder:
    return Encoder(255, 190, signing=Signing(key, timestamp_10us).link_signer(link_id))


def pymavlink_peer(key: bytes = KEY, timestamp_10us: int = NOW_10US) -> reference.MAVLink:
    peer = reference.MAVLink(None, srcSystem=255, srcComponent=190)
    peer.robust_parsing = True
    peer.signing.secret_key = key
    peer.signing.link_id = 3
    peer.signing.timestamp = timestamp_10us
    peer.signing.sign_outgoing = True
    return peer


def verdicts_on(frames: list[bytes], key: bytes = KEY) -> list[SignatureCheck]:
    signing = Signing(key, NOW_10US)
    return [signing.check(frame) for frame in frames]


def test_pymavlink_accepts_what_we_sign() -> None:
    encoder = sender()
    peer = pymavlink_peer()
    for mode in range(3):
        (received,) = peer.parse_buffer(encoder.encode_next_frame(heartbeat(mode)))
        assert received.get_type() == "HEARTBEAT"
        assert received.get_signed()
        assert received.custom_mode == mode


def test_we_accept_what_pymavlink_signs() -> None:
    peer = pymavlink_peer()
    link = Signing(KEY, NOW_10US).link_signer(0)
    decoder = Decoder(signing=link)
    for mode in range(3):
        frame = bytes(peer.heartbeat_encode(2, 3, 81, mode, 3).pack(peer))
        assert decoder.decode_bytes(frame) == [heartbeat(mode)]
    assert link.verdicts[SignatureCheck.ACCEPTED] == 3


def test_the_same_frame_gets_the_same_signature_from_both() -> None:
    peer = pymavlink_peer()
    theirs = bytes(peer.heartbeat_encode(2, 3, 81, 7, 3).pack(peer))
    assert sender().encode_next_frame(heartbeat(7)) == theirs


@pytest.mark.parametrize("signed", [False, True])
def test_pymavlink_and_we_refuse_the_same(signed: bool) -> None:
    frame = (
        sender(OTHER_KEY).encode_next_frame(heartbeat(1))
        if signed
        else Encoder(1, 1).encode_next_frame(heartbeat(1))
    )
    (theirs,) = pymavlink_peer().parse_buffer(frame)
    assert theirs.get_type() == "BAD_DATA"
    decoder = Decoder(signing=Signing(KEY, NOW_10US).link_signer(0))
    assert decoder.decode_bytes(frame) == []
    assert decoder.counts.rejected == 1


def test_mavlink_1_cannot_be_signed_and_is_refused() -> None:
    frame = Encoder(1, 1, version=1).encode_next_frame(heartbeat(1))
    assert verdicts_on([frame]) == [SignatureCheck.UNSIGNED]


def test_a_replayed_or_reordered_frame_is_refused() -> None:
    encoder = sender()
    first, second, third = (encoder.encode_next_frame(heartbeat(mode)) for mode in range(3))
    assert verdicts_on([first, third, third, second, first]) == [
        SignatureCheck.ACCEPTED,
        SignatureCheck.ACCEPTED,
        SignatureCheck.REPLAYED,
        SignatureCheck.REPLAYED,
        SignatureCheck.REPLAYED,
    ]


def test_a_replay_over_another_of_our_links_is_refused_too() -> None:
    frame = sender().encode_next_frame(heartbeat(1))
    signing = Signing(KEY, NOW_10US)
    one, other = Decoder(signing=signing.link_signer(0)), Decoder(signing=signing.link_signer(1))
    assert one.decode_bytes(frame) == [heartbeat(1)]
    assert other.decode_bytes(frame) == []


def test_a_new_stream_may_begin_at_most_a_minute_in_the_past() -> None:
    just_in, too_old = (
        sender(timestamp_10us=NOW_10US - ONE_MINUTE - late, link_id=late).encode_next_frame(
            heartbeat(1)
        )
        for late in (0, 1)
    )
    assert verdicts_on([just_in, too_old]) == [SignatureCheck.ACCEPTED, SignatureCheck.OLD_STREAM]


def test_a_flipped_bit_anywhere_is_refused() -> None:
    frame = sender().encode_next_frame(heartbeat(1))
    for at in (1, 4, 9, len(frame) - 13, len(frame) - 10, len(frame) - 1):
        broken = bytearray(frame)
        broken[at] ^= 1
        assert Signing(KEY, NOW_10US).check(bytes(broken)) is SignatureCheck.WRONG_KEY


def test_the_clock_follows_the_newest_peer_and_never_goes_back() -> None:
    signing = Signing(KEY, NOW_10US)
    signing.check(sender(timestamp_10us=NOW_10US + 1000).encode_next_frame(heartbeat(1)))
    assert signing.timestamp_10us == NOW_10US + 1000
    signing.advance_clock_to(NOW_10US)
    assert signing.timestamp_10us == NOW_10US + 1000


def test_a_telemetry_radio_may_report_unsigned() -> None:
    report = Message(
        "RADIO_STATUS", rssi=1, remrssi=1, txbuf=90, noise=1, remnoise=1, rxerrors=0, fixed=0
    )
    assert verdicts_on([Encoder(51, 68).encode_next_frame(report)]) == [SignatureCheck.ACCEPTED]


def test_without_signing_a_signed_frame_is_read_like_any_other() -> None:
    assert Decoder().decode_bytes(sender().encode_next_frame(heartbeat(5))) == [heartbeat(5)]


def test_a_key_has_32_bytes() -> None:
    with pytest.raises(ValueError, match="31 bytes instead of 32"):
        Signing(bytes(31), 0)
