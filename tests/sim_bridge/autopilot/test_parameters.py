"""Parameters on the wire: C-cast floats for ArduPilot, integer bytes in the float for PX4."""

import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mavlink.parameters import (
    Parameter,
    ParameterError,
    ParameterStore,
    read_parameters,
)

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
BOTH = pytest.mark.parametrize("autopilot", [AP, PX4])
FOLDER = Path(__file__).resolve().parents[3] / "params" / "autopilots"
INT8, INT16, INT32, REAL32 = 2, 4, 6, 9


@BOTH
def test_every_shipped_file_loads(autopilot):
    parameters = read_parameters(FOLDER / f"{autopilot.value}.toml")
    assert 60 <= len(parameters) <= 150
    assert all(len(name) <= 16 for name in parameters)


@pytest.mark.parametrize(
    ("autopilot", "name", "default"),
    [  # published defaults (ardupilot.org parameter list; PX4 parameter reference)
        (AP, "RTL_ALT", 1500),
        (AP, "WPNAV_SPEED", 1000),
        (AP, "FS_THR_ENABLE", 1),
        (AP, "BATT_FS_LOW_ACT", 0),
        (AP, "SYSID_MYGCS", 255),
        (PX4, "RTL_RETURN_ALT", 60),
        (PX4, "MPC_XY_CRUISE", 5),
        (PX4, "COM_OF_LOSS_T", 1),
        (PX4, "COM_LOW_BAT_ACT", 0),
        (PX4, "NAV_ACC_RAD", 10),
    ],
)
def test_defaults_are_the_published_ones(autopilot, name, default):
    assert read_parameters(FOLDER / f"{autopilot.value}.toml")[name].value == default


def test_a_setting_that_does_not_exist_is_refused_by_name():
    with pytest.raises(ParameterError, match="RTL_HIGHT"):
        read_parameters(FOLDER / "px4.toml", {"RTL_HIGHT": 3.0})


def test_a_broken_file_is_refused_by_the_place(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text(
        'format = "autopilot-parameters/1"\n[parameters]\nA = { type = "int64", default = 1 }\n'
    )
    with pytest.raises(ParameterError, match=r"parameters\.A\.type"):
        read_parameters(path)


def values(rig):
    return {m.param_id: m for m in rig.all("PARAM_VALUE")}


@BOTH
def test_a_list_gives_every_parameter_once_with_its_index(make_rig, autopilot):
    rig = make_rig(autopilot)
    rig.step(0.2)
    rig.forget()
    rig.send("PARAM_REQUEST_LIST")
    rig.step(1.0)
    heard = rig.all("PARAM_VALUE")
    count = heard[-1].param_count
    indices = [m.param_index for m in heard if m.param_id != "_HASH_CHECK"]
    assert indices == list(range(count))
    assert ("_HASH_CHECK" in values(rig)) is (autopilot is PX4)


def test_px4_sends_a_changed_value_twice_and_an_unchanged_one_once(make_rig):
    # flown on PX4 1.18: one or two PARAM_VALUEs; mavlink_parameters.cpp: twice while it is unsaved
    rig = make_rig(PX4)
    rig.step(0.2)
    for value, answers in ((7.5, 2), (7.5, 1), (6.0, 2)):
        rig.forget()
        rig.send("PARAM_SET", param_id="MPC_XY_CRUISE", param_value=value, param_type=REAL32)
        rig.step(1.0)
        heard = [m.param_value for m in rig.all("PARAM_VALUE")]
        assert heard == [value] * answers


@given(st.integers(-(2**31), 2**31 - 1))
def test_any_px4_integer_survives_the_trip(value):
    # NaN payloads included, but for signalling NaNs, which a float register quietens
    bits = value & 0xFFFFFFFF
    signalling = bits & 0x7F800000 == 0x7F800000 and bits & 0x7FFFFF and not bits & 0x400000
    store = ParameterStore(PX4, {"X": Parameter("X", "int32", 0.0)})
    as_float = struct.unpack("<f", struct.pack("<i", value))[0]
    assert store.store_wire_value_if_accepted("X", as_float, INT32)
    if not signalling:
        assert store["X"] == value
        assert struct.pack("<f", store.wire_value_and_type("X")[0]) == struct.pack("<i", value)


def test_px4_answers_what_it_cannot_do_with_param_error(make_rig):
    rig = make_rig(PX4)
    rig.step(0.2)
    rig.gcs_heartbeat()
    rig.send("PARAM_SET", param_id="RTL_RETURN_ALT", param_value=20.0, param_type=INT32)
    assert rig.last("PARAM_ERROR").error == 7  # MAV_PARAM_ERROR_TYPE_MISMATCH
    assert not rig.all("PARAM_VALUE")
    rig.send("PARAM_REQUEST_READ", param_id="RTL_RETURN_ALT", param_index=-1)
    assert rig.last("PARAM_VALUE").param_value == 60.0
    rig.send("PARAM_REQUEST_READ", param_id="XYZ", param_index=-1)
    assert rig.last("PARAM_ERROR").error == 1  # MAV_PARAM_ERROR_DOES_NOT_EXIST
    assert any("types mismatch" in text for text in rig.texts())
    rig.send("PARAM_SET", param_id="RTL_RETURN_ALT", param_value=20.0, param_type=REAL32)
    assert rig.last("PARAM_VALUE").param_value == 20.0


def test_ardupilot_takes_any_type_and_clamps_to_what_storage_holds(make_rig):
    rig = make_rig(AP)
    rig.step(0.2)
    rig.send("PARAM_SET", param_id="FS_GCS_ENABLE", param_value=500.0, param_type=REAL32)
    assert rig.last("PARAM_VALUE").param_value == 127.0
    rig.send("PARAM_SET", param_id="RTL_ALT", param_value=2000.4, param_type=REAL32)
    assert rig.last("PARAM_VALUE").param_value == 2000.0


@BOTH
def test_what_is_no_number_or_no_parameter_changes_nothing(make_rig, autopilot):
    rig = make_rig(autopilot)
    rig.step(0.2)
    before = rig.ap.params.checksum()
    name = "WPNAV_SPEED" if autopilot is AP else "MPC_XY_CRUISE"
    rig.send("PARAM_SET", param_id=name, param_value=float("nan"), param_type=REAL32)
    rig.send("PARAM_SET", param_id="NO_SUCH_THING", param_value=1.0, param_type=REAL32)
    rig.send("PARAM_REQUEST_READ", param_id="NO_SUCH_THING", param_index=-1)
    rig.send("PARAM_REQUEST_READ", param_id="PD_GRIPPER_EN", param_index=-1)  # removed in PX4 1.18
    rig.send("PARAM_REQUEST_READ", param_id="", param_index=9999)
    assert rig.ap.params.checksum() == before
    assert not {"NO_SUCH_THING", "PD_GRIPPER_EN"} & values(rig).keys()


def test_a_changed_parameter_takes_effect_in_flight(airborne):
    rig = airborne(PX4)
    rig.upload([rig.place(16, 200, 0, 20), rig.place(16, 300, 0, 20)])
    rig.command(176, 1, 4, 4)
    rig.step(6.0)
    assert rig.speed_mps == pytest.approx(5.0, abs=0.6)
    rig.send("PARAM_SET", param_id="MPC_XY_CRUISE", param_value=8.0, param_type=REAL32)
    rig.step(5.0)
    assert rig.speed_mps == pytest.approx(8.0, abs=0.8)
