"""Messages between vehicle and dispatcher, and the vehicle's handling of commands."""

import json
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import (
    MAX_ENTRIES,
    MAX_STATE_AGE_S,
    CommandLog,
    CommandReply,
    command_log_from_dict,
)
from companion.fleet.messages import (
    MAX_MESSAGE_BYTES,
    MAX_ROUTE_CHARS,
    Assign,
    Command,
    CommandAction,
    CommandStatus,
    EventKind,
    FleetEvent,
    Launch,
    LaunchWindow,
    Recall,
    Refused,
    Result,
    ReturnControl,
    State,
    decode_message,
    encode_message,
)
from companion.fleet.topics import (
    VehicleKeys,
    vehicle_and_cell_from_key,
    vehicle_and_instance_from_key,
    vehicle_from_key,
)
from tests.fleet.wire import valid_from

LIFE = "a1b2"


def a_command(
    deed: CommandAction, id_: str = "c1", life: str = LIFE, as_of_s: float = 100.0
) -> Command:
    deed = valid_from(deed, life, as_of_s)
    return Command(id=id_, vehicle="d1", instance_id=life, as_of_s=as_of_s, by="desk", action=deed)


def a_state(**more: object) -> State:
    fields: dict[str, object] = {
        "vehicle": "d1",
        "instance_id": LIFE,
        "uptime_s": 1.0,
        "epoch_us": 5,
        "airframe": "m100",
        "max_payload_kg": 1.0,
        "phase": "standby",
        "log": "l1",
        "last_seq": 0,
    }
    return State(**{**fields, **more})  # pyright: ignore[reportArgumentType]


def test_every_message_comes_back_as_it_went():
    event = FleetEvent(
        vehicle="d1", log="l", seq=3, epoch_us=1, kind=EventKind.TEXT, text="é -> [0]"
    )
    result = Result(
        id="c1", vehicle="d1", instance_id=LIFE, status=CommandStatus.LATER, reason="busy"
    )
    command = a_command(Assign(assignment="a1", order="o1", flight={"format": "flight/1"}))
    assert decode_message(State, encode_message(a_state(p_home=0.99))) == a_state(p_home=0.99)
    assert decode_message(FleetEvent, encode_message(event)) == event
    assert decode_message(Result, encode_message(result)) == result
    assert decode_message(Command, encode_message(command)) == command


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"v": 1}, "version 1, expected 2"),
        ({"v": "1"}, "int"),
        ({"colour": "red"}, "colour"),
        ({"p_home": 1.5}, "p_home"),
        ({"vehicle": "../d1"}, "vehicle"),
        ({"vehicle": "*"}, "vehicle"),
        ({"uptime_s": -1.0}, "uptime_s"),
        ({"text": "x" * 501}, "text"),
        ({"way_out": "?" * (MAX_ROUTE_CHARS + 1)}, "way_out"),
        ({"way_home": '<img src="x">'}, "way_home"),
    ],
)
def test_a_state_that_breaks_the_format_is_refused_in_words(change: dict[str, object], words: str):
    table = json.loads(encode_message(a_state())) | change
    refused = decode_message(State, json.dumps(table).encode())
    assert isinstance(refused, Refused)
    assert words in refused.reason


