"""The decision log in Foxglove's schemas, decoded by its own message classes."""

import json
from datetime import UTC, datetime

import pytest
from mcap.reader import make_reader

from companion.adapters.logs.decision_log import (
    METADATA,
    UTC_AT_ZERO,
    DecisionLog,
    read_mcap_rows,
)
from companion.adapters.logs.foxglove_rows import FOXGLOVE

json_format = pytest.importorskip("google.protobuf.json_format", reason="protobuf not installed")
schemas = pytest.importorskip("foxglove_schemas_protobuf", reason="Foxglove's schemas")

from foxglove_schemas_protobuf.GeoJSON_pb2 import GeoJSON  # noqa: E402
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix  # noqa: E402
from foxglove_schemas_protobuf.Log_pb2 import Log  # noqa: E402

TYPES = {
    "foxglove.LocationFix": LocationFix,
    "foxglove.Log": Log,
    "foxglove.GeoJSON": GeoJSON,
}

START_US = 1_900_000_000_250_000
FIX = {"t_s": 101.5, "lat_deg": 55.47, "lon_deg": 8.45, "alt_amsl_m": 52.0,
       "height_rel_m": 40.0, "vel_n_mps": 3.0, "vel_e_mps": -2.0, "vel_d_mps": 0.0}  # fmt: skip
DECISION = {"t_s": 102.0, "kind": "go", "reason": "gate open", "p_home": 0.99,
            "p_home_now": 0.99, "p_success": 0.9, "margin_wh": 14.0}  # fmt: skip


@pytest.fixture
def log_path(tmp_path):
    path = tmp_path / "decisions.mcap"
    log = DecisionLog(path, lambda: START_US)
    log.write("said", {"t_s": 100.0, "severity": 4, "text": "wind rises"})
    log.write("heard_position", FIX)
    log.write("decision", DECISION)
    log.write("phase", {"t_s": 103.0, "before": "settle", "now": "outbound", "why": "go"})
    log.close()
    return path


def foxglove_messages(path):
    """Return (log time in ns, decoded message) of each message in one of Foxglove's schemas."""
    with path.open("rb") as file:
        for schema, _, message in make_reader(file).iter_messages():
            if schema is not None and schema.name.startswith("foxglove."):
                row = json.loads(message.data)
                stamp = row.pop("timestamp", {"sec": 0, "nsec": 0})
                # Times are two integers in Foxglove's JSON and RFC 3339 in protobuf.
                decoded = json_format.ParseDict(row, TYPES[schema.name]())
                if "timestamp" in TYPES[schema.name].DESCRIPTOR.fields_by_name:
                    decoded.timestamp.seconds, decoded.timestamp.nanos = stamp["sec"], stamp["nsec"]
                yield message.log_time, decoded


def test_positions_and_words_decode_into_foxgloves_own_messages(log_path):
    found = [message for _, message in foxglove_messages(log_path)]
    fixes = [m for m in found if isinstance(m, LocationFix)]
    assert [(m.latitude, m.longitude, m.altitude) for m in fixes] == [(55.47, 8.45, 52.0)]
    assert len(fixes[0].position_covariance) == 9
    assert fixes[0].position_covariance_type == LocationFix.UNKNOWN
    said = [(m.level, m.name, m.message) for m in found if isinstance(m, Log)]
    assert said == [
        (Log.WARNING, "operator", "wind rises"),
        (Log.INFO, "decision", "go: gate open"),
        (Log.DEBUG, "phase", "settle -> outbound (go)"),
    ]


def test_the_route_is_a_geojson_document_for_the_map(tmp_path):
    document = {"type": "FeatureCollection", "features": []}
    log = DecisionLog(tmp_path / "decisions.mcap", lambda: START_US)
    log.write_route_geojson(100.0, document)
    log.close()
    ((stamp_ns, message),) = foxglove_messages(tmp_path / "decisions.mcap")
    assert isinstance(message, GeoJSON)
    assert json.loads(message.geojson) == document
    assert stamp_ns == START_US * 1000


def test_every_field_of_our_foxglove_schemas_is_one_of_foxgloves():
    for name, fields in FOXGLOVE.values():
        theirs = {field.name for field in TYPES[name].DESCRIPTOR.fields}
        assert set(fields) <= theirs


def test_stamps_are_utc_and_keep_the_seconds_between_messages(log_path):
    stamps_ns = [stamp for stamp, _ in foxglove_messages(log_path)]
    assert stamps_ns == [START_US * 1000 + ns for ns in (0, 1_500_000_000, 2 * 10**9, 3 * 10**9)]
    for stamp_ns, message in foxglove_messages(log_path):
        assert message.timestamp.ToNanoseconds() == stamp_ns


def test_the_wall_clock_is_the_source_of_the_stamps(tmp_path):
    path = tmp_path / "decisions.mcap"
    before = datetime.now(UTC).timestamp()
    log = DecisionLog(path)
    log.write("heard_position", FIX)
    log.close()
    ((stamp_ns, _),) = foxglove_messages(path)
    assert before <= stamp_ns / 1e9 <= datetime.now(UTC).timestamp()


def test_the_metadata_says_when_the_autopilots_clock_was_at_zero(log_path):
    with log_path.open("rb") as file:
        (metadata,) = make_reader(file).iter_metadata()
    assert metadata.name == METADATA
    utc_s = int(metadata.metadata[UTC_AT_ZERO]) / 1e9
    assert utc_s == pytest.approx(START_US / 1e6 - 100.0, abs=1e-6)
    assert read_mcap_rows(log_path).utc_at_zero_s == utc_s


def test_our_own_readers_get_our_rows_and_none_of_foxgloves(log_path):
    rows = list(read_mcap_rows(log_path).rows)
    assert [topic for topic, _ in rows] == ["said", "heard_position", "decision", "phase"]
    assert dict(rows)["heard_position"] == FIX
