"""Exported tracks, opened by the readers of the target tools."""

import json
from datetime import UTC, datetime, timedelta
from io import BytesIO
from pathlib import Path

import gpxpy
import pytest
from fastkml import KML
from fastkml.gx import Track

from companion.adapters.logs.decision_log import DecisionLog
from companion.app.tools.export import ExportRequest, export_mission_or_track
from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import TrackExport
from companion.core.exports.flown_track import build_track_export
from companion.core.exports.formats import track_document_text
from companion.core.mission.events import GnssTime, Position

START = datetime(2026, 5, 4, 6, 30, 0, 250_000, UTC)


def position(t_s: float) -> Position:
    return Position(t_s, 55.47 + 1e-5 * t_s, 8.45, 52.0 + t_s, 40.0 + t_s, 1.0, 0.0, 0.0)


@pytest.fixture
def run_folder(tmp_path) -> Path:
    folder = tmp_path / "harbour-px4-seed1"
    folder.mkdir()
    log = DecisionLog(folder / "decisions.mcap", lambda: int(START.timestamp() * 1e6))
    for k in range(31):
        at = position(100.0 + k / 10.0)
        row = {name: getattr(at, name) for name in Position.__dataclass_fields__}
        log.write("heard_position", row)
    log.close()
    return folder


def exported(what: Path, file_format: ExportFormat) -> str:
    return export_mission_or_track(ExportRequest(what, file_format)).text


def test_gpxpy_reads_a_run_folders_track_a_point_a_second_in_utc(run_folder):
    (track,) = gpxpy.parse(exported(run_folder, ExportFormat.GPX)).tracks
    assert track.name == "harbour-px4-seed1"
    points = track.segments[0].points
    assert [point.time - START for point in points] == [timedelta(seconds=k) for k in range(4)]
    assert [point.elevation for point in points] == [152.0, 153.0, 154.0, 155.0]
    assert points[1].latitude == pytest.approx(55.47 + 1e-5 * 101.0, abs=1e-7)


def test_fastkml_reads_the_track_with_its_times(run_folder):
    (document,) = KML.parse(BytesIO(exported(run_folder, ExportFormat.KML).encode())).features
    (mark,) = document.features
    track = mark.kml_geometry
    assert isinstance(track, Track)
    whens = [item.when.dt for item in track.track_items]
    assert whens[0] == START
    assert whens[-1] - whens[0] == timedelta(seconds=3)
    assert track.track_items[0].coord.coords[0] == pytest.approx((8.45, 55.471, 152.0), abs=1e-6)


def test_geojson_has_the_track_as_a_line_with_its_times(run_folder):
    (feature,) = json.loads(exported(run_folder, ExportFormat.GEOJSON))["features"]
    line = feature["geometry"]["coordinates"]
    times_s = feature["properties"]["times_utc_s"]
    assert len(line) == len(times_s) == 4
    assert line[0] == pytest.approx([8.45, 55.471, 152.0], abs=1e-7)
    assert times_s[0] == pytest.approx(START.timestamp(), abs=1e-3)


def test_satellite_time_in_a_log_dates_its_track():
    events = [position(10.0), GnssTime(10.5, START.timestamp()), position(12.5)]
    track = build_track_export(events, "log", min_interval_s=1.0)
    assert track.points[1].utc_s == pytest.approx(START.timestamp() + 2.0)


def test_a_track_without_dates_is_a_track_all_the_same():
    track = build_track_export([position(10.0), position(12.5)], "log", min_interval_s=1.0)
    assert [point.utc_s for point in track.points] == [None, None]
    (read,) = gpxpy.parse(track_document_text(track, ExportFormat.GPX)).tracks
    assert [point.time for point in read.segments[0].points] == [None, None]
    (document,) = KML.parse(BytesIO(track_document_text(track, ExportFormat.KML).encode())).features
    assert document.features[0].geometry.geom_type == "LineString"


@pytest.mark.parametrize("file_format", [ExportFormat.PLAN, ExportFormat.WPL])
def test_a_format_of_missions_takes_no_track_and_says_where_the_mission_is(file_format):
    with pytest.raises(LeewayError, match=r"mission, not a track.*mission\.plan"):
        track_document_text(TrackExport("log", ()), file_format)


def test_a_log_without_a_position_has_no_track():
    with pytest.raises(LeewayError, match="log: no position"):
        build_track_export([GnssTime(1.0, 1e9)], "log", min_interval_s=1.0)
