"""Files that a run reads and writes: checkpoint, decision log, stream; intact after any exit."""

import json
import os
import signal
import struct
import subprocess
import sys
from dataclasses import asdict, fields
from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader
from pymavlink import mavutil
from typer.testing import CliRunner

from companion.adapters.autopilots.codec import MavlinkCodec, mavlink
from companion.adapters.files.checkpoint_file import (
    CHECKPOINT_NAME,
    checkpoint_write_job,
    read_checkpoint,
)
from companion.adapters.files.params import (
    flight_configuration_digest,
    params_dir,
    read_airframe,
    read_flight,
    read_wind_process,
)
from companion.adapters.logs.decision_log import (
    SCHEMAS,
    DecisionLog,
    next_free_path,
    read_mcap_rows,
)
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.adapters.logs.tlog_writer import TlogFile
from companion.app.cli.main import app
from companion.app.flight.recorder import Recorder
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.mission.actions import Decision, Finished, SaveCheckpoint, WindReport
from companion.core.mission.checkpoint import Checkpoint, checkpoint_to_dict
from companion.core.mission.events import Attitude, AutopilotDetected, AutopilotKind
from companion.core.pilot.ground.autopilot_settings import SettingChange
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.return_budget.outcomes import SiteMargin
from companion.core.routing.route_planner import Plan, RallySite

ROOT = Path(__file__).parents[3]
PLAN = Plan(
    depot_ned_m=(0.0, 0.0, 0.0),
    customer_ned_m=(100.0, 0.0, -3.0),
    outbound_ned_m=((100.0, 0.0, -40.0),),
    return_ned_m=((0.0, 0.0, -40.0),),
    entry=(0,),
    rally=(RallySite("quay", (50.0, 50.0, 0.0), (0,), ()),),
    home_ground_speed_mps=9.0,
    energy_wh=20.0,
    time_s=100.0,
    route_std_wh=1.0,
)
KEPT = Checkpoint(
    flight="abc",
    t_s=120.5,
    phase="outbound",
    authority=True,
    authorised=True,
    flying=True,
    finished=False,
    delivered=False,
    gate_closed="",
    leg=1,
    took_off_s=30.0,
    plan=PLAN,
    frame=LocalFrame(0.968, 0.147, 12.0),
    rally=None,
    settings_before={"LOW_ACT": 0.0},
    judgement={"ledger": {"x": 1.0}},
)


# --- checkpoint ----------------------------------------------------------------------------------


def test_a_checkpoint_comes_back_as_it_went_and_after_a_write_that_dies_halfway(tmp_path):
    checkpoint_write_job(tmp_path, checkpoint_to_dict(KEPT))()
    assert read_checkpoint(tmp_path, "abc") == KEPT
    assert read_checkpoint(tmp_path / "nowhere", "abc") is None
    (tmp_path / f"{CHECKPOINT_NAME}.new").write_text('{"crc32": 1, "con')
    assert read_checkpoint(tmp_path, "abc") == KEPT


@pytest.mark.parametrize(
    ("changed", "flight", "words"),
    [
        *(
            (lambda text, share=share: text[: int(len(text) * share)], "abc", r"incomplete or")
            for share in (0.0, 0.1, 0.5, 0.9, 0.99)
        ),
        (lambda text: text.replace("120.5", "520.5"), "abc", "checksum"),
        (lambda text: text, "xyz", "another flight"),
    ],
)
def test_a_torn_changed_or_foreign_checkpoint_is_known_for_one(tmp_path, changed, flight, words):
    checkpoint_write_job(tmp_path, checkpoint_to_dict(KEPT))()
    path = tmp_path / CHECKPOINT_NAME
    path.write_text(changed(path.read_text()))
    with pytest.raises(LeewayError, match=rf"checkpoint\.json: .*{words}"):
        read_checkpoint(tmp_path, flight)


# --- decision log and result ---------------------------------------------------------------------

DECISION = Decision(
    12.5, "go", "gate open", 0.99, 0.9, 0.995, 0.9, 14.0, 0.97, 0.99, 0.99, 0.9,
    (SiteMargin("depot", 0.995, 20.0, 14.0),),
)  # fmt: skip


