"""Files, stores, recordings and messages of an earlier version are read and written as before.

The fixtures are as commit 3d417155 wrote them, by a script that only the history holds, and so
are `readings.json.gz`: the values that this version read in them. Names of modules and classes may
change; a key, a value, a table or a byte on the wire may not. A new optional key belongs in
`ADDED`."""

import gzip
import json
import re
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from companion.adapters.files import (
    params,
)
from companion.adapters.logs.decision_log import DecisionLog, read_mcap_rows
from companion.adapters.logs.tlog_writer import TlogFile
from companion.app.flight.recorder import Recorder
from companion.app.tools.export import ExportRequest, export_mission_or_track
from companion.core.base.wire_message import VERSION
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.ground_plan import plan_flight_without_vehicle
from companion.core.mission.actions import (
    AssessmentReport,
    Decision,
    EnergyReport,
    PhaseChanged,
    WindReport,
)
from companion.core.mission.events import AutopilotKind
from companion.core.pilot.ground.autopilot_settings import SettingChange
from companion.core.routing.leg_energy import RouteEnergy
from companion.fleet import messages as fleet
from companion.fleet.envelope import decode_envelope, encode_envelope, sign_message
from ground_station.adapters.store.database import Database
from ground_station.core.fleet.station_message import decode_station_wind, encode_station_wind
from sim_bridge.app.flight.own_record import flight_row_from_companion_result
from tests.house.kept_formats import (
    ADDED,
    MEMBER_KEY,
    READERS,
    ROOT,
    SHORT,
    WRITERS,
    WRITTEN,
    content,
    copied,
    named,
    plain,
    shape,
    store,
    unpacked,
)

ROUTE = "/foxglove_route"
PACKAGES = ("companion", "ground_station", "sim_bridge")
MOST_ROWS = 30
"""Rows read of each topic: enough to cover every key that a row may have."""

NO_FIXTURE = {
    "audit/1": "a domain of digests: the audit's rows are in the store",
    "calibration/1": "a report for people, with the airframe file that is kept",
    "certificate/1": "the name of a domain",
    "conformance/1": "tests/reference has three, which other tests read",
    "day-report/1": "a report for people, never read back",
    "leeway-signed/1": "a domain of signatures: the envelopes that are kept have them",
    "fleet-wind/1": "a study's result, never read back",
    "order/1": "an order for people and order systems, never read back",
    "monitor-study/1": "a study's result, never read back",
    "rates/1": "a study's result, never read back",
    "reference-estimator/1": "another estimator's state within one replay, never on a disk",
    "replay/1": "a report of a replay, never read back",
    "simulated-day/1": "a simulator's result",
    "windbench/1": "a study's result, never read back",
}


def differences(then: Any, now: Any, at: str = "") -> list[str]:
    """Return the paths at which two documents differ."""
    if isinstance(then, dict) and isinstance(now, dict):
        odd = [f"{at}.{key}: gone" for key in then.keys() - now.keys()]
        odd += [f"{at}.{key}: new" for key in now.keys() - then.keys() if key not in ADDED]
        both = [(then[key], now[key], f"{at}.{key}") for key in then.keys() & now.keys()]
        return odd + [words for one in both for words in differences(*one)]
    if isinstance(now, list):  # list of required keys of a schema
        now = [one for one in now if not (isinstance(one, str) and one in ADDED)]
    if isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        pairs = enumerate(zip(then, now, strict=True))
        return [words for n, (a, b) in pairs for words in differences(a, b, f"{at}[{n}]")]
    is_version = at.endswith(".v") and (then, now) == (1, VERSION)  # of a stored message
    return [] if then == now or is_version else [f"{at}: {then!r} is now {now!r}"]


READINGS = content(WRITTEN / "readings.json.gz")


@pytest.mark.parametrize(("pattern", "name"), named(READERS))
def test_it_is_read_as_before_and_written_with_the_same_keys(pattern, name, tmp_path):
    path = copied(name, tmp_path)
    found = READERS[pattern](path)
    assert differences(READINGS[name], plain(found)) == []
    if pattern in WRITERS:
        WRITERS[pattern](path, found)
        assert differences(content(WRITTEN / name), content(path)) == []


