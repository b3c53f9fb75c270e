"""Parameters on the wire."""

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviour, Finding
from sim_bridge.conform.client import Message
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.subject import Subject

_NOBODYS = "XYZ_NOT_THERE"
_FLOAT = mavlink.MAV_PARAM_TYPE_REAL32


def _integer(s: Subject) -> Message:
    message = s.read_raw(s.dialect.integer_parameter)
    if message is None:
        raise CannotSee(f"{s.dialect.integer_parameter} is not answered")
    return message


def _encoding(s: Subject) -> Finding:
    """A whole number is a C cast; its bytes in a float are a number of nearly nothing."""
    message = _integer(s)
    value = message.param_value
    word = "integer bits in the float" if 0.0 < abs(value) < 1e-30 else "C cast"
    return Finding(word, f"{s.dialect.integer_parameter} type {message.param_type}: {value!r}")


def _round_trip(s: Subject) -> str:
    """Change a float, read it back in the answer and again."""
    name = s.dialect.float_parameter
    before = s.parameter(name)
    if before is None:
        raise CannotSee(f"{name} is not answered")
    with s.parameter_set(name, before + 0.5):
        kept = s.parameter(name) == before + 0.5
    back = s.parameter(name) == before
    return "kept, and put back" if kept and back else f"kept {kept}, put back {back}"


def _answers(s: Subject) -> int:
    """PARAM_VALUEs within 2 s of a PARAM_SET that changes something."""
    name = s.dialect.float_parameter
    before = s.parameter(name)
    if before is None:
        raise CannotSee(f"{name} is not answered")
    s.client.forget()
    with s.parameter_set(name, before + 0.5):
        s.client.collect(2.0)
        heard = [m for m in s.client.heard if m.get_type() == "PARAM_VALUE"]
    changed = [m for m in heard if m.param_id == name and m.param_value == before + 0.5]
    return len(changed)


def _index_in_answer(s: Subject) -> str:
    message = s.read_raw(s.dialect.float_parameter)
    if message is None:
        raise CannotSee("no answer")
    answer = s.write_raw(message.param_id, message.param_value, message.param_type)
    if answer is None:
        return "no answer"
    return "65535" if answer.param_index == 65535 else "its index"


def _index_in_read(s: Subject) -> str:
    message = _integer(s)
    return "65535" if message.param_index == 65535 else "its index"


def _wrong_type(s: Subject) -> str:
    """An integer parameter set as a float, to another value."""
    message = _integer(s)
    name = message.param_id
    before = s.from_wire(message.param_value, message.param_type)
    s.keep(message)
    answer = s.write_raw(name, before + 1.0, _FLOAT)
    after = s.parameter(name)
    s.restore()
    if after == before + 1.0:
        return "cast and stored"
    word = "refused" if after == before else f"stored as {after}"
    return f"{word}, {'answered' if answer is not None else 'not answered'}"


def _unknown_read(s: Subject) -> str:
    return _what_came(s, lambda: s.read_raw(_NOBODYS))


def _unknown_set(s: Subject) -> str:
    return _what_came(s, lambda: s.write_raw(_NOBODYS, 1.0, _FLOAT))


def _what_came(s: Subject, ask: Callable[[], Message | None]) -> str:
    s.client.forget()
    if ask() is not None:
        return "answered"
    names = {m.get_type() for m in s.client.heard}
    return "PARAM_ERROR" if "PARAM_ERROR" in names else "silence"


def _first_of_list(s: Subject) -> Finding:
    """The first PARAM_VALUE of PARAM_REQUEST_LIST; the rest is let pass."""
    s.client.send("PARAM_REQUEST_LIST")
    first = s.client.hear("PARAM_VALUE", 5.0)
    if first is None:
        raise CannotSee("PARAM_REQUEST_LIST is not answered")
    s.client.until(lambda: s.client.latest["PARAM_VALUE"].heard_s < s.client.t_s - 1.0, 120.0)
    heard = [m for m in s.client.heard if m.get_type() == "PARAM_VALUE"]
    names = {m.param_id for m in heard} - {"_HASH_CHECK"}
    word = "a checksum" if first.param_id == "_HASH_CHECK" else "the first parameter"
    return Finding(word, f"{len(names)} of {first.param_count} came")


BEHAVIOURS = (
    Behaviour("parameters/integer_encoding", "An integer parameter is sent as", _encoding),
    Behaviour("parameters/round_trip", "A float parameter that is set is", _round_trip),
    Behaviour("parameters/answers", "A change is answered by PARAM_VALUE so often", _answers),
    Behaviour("parameters/index_in_answer", "PARAM_SET's answer has param_index", _index_in_answer),
    Behaviour("parameters/index_in_read", "A read's answer has param_index", _index_in_read),
    Behaviour("parameters/wrong_type", "An integer parameter set as a float is", _wrong_type),
    Behaviour("parameters/unknown_read", "Reading an unknown parameter gives", _unknown_read),
    Behaviour("parameters/unknown_set", "Setting an unknown parameter gives", _unknown_set),
    Behaviour("parameters/list_begins", "A parameter list begins with", _first_of_list),
)