def test_the_decision_log_opens_with_the_librarys_own_reader_and_fits_its_schemas(tmp_path):
    path = tmp_path / "decisions.mcap"
    log = DecisionLog(path, lambda: 1_800_000_000_000_000)
    row = asdict(Decision(1.5, "go", "open", margin_wh=3.0)) | {"sites": []}
    log.write("decision", row)
    energy = {"t_s": 2.0, "left_wh": 80.0, "std_wh": 2.0, "source": "current", "used_wh": 9.0}
    log.write("energy", energy)
    log.close()
    with path.open("rb") as file:
        found = [
            (channel.topic, json.loads(message.data), message.log_time, json.loads(schema.data))
            for schema, channel, message in make_reader(file).iter_messages()
            if schema is not None and schema.name.startswith("leeway.")
        ]
    assert [(topic, data) for topic, data, _, _ in found] == [
        ("/decision", row),
        ("/energy", energy),
    ]
    assert [stamp_ns for _, _, stamp_ns, _ in found] == [18 * 10**17, 18 * 10**17 + 500_000_000]
    for topic, data, _, schema in found:
        assert set(schema["required"]) == data.keys() == SCHEMAS[topic[1:]].keys()


def test_after_kill_9_every_decision_that_was_made_is_in_the_log(tmp_path):
    path = tmp_path / "decisions.mcap"
    code = (
        "import sys, os, signal; from pathlib import Path\n"
        "from companion.adapters.logs.decision_log import DecisionLog\n"
        "log = DecisionLog(Path(sys.argv[1]))\n"
        "for k in range(25):\n"
        "    log.write('said', {'t_s': float(k), 'severity': 4, 'text': 'x' * k})\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code, str(path)], cwd=ROOT, check=False)
    assert ended.returncode == -signal.SIGKILL
    rows = [row for topic, row in read_mcap_rows(path).rows if topic == "said"]
    assert [row["t_s"] for row in rows] == [float(k) for k in range(25)]


@pytest.mark.parametrize("cut", [1, 7, 60, 150])
def test_a_log_cut_anywhere_gives_what_was_whole(tmp_path, cut):
    path = tmp_path / "decisions.mcap"
    log = DecisionLog(path)
    for k in range(10):
        log.write("heard_throttle", {"t_s": float(k), "throttle_frac": 0.5})
    written = path.read_bytes()
    log.close()
    path.write_bytes(written[:-cut])
    rows = [row["t_s"] for _, row in read_mcap_rows(path).rows]
    assert rows == [float(k) for k in range(len(rows))]
    assert 7 <= len(rows) < 10


def test_a_run_that_goes_on_after_a_kill_keeps_the_rows_of_the_one_before(tmp_path):
    first = Recorder(tmp_path)
    first.record_action(DECISION, 12.5)
    first.record_action(WindReport(13.0, 1.0, 2.0, 0.1, 0.0, 0.1), 13.0)
    first.wait_until_stored()  # killed here: no result was written
    second = Recorder(tmp_path, is_resumed=True)
    second.record_action(Decision(40.0, "recognised", "our mission"), 40.0)
    second.record_action(Finished("SUC", True, "home"), 50.0)
    changed = SettingChange("LOW_ACT", 0.0, 3.0, restored=True)
    second.write_result_and_wait(delivered=True, flown=None, phase="done", settings=[changed])
    second.close()
    first.close()
    result = json.loads((tmp_path / "result.json").read_text())
    assert [d["kind"] for d in result["decisions"]] == ["go", "recognised"]
    wind = {"to_n_mps": 1.0, "to_e_mps": 2.0, "nn_m2ps2": 0.1, "ne_m2ps2": 0.0, "ee_m2ps2": 0.1}
    assert result["wind"] == [{"t_s": 13.0, **wind}]
    assert (result["outcome"], result["delivered"]) == ("SUC", True)
    told = {"name": "LOW_ACT", "before": 0.0, "set": 3.0, "restored": True}
    assert result["settings"] == [told]
    (site,) = result["decisions"][0]["sites"]
    assert (site["landing"], site["margin_now_wh"]) == ("depot", 20.0)
    assert {each.name for each in fields(Decision)} == set(result["decisions"][0])
    assert next_free_path(tmp_path / "decisions.mcap").name == "decisions-3.mcap"


def test_the_recorder_puts_checkpoints_on_disk(tmp_path):
    recorder = Recorder(tmp_path)
    recorder.record_action(SaveCheckpoint(checkpoint_to_dict(KEPT)), 1.0)
    recorder.close()
    assert read_checkpoint(tmp_path, "abc") == KEPT
    assert "gate" not in (tmp_path / "companion.log").read_text()


def test_the_stream_opens_in_pymavlinks_log_reader(tmp_path):
    path = tmp_path / "stream.tlog"
    tlog = TlogFile(path)
    codec = MavlinkCodec(datagrams=True)
    for k in range(3):
        message = mavlink.MAVLink_named_value_float_message(1000 * k, b"LW_PHOME", 0.5 + k)
        tlog.write(codec.pack(message), float(k))
    tlog.close()
    log = mavutil.mavlink_connection(str(path))
    heard, times_s = [], []
    for _ in range(3):
        heard.append(log.recv_match())
        times_s.append(log.timestamp)
    log.close()
    assert [m.value for m in heard] == pytest.approx([0.5, 1.5, 2.5])
    assert times_s[2] - times_s[0] == pytest.approx(2.0, abs=1e-3)
    (stamp,) = struct.unpack_from(">Q", path.read_bytes())
    assert stamp > 1.6e15, "microseconds since 1970"


# --- disk failures ---------------------------------------------------------------------------


@pytest.mark.parametrize("opcode", [1, 5, 15, 200])
def test_garbage_that_begins_like_a_record_is_not_taken_for_a_log_that_was_cut_off(
    tmp_path, opcode
):
    path = tmp_path / "decisions.mcap"
    log = DecisionLog(path, unix_clock_us=lambda: 0)
    log.write("said", {"t_s": 1.0, "text": "one", "severity": 6})
    whole = path.read_bytes()  # as a killed companion leaves it
    log.close()
    path.write_bytes(whole + bytes([opcode]) + b"\xd3" * 500)
    assert read_mcap_rows(path).error_text is not None
    path.write_bytes(whole + struct.pack("<BQ", 5, 800) + b"x" * 500)
    assert read_mcap_rows(path).error_text is None, "cut off in the middle of a record"


def test_a_torn_decision_log_is_moved_aside_and_what_was_whole_in_it_is_kept(tmp_path):
    first = Recorder(tmp_path)
    for k in range(20):
        first.record_action(Decision(float(k), "go", "gate open"), float(k))
    first.close()
    path = tmp_path / "decisions.mcap"
    raw = bytearray(path.read_bytes())
    row = raw.index(b'{"t_s": 9.0')
    raw[row : row + 4] = b"\xff\xfe\x00{"
    path.write_bytes(raw)
    second = Recorder(tmp_path, is_resumed=True)
    second.record_action(Decision(40.0, "recognised", "our mission"), 40.0)
    second.write_result_and_wait(delivered=False, flown=None, phase="outbound")
    second.close()
    kinds = [d["kind"] for d in json.loads((tmp_path / "result.json").read_text())["decisions"]]
    assert kinds[-1] == "recognised"
    assert kinds.count("go") == 19
    assert (tmp_path / "decisions.mcap.torn-1").read_bytes() == raw
    assert [row["kind"] for _, row in read_mcap_rows(path).rows] == ["recognised"]
    assert "moved aside" in str(second.take_next_error_text())


@pytest.mark.parametrize("at_once", [True, False])
def test_in_a_folder_that_cannot_be_written_records_are_given_up_and_it_is_told(
    tmp_path, at_once, capsys
):
    (tmp_path / "file").write_text("no folder")
    recorder = Recorder(tmp_path / "file" / "run", synchronous=at_once)
    recorder.record_action(DECISION, 12.5)
    recorder.record_action(SaveCheckpoint(checkpoint_to_dict(KEPT)), 1.0)
    recorder.buffer_frame(b"frame", 1.0)
    recorder.write_result_and_wait(delivered=True, flown=None, phase="done")
    recorder.close()
    assert "companion.log: Not a directory" in str(recorder.take_next_error_text())
    assert "recording stopped: companion.log: Not a directory" in capsys.readouterr().err


# --- files ---------------------------------------------------------------------------------------


def test_an_explicit_params_folder_counts_and_must_exist(tmp_path):
    assert params_dir(tmp_path) == tmp_path
    with pytest.raises(LeewayError, match="no such params folder"):
        params_dir(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("[mission]\nmax_los = 0.1\n", "max_los"),
        ("[mission]\nmax_loss = 0.9\n", "mission.max_loss"),
        ("nonsense", "flight.toml"),
    ],
)
def test_a_mistake_in_a_flight_file_names_file_and_key(tmp_path, change, words):
    path = tmp_path / "flight.toml"
    path.write_text(
        'format = "flight/1"\nsite = { customer = { east_m = 1.0, north_m = 2.0 } }\n'
        'vehicle = { airframe = "m100" }\n' + change
    )
    with pytest.raises(LeewayError, match=words) as found:
        read_flight(path)
    assert "flight.toml" in str(found.value)
    assert "\n" not in str(found.value)