def test_the_longest_words_and_ways_still_fit_into_a_state():
    numbers = dict.fromkeys(
        ("lat_deg", "lon_deg", "height_rel_m", "voltage_v", "energy_left_wh", "margin_wh",
         "wind_to_n_mps", "wind_to_e_mps"),
        -12.345678901234567,
    )  # fmt: skip
    shares = dict.fromkeys(("p_home", "p_home_now", "p_success"), 0.12345678901234567)
    way = "_~" * (MAX_ROUTE_CHARS // 2)
    state = a_state(
        text="語" * 500, monitor_text="x" * 500, outbound_route=way, return_route=way,
        assignment="a" * 64,
        order="o" * 64, home="h" * 64, **numbers, **shares,
    )  # fmt: skip
    assert len(encode_message(state)) <= MAX_MESSAGE_BYTES["state"]
    told = decode_message(State, encode_message(state))
    assert isinstance(told, State)
    assert (told.outbound_route, told.return_route) == (way, way)


def test_a_state_of_before_tells_no_way_and_is_taken():
    table = json.loads(encode_message(a_state(outbound_route="_p~iF~ps|U")))
    del table["way_out"], table["way_home"]
    assert decode_message(State, json.dumps(table).encode()) == a_state()


COV = (0.512, -0.03, 0.498)


def old_reader() -> msgspec.json.Decoder[Any]:
    """Return a decoder from before states had a covariance: unknown fields are refused."""
    fields = [f for f in msgspec.structs.fields(State) if f.name != "wind_cov_m2ps2"]
    made = msgspec.defstruct(
        "OldState", [(f.encode_name, f.type, f.default) if not f.required
                     else (f.encode_name, f.type) for f in fields],
        forbid_unknown_fields=True, kw_only=True,
    )  # fmt: skip
    return msgspec.json.Decoder(made)


def test_states_of_before_tell_no_covariance_and_readers_of_before_are_told_none():
    plain = a_state(wind_to_n_mps=3.25, wind_to_e_mps=-1.5)
    assert b"wind_cov" not in encode_message(plain)
    assert old_reader().decode(encode_message(plain)).wind_to_n_mps == 3.25
    told = decode_message(State, encode_message(plain))
    assert isinstance(told, State)
    assert told.wind_cov_m2ps2 is msgspec.UNSET
    with pytest.raises(msgspec.ValidationError, match="wind_cov"):  # so old readers get none
        old_reader().decode(encode_message(a_state(wind_cov_m2ps2=COV)))


@pytest.mark.parametrize("cov", [None, [1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 401.0], [1, "a", 1]])
def test_what_is_no_covariance_is_refused(cov: object):
    table = json.loads(encode_message(a_state())) | {"wind_cov_m2ps2": cov}
    refused = decode_message(State, json.dumps(table).encode())
    assert isinstance(refused, Refused)
    assert "wind_cov_m2ps2" in refused.reason


def test_the_wind_of_a_drone_takes_less_than_200_bytes_a_second():
    """States are sent at 1 Hz. All fields of a wind report count, not only those added: names,
    position, height (MAVLink's 1e-7 degrees and millimetres), wind, covariance.
    """
    wind: dict[str, object] = {
        "lat_deg": -55.4701234, "lon_deg": -108.4501234, "height_rel_m": -119.999,
        "wind_to_n_mps": -12.346, "wind_to_e_mps": -12.346,
    }  # fmt: skip
    nothing = len(encode_message(a_state())) - sum(len(f'"{name}":null,') for name in wind)
    mean = len(encode_message(a_state(**wind))) - nothing
    a_second = (
        len(encode_message(a_state(**wind, wind_cov_m2ps2=(10.512, -10.031, 10.498)))) - nothing
    )
    print(f"{a_second} bytes a second, {a_second - mean} of them the covariance")
    assert a_second - mean < 50
    assert a_second < 200


def test_a_message_of_another_version_is_refused_whatever_else_it_holds():
    refused = decode_message(Command, b'{"v": 7, "new_field": [1, 2], "id": "c"}')
    assert isinstance(refused, Refused)
    assert "version 7, expected 2" in refused.reason


@pytest.mark.parametrize("message_type", [State, FleetEvent, Command, Result])
def test_a_message_too_large_is_refused_before_it_is_read(message_type):
    refused = decode_message(message_type, b'{"v":1' + b" " * (1 << 20) + b"}")
    assert isinstance(refused, Refused)
    assert "bytes, expected at most" in refused.reason


def test_a_command_too_large_is_not_even_sent():
    flight = {"name": "x" * MAX_MESSAGE_BYTES["command"]}
    with pytest.raises(LeewayError, match="bytes, expected at most"):
        encode_message(a_command(Assign(assignment="a", order="o", flight=flight)))


def test_numbers_that_are_none_do_not_travel():
    for text in ("NaN", "Infinity", "1e999"):
        raw = encode_message(a_state(margin_wh=7.25)).replace(b"7.25", text.encode())
        assert isinstance(decode_message(State, raw), Refused)


@given(st.binary(max_size=300))
def test_no_bytes_break_a_decoder(raw: bytes):
    for message_type in (State, FleetEvent, Command, Result):
        decode_message(message_type, raw)


def test_nesting_does_not_break_a_decoder():
    deep = b'{"v":1,"deed":' + b"[" * 200_000 + b"]" * 200_000 + b"}"
    assert isinstance(decode_message(Command, deep), Refused)


@pytest.mark.parametrize("name", ["", "D1", "a/b", "a*", "$x", "-a", "x" * 33, "ä", "a b"])
def test_a_name_that_zenoh_would_read_otherwise_is_no_name(name: str):
    with pytest.raises(LeewayError, match="vehicle"):
        VehicleKeys("depot", name)


def test_keys_name_their_vehicle_and_foreign_keys_none():
    keys = VehicleKeys("depot", "d1")
    assert vehicle_from_key(keys.state_key) == "d1"
    assert vehicle_and_instance_from_key(keys.alive_key(LIFE)) == ("d1", LIFE)
    assert vehicle_and_instance_from_key(keys.state_key) is None
    assert vehicle_from_key("other/depot/vehicle/d1/state") is None
    assert vehicle_and_cell_from_key(keys.track_key("16163/11868")) == ("d1", "16163/11868")
    assert vehicle_and_cell_from_key(keys.state_key) is None
    assert vehicle_and_cell_from_key("leeway/depot/vehicle/d1/track") is None, (
        "as vehicles of before told it"
    )
    assert vehicle_and_cell_from_key("leeway/depot/vehicle/*/track/1/1") is None


# --- command log ---------------------------------------------------------------------------------


def carry_out(book: CommandLog, command: Command, verdict: CommandReply) -> None:
    assert book.reply_without_execution_or_none(command, LIFE, 101.0) is None
    book.record_start(command)
    book.record_final_reply_or_remove_command(command, verdict)


def test_a_command_sent_twice_is_answered_the_same_and_not_done_again():
    book, command = CommandLog(), a_command(Launch(assignment="a1"))
    carry_out(book, command, CommandReply(CommandStatus.DONE, "authorised"))
    later = msgspec.structs.replace(command, as_of_s=900.0)
    assert book.reply_without_execution_or_none(later, LIFE, 901.0) == CommandReply(
        CommandStatus.DONE, "authorised"
    )


def test_an_id_that_returns_with_another_wish_is_refused():
    book, command = CommandLog(), a_command(Launch(assignment="a1"))
    carry_out(book, command, CommandReply(CommandStatus.DONE))
    other = book.reply_without_execution_or_none(a_command(Launch(assignment="a2")), LIFE, 101.0)
    assert other is not None
    assert other.status is CommandStatus.REFUSED


def test_not_now_may_be_asked_again():
    book, command = CommandLog(), a_command(Launch(assignment="a1"))
    carry_out(book, command, CommandReply(CommandStatus.LATER, "planning"))
    assert book.reply_without_execution_or_none(command, LIFE, 102.0) is None


def test_a_companion_killed_while_doing_it_does_not_do_it_again():
    book, command = CommandLog(), a_command(Launch(assignment="a1"))
    book.record_start(command)
    table = msgspec.json.decode(msgspec.json.encode(book.to_storage_format()))
    seen = command_log_from_dict(table, "book").reply_without_execution_or_none(
        command, "another life", 3.0
    )
    assert seen is not None
    assert seen.status is CommandStatus.INTERRUPTED


def test_a_recall_that_was_cut_off_is_carried_out_after_all():
    book, command = CommandLog(), a_command(Recall())
    book.record_start(command)
    assert (
        command_log_from_dict(
            msgspec.to_builtins(book.to_storage_format()), "book"
        ).reply_without_execution_or_none(command, "x", 3.0)
        is None
    )


def test_a_command_from_long_ago_or_for_an_earlier_life_is_stale_but_a_recall_never_is():
    book = CommandLog()
    for deed, outdated in (
        (Launch(assignment="a1"), CommandStatus.EXPIRED),
        (ReturnControl(), CommandStatus.STALE),
    ):
        old = book.reply_without_execution_or_none(
            a_command(deed, as_of_s=100.0), LIFE, 100.1 + MAX_STATE_AGE_S
        )
        other = book.reply_without_execution_or_none(a_command(deed, life="before"), LIFE, 101.0)
        assert [v.status for v in (old, other) if v] == [outdated] * 2
    assert (
        book.reply_without_execution_or_none(a_command(Recall(), life="before"), LIFE, 1e6) is None
    )


@pytest.mark.parametrize(
    ("window", "status"),
    [
        (None, CommandStatus.REFUSED),
        ((95.0, 101.1), None),
        ((95.0, 100.9), CommandStatus.EXPIRED),
        ((101.1, 110.0), CommandStatus.LATER),
        ((95.0, 111.0), CommandStatus.REFUSED),
    ],
)
def test_safety_rule_7_a_launch_starts_within_its_validity_on_the_vehicles_clock(window, status):
    launch = Launch(assignment="a1")
    if window is not None:
        valid = LaunchWindow(instance_id=LIFE, not_before_s=window[0], expires_s=window[1])
        launch = Launch(assignment="a1", window=valid)
    command = msgspec.structs.replace(a_command(launch), action=launch)
    reply = CommandLog().reply_without_execution_or_none(command, LIFE, 101.0)
    assert (reply and reply.status) == status


def test_an_assignment_that_is_over_is_not_launched_again():
    book = CommandLog()
    book.prevent_relaunch_of_assignment("a1")
    seen = book.reply_without_execution_or_none(
        a_command(Launch(assignment="a1"), id_="c9"), LIFE, 101.0
    )
    assert seen is not None
    assert seen.status is CommandStatus.REFUSED
    assert (
        book.reply_without_execution_or_none(
            a_command(Launch(assignment="a2"), id_="c10"), LIFE, 101.0
        )
        is None
    )


def test_the_book_stays_bounded_and_forgets_the_oldest():
    book = CommandLog()
    for number in range(MAX_ENTRIES + 10):
        carry_out(book, a_command(Recall(), id_=f"c{number}"), CommandReply(CommandStatus.DONE))
    assert len(book.entries) == MAX_ENTRIES
    assert (
        book.reply_without_execution_or_none(
            a_command(Recall(), id_=f"c{MAX_ENTRIES + 9}"), LIFE, 101.0
        )
        is not None
    )


def test_a_broken_book_names_its_file():
    with pytest.raises(LeewayError, match=r"book\.json"):
        command_log_from_dict({"format": "command-book/9"}, "book.json")