def test_every_kind_of_file_has_a_fixture():
    assert {pattern for pattern, _ in named(READERS)} == READERS.keys()
    assert {name for _, name in named(READERS)} == READINGS.keys()
    sources = [p.read_text() for top in PACKAGES for p in (ROOT / top).rglob("*.py")]
    formats = set(re.findall(r'"([a-z][a-z-]+/[0-9]+)"', "\n".join(sources)))
    files = [path.read_bytes() for path in WRITTEN.rglob("*") if path.is_file()]
    kept = b"".join(gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw for raw in files)
    as_kept = {name: (name.encode(), name.encode().hex().encode()) for name in formats}
    missing = {name for name, either in as_kept.items() if not any(one in kept for one in either)}
    assert missing == NO_FIXTURE.keys() & formats


def test_the_store_has_the_tables_of_a_new_one(tmp_path):
    database = Database(f"sqlite:///{tmp_path}/new.db")
    database.close()
    (tmp_path / "desk.db.gz").write_bytes(gzip.compress((tmp_path / "new.db").read_bytes()))
    assert differences(READINGS["desk.db.gz"][-1], plain(store(tmp_path / "desk.db.gz"))[-1]) == []


WIRE = content(WRITTEN / "wire.jsonl.gz")


@pytest.mark.parametrize("row", WIRE, ids=lambda row: row["kind"])
def test_messages_of_version_1_are_refused_and_differ_from_version_2_in_nothing_else(row):
    raw = row["raw"].encode()
    later = raw.replace(b'"v":1,', b'"v":2,', 1)
    if row["kind"] == "station":
        old = decode_station_wind(raw)
        assert encode_station_wind(decode_station_wind(later)) == later
    else:
        type_of_kind = {kind: type_ for type_, kind in fleet.KIND_OF_TYPE.items()}
        old = fleet.decode_message(type_of_kind[row["kind"]], raw)
        assert fleet.encode_message(fleet.decode_message(type_of_kind[row["kind"]], later)) == later
    assert old == fleet.Refused(f"{row['kind']}: version 1, expected 2")
    envelope = decode_envelope(row["kind"], bytes.fromhex(row["envelope"]))
    names = {"kind": row["kind"], "fleet": "harbour", "signer": "d1", "raw": raw}
    assert [envelope.signature, envelope.message] == [sign_message(MEMBER_KEY, **names), raw]
    assert encode_envelope("d1", envelope.signature, raw).hex() == row["envelope"]


OF_FOREIGN_FLIGHTS = {"energy_predicted_wh", "wind_std_mps", "findings", "reason", "settings"}


def channels(path: Path) -> tuple[Any, dict[str, set[str]]]:
    """Return the channels with their schemas, and the keys of the rows of each."""
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        schemas = {one.id: [one.name, json.loads(one.data)] for one in summary.schemas.values()}
        found = {
            c.topic: [c.message_encoding, *schemas[c.schema_id]] for c in summary.channels.values()
        }
        keys: dict[str, set[str]] = {}
        for _, channel, message in reader.iter_messages():
            keys.setdefault(channel.topic, set()).update(shape(json.loads(message.data)))
        about = {one.name: sorted(one.metadata) for one in reader.iter_metadata()}
    return [found, about], keys