def test_a_digest_tells_flights_and_airframes_apart(tmp_path):
    one, two = tmp_path / "one.toml", tmp_path / "two.toml"
    one.write_text("a")
    two.write_text("b")
    m100, octo = read_airframe("m100"), read_airframe("octo8")
    coast = read_wind_process("coast")
    calmer = msgspec.structs.replace(coast, variance_m2ps2=(0.1, 0.1, 0.1))
    digests = {
        flight_configuration_digest(one, m100, coast),
        flight_configuration_digest(two, m100, coast),
        flight_configuration_digest(one, octo, coast),
        flight_configuration_digest(one, m100, calmer),
    }
    assert len(digests) == 4


# --- command line --------------------------------------------------------------------------------

runner = CliRunner()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--link", "nonsense"], "expected udpin"),
        (["--link", "udpin:127.0.0.1:0"], "port 0"),
        (["--airframe", "zeppelin"], "no such airframe"),
        (["--mission", "/nowhere/flight.toml"], "No such file"),
        (["--signing-key", "/nowhere/key"], "No such file"),
    ],
)
def test_a_mistake_on_the_command_line_is_one_line_and_exit_code_2(tmp_path, arguments, words):
    usual = {
        "--link": "udpout:127.0.0.1:9",
        "--mission": str(ROOT / "params/flights/default.toml"),
        "--run-dir": str(tmp_path),
    }
    given = dict(zip(arguments[::2], arguments[1::2], strict=True))
    line = [part for pair in (usual | given).items() for part in pair]
    result = runner.invoke(app, ["run", *line])
    assert result.exit_code == 2
    assert words in result.output
    assert len(result.output.strip().splitlines()) == 1


