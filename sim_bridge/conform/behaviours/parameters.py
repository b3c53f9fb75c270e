"""Parameters on the wire."""

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviours, Observation
from sim_bridge.conform.client import NO_RESPONSE, Message
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.subject import Subject

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_UNKNOWN_PARAMETER = "XYZ_NOT_THERE"
_FLOAT = mavlink.MAV_PARAM_TYPE_REAL32


def _read_or_raise(subject: Subject, name: str) -> Message:
    message = subject.parameters.read_message(name)
    if message is None:
        raise ObservationError(f"{name} is not answered")
    return message


@behaviour("parameters/integer_encoding", "An integer parameter is sent as")
def _classify_integer_encoding(subject: Subject) -> Observation:
    """A whole number is a C cast; its bytes in a float are a number of nearly nothing."""
    message = _read_or_raise(subject, subject.dialect.integer_parameter)
    value = message.param_value
    word = "integer bits in the float" if 0.0 < abs(value) < 1e-30 else "C cast"
    return Observation(word, f"{message.param_id} type {message.param_type}: {value!r}")


@behaviour("parameters/round_trip", "A float parameter that is set is")
def _observe_float_round_trip(subject: Subject) -> str:
    """Change a float; read it back from the response and by a second request."""
    name = subject.dialect.float_parameter
    before = _read_or_raise(subject, name).param_value
    with subject.parameters.temporarily_set(name, before + 0.5):
        kept = subject.parameters.read(name) == before + 0.5
    back = subject.parameters.read(name) == before
    return "kept, and put back" if kept and back else f"kept {kept}, put back {back}"


@behaviour("parameters/answers", "A change is answered by PARAM_VALUE so often")
def _count_param_values_after_change(subject: Subject) -> int:
    """PARAM_VALUEs within 2 s of a PARAM_SET that changes something."""
    name = subject.dialect.float_parameter
    before = _read_or_raise(subject, name).param_value
    subject.client.clear_received()
    with subject.parameters.temporarily_set(name, before + 0.5):
        subject.client.collect_messages(2.0)
        param_values = subject.client.received_messages("PARAM_VALUE")
    changed = [m for m in param_values if m.param_id == name and m.param_value == before + 0.5]
    return len(changed)


@behaviour("parameters/index_in_answer", "PARAM_SET's answer has param_index")
def _param_index_in_set_response(subject: Subject) -> str:
    message = _read_or_raise(subject, subject.dialect.float_parameter)
    response = subject.parameters.write_message(
        message.param_id, message.param_value, message.param_type
    )
    if response is None:
        return NO_RESPONSE
    return "65535" if response.param_index == 65535 else "its index"


@behaviour("parameters/index_in_read", "A read's answer has param_index")
def _param_index_in_read_response(subject: Subject) -> str:
    message = _read_or_raise(subject, subject.dialect.integer_parameter)
    return "65535" if message.param_index == 65535 else "its index"


@behaviour("parameters/wrong_type", "An integer parameter set as a float is")
def _observe_set_with_wrong_type(subject: Subject) -> str:
    """An integer parameter set as a float, to another value."""
    message = _read_or_raise(subject, subject.dialect.integer_parameter)
    name = message.param_id
    before = subject.parameters.decoded_value(message)
    subject.parameters.record_original(message)
    response = subject.parameters.write_message(name, before + 1.0, _FLOAT)
    after = subject.parameters.read(name)
    subject.parameters.restore()
    if after == before + 1.0:
        return "cast and stored"
    word = "refused" if after == before else f"stored as {after}"
    return f"{word}, {'answered' if response is not None else 'not answered'}"


@behaviour("parameters/unknown_read", "Reading an unknown parameter gives")
def _response_to_unknown_read(subject: Subject) -> str:
    return _classify_response(subject, lambda: subject.parameters.read_message(_UNKNOWN_PARAMETER))


@behaviour("parameters/unknown_set", "Setting an unknown parameter gives")
def _response_to_unknown_set(subject: Subject) -> str:
    return _classify_response(
        subject, lambda: subject.parameters.write_message(_UNKNOWN_PARAMETER, 1.0, _FLOAT)
    )


def _classify_response(subject: Subject, send_request: Callable[[], Message | None]) -> str:
    subject.client.clear_received()
    if send_request() is not None:
        return "answered"
    names = {m.get_type() for m in subject.client.received}
    return "PARAM_ERROR" if "PARAM_ERROR" in names else "silence"


@behaviour("parameters/list_begins", "A parameter list begins with")
def _observe_first_of_parameter_list(subject: Subject) -> Observation:
    """The first PARAM_VALUE of PARAM_REQUEST_LIST; the rest is let pass."""
    subject.client.send("PARAM_REQUEST_LIST")
    first = subject.client.wait_next_message("PARAM_VALUE", 5.0)
    if first is None:
        raise ObservationError("PARAM_REQUEST_LIST is not answered")
    subject.client.wait_until(
        lambda: subject.client.latest["PARAM_VALUE"].heard_s < subject.client.t_s - 1.0, 120.0
    )
    param_values = subject.client.received_messages("PARAM_VALUE")
    names = {m.param_id for m in param_values} - {"_HASH_CHECK"}
    word = "a checksum" if first.param_id == "_HASH_CHECK" else "the first parameter"
    return Observation(word, f"{len(names)} of {first.param_count} came")