def test_a_run_folder_is_continued_and_its_files_have_the_same_keys(tmp_path):
    """The recorder continues the rows of an interrupted flight with the same keys."""
    log, before = tmp_path / "decisions.mcap", content(WRITTEN / "flight/result.json.gz")
    log.write_bytes(gzip.decompress((WRITTEN / "flight/decisions.mcap.gz").read_bytes()))
    rows = [
        (topic, row) for topic, row in read_mcap_rows(log).rows if row.get("kind") != "finished"
    ]
    log.unlink()
    cut = DecisionLog(log, lambda: 0)
    for topic in {topic for topic, _ in rows}:
        for row in [row for other, row in rows if other == topic][:MOST_ROWS]:
            cut.write(topic, row)
    cut.close()
    recorder = Recorder(tmp_path, is_resumed=True, synchronous=True)
    for row in before["wind"][:1]:
        names = {"to_n_mps": "n_mps", "to_e_mps": "e_mps"}
        recorder.record_action(
            WindReport(**{names.get(key, key): row[key] for key in row}), row["t_s"]
        )
    kinds = (Decision, "decisions"), (AssessmentReport, "assessments"), (EnergyReport, "energy")
    later = dict.fromkeys(("p_home_stated", "required_p_home", "p_home_next", "p_home_onward"), 0.9)
    later |= {"p_success_onward": 0.9, "sites": ()}
    for kind, name in (*kinds, (PhaseChanged, "phases")):
        row = (later if kind is AssessmentReport else {}) | before[name][-1]
        recorder.record_action(kind(**row), row["t_s"])
    flight = params.read_flight(SHORT)
    plan = plan_flight_without_vehicle(flight, RouteEnergy(params.read_airframe("m100")), None)
    recorder.record_plan_if_new(1.0, plan, AutopilotKind.PX4)
    old = [
        SettingChange(s["name"], s["before"], s["set"], s["restored"]) for s in before["settings"]
    ]
    recorder.write_result_and_wait(delivered=True, flown=plan, phase="done", settings=old)
    recorder.close()
    now = content(tmp_path / "result.json")
    (then_row,) = content(WRITTEN / "flight/flights.json.gz")["flights"]
    assert shape(now) == shape(before)
    assert (
        flight_row_from_companion_result(now, vehicle="", autopilot="", run="").keys()
        - OF_FOREIGN_FLIGHTS
        - ADDED
        == then_row.keys()
    )
    assert shape(content(tmp_path / "mission.plan")) == shape(
        content(WRITTEN / "flight/mission.plan.gz")
    )
    then = channels(unpacked(copied("flight/decisions.mcap.gz", tmp_path)))
    again, more = channels(log), channels(tmp_path / "decisions-2.mcap")
    assert differences(then[0], again[0]) == [] == differences(then[0], more[0])
    assert again[1] | {ROUTE: more[1][ROUTE]} == then[1]
    assert all(keys <= then[1][topic] for topic, keys in more[1].items())


def test_frames_are_recorded_with_the_same_framing(tmp_path):
    """Eight bytes of time, and a MAVLink 2 frame: magic, length, flags (1: signed)."""
    raw = gzip.decompress((WRITTEN / "flight/stream.tlog.gz").read_bytes())
    at, now = 0, TlogFile(tmp_path / "now.tlog")
    for _ in range(50):
        assert raw[at + 8] == 0xFD
        size = 12 + raw[at + 9] + 13 * (raw[at + 10] & 1)
        now.write(raw[at + 8 : at + 8 + size], 0.0)
        at += 8 + size
    now.close()
    frames = (tmp_path / "now.tlog").read_bytes()
    assert [len(frames), frames[8:20]] == [at, raw[8:20]]


@pytest.mark.parametrize("file_format", ExportFormat)
def test_missions_are_exported_with_the_same_keys(file_format, tmp_path):
    done = export_mission_or_track(ExportRequest(SHORT.with_name("default.toml"), file_format))
    texts = {file_format.suffix: done.text, **done.companion_files}
    for ending, text in texts.items():
        now = tmp_path / f"mission{ending}"
        now.write_text(text)
        assert shape(content(now)) == shape(content(WRITTEN / "exports" / now.name))


@pytest.mark.parametrize("name", READINGS)
def test_a_renamed_key_or_another_value_is_noticed(name):
    then = json.dumps(READINGS[name])
    assert differences(READINGS[name], json.loads(then)) == []
    changed, n = re.subn(r'"(\w+)": ', r'"\1_": ', then, count=1)
    if n:
        assert shape(json.loads(changed)) != shape(READINGS[name])
    else:
        changed = re.sub(r"\b1", "7", then, count=1)
    assert differences(READINGS[name], json.loads(changed)) != []