def test_without_an_autopilot_it_gives_up_with_exit_code_4(tmp_path):
    mission = str(ROOT / "params/flights/default.toml")
    result = runner.invoke(
        app,
        ["run", "--link", "udpout:127.0.0.1:9", "--mission", mission, "--run-dir", str(tmp_path),
         "--silence-limit", "0.3"],
    )  # fmt: skip
    assert result.exit_code == 4
    result_file = json.loads((tmp_path / "result.json").read_text())
    assert result_file["phase"] == "identify"


OF_OTHERS = ("matplotlib", "filterpy", "pandas", "pyulog", "networkx", "scipy.optimize")


@pytest.mark.sample
@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("companion.app.cli.main, companion.app.cli.flying", ("torch", "sqlalchemy", *OF_OTHERS)),
        ("sim_bridge.main", ("numba", "sqlalchemy", "torch")),
    ],
)
def test_no_plotting_training_oracle_or_desk_library_is_loaded_to_fly_or_to_start(modules, heavy):
    heavy = ("zenoh", *heavy)
    code = f"import sys; import {modules}; print([m for m in {heavy} if m in sys.modules])"
    seen = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert seen.stdout.strip() == "[]"


def test_whose_autopilot_it_was_is_read_back_from_the_decision_log(tmp_path):
    recorder, now = Recorder(tmp_path), TelemetryState()
    now.store_event(AutopilotDetected(3.0, AutopilotKind.PX4, 7))
    now.store_event(Attitude(3.0, 0.01, 0.02, 0.03))
    recorder.record_new_telemetry(now, 7)
    recorder.close()
    log = read_log_of_any_format(tmp_path / "decisions.mcap")
    assert log.autopilot_kind is AutopilotKind.PX4
    assert not log.findings
    rows = [
        row for topic, row in read_mcap_rows(tmp_path / "decisions.mcap").rows if "auto" in topic
    ]
    assert rows == [{"t_s": 3.0, "flavour": "px4", "system_id": 7}]


@pytest.mark.sample
def test_a_signal_ends_a_run_in_order_with_exit_code_5(tmp_path):
    command = [
        sys.executable, "-c", "from companion.app.cli.main import main; main()", "run",
        "--link", "udpout:127.0.0.1:9", "--mission", "params/flights/default.toml",
        "--run-dir", str(tmp_path),
    ]  # fmt: skip
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    log = tmp_path / "companion.log"
    for _ in range(400):
        if log.exists() and "mission" in log.read_text():
            break
        try:
            process.wait(0.05)
        except subprocess.TimeoutExpired:
            continue
        break
    os.kill(process.pid, signal.SIGTERM)
    process.communicate(timeout=20)
    assert process.returncode == 5
    assert json.loads((tmp_path / "result.json").read_text())["outcome"] is None
    assert list(read_mcap_rows(tmp_path / "decisions.mcap").rows) is not None
    assert "signal" in log.read_text()


def test_the_kept_state_is_strict():
    table = msgspec.to_builtins(KEPT) | {"surprise": 1}
    with pytest.raises(msgspec.ValidationError, match="surprise"):
        msgspec.convert(table, Checkpoint)


@pytest.mark.parametrize(("function", "is_guarded"), [("print_line_if_possible", True),
                                                      ("_print_nonempty_line", False)])  # fmt: skip
def test_a_full_disk_behind_the_output_changes_no_exit_code(function, is_guarded):
    code = f"from companion.app.cli import flying; flying.{function}('settings NOT restored')"
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", code], stdout=full, stderr=full, check=False)
    assert (done.returncode == 0) is is_guarded
