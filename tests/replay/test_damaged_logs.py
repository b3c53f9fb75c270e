"""Damaged logs of every format: `companion replay` prints one line that names the file.

A valid file is torn, truncated and overwritten at random positions; numbers are overwritten with
values that readers often mishandle: not-a-number, infinities, the largest lengths.
"""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from companion.adapters.logs.decision_log import DecisionLog, TelemetryRows
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.app.cli.main import app
from companion.core.pilot.telemetry_state import TelemetryState
from sim_bridge.app.trials import damage

NASTY = [*damage.INVALID_VALUES, b"NaN"]
KINDS = {"csv": "csv", "ulog": "ulg", "dataflash": "bin", "tlog": "tlog", "mcap": "mcap"}

edits = st.lists(
    st.tuples(
        st.sampled_from(["put", "insert", "cut", "tear"]),
        st.floats(0.0, 1.0, exclude_max=True),
        st.one_of(st.sampled_from(NASTY), st.binary(min_size=1, max_size=16)),
    ),
    min_size=1,
    max_size=6,
)


@pytest.fixture(scope="module")
def good(make, world, tmp_path_factory) -> dict[str, Path]:
    """Return a valid file of each format: half a minute on the ground and in the air."""
    folder = tmp_path_factory.mktemp("good")
    short = world.select_rows(world.t_s < 20.0)
    paths = {kind: folder / f"a.{end}" for kind, end in KINDS.items()}
    make.csv(paths["csv"], make.telemetry_csv_columns(short) | make.battery_csv_columns(short))
    for kind in ("ulog", "dataflash", "tlog"):
        getattr(make, kind)(paths[kind], short)
    log, rows, now = DecisionLog(paths["mcap"]), TelemetryRows(), TelemetryState()
    for event in read_log_of_any_format(paths["tlog"]).events:
        now.store_event(event)
        for topic, row in rows.take_new_rows(now):
            log.write(topic, row)
    log.close()
    return paths


def damaged(raw: bytes, edited: list[tuple[str, float, bytes]]) -> bytes:
    """Return `raw` after some edits, each at a fraction of the remaining length."""
    for kind, share, piece in edited:
        at = int(share * len(raw))
        match kind:
            case "put":
                raw = raw[:at] + piece + raw[at + len(piece) :]
            case "insert":
                raw = raw[:at] + piece + raw[at:]
            case "cut":
                raw = raw[:at] + raw[at + len(piece) ** 3 :]
            case _:
                raw = raw[:at]
    return raw


def replayed(path: Path) -> tuple[int, str]:
    """Return exit code and output; an exception that leaves the command fails the test here."""
    result = CliRunner().invoke(app, ["replay", str(path), "--every", "30"])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


@pytest.mark.sample
@pytest.mark.parametrize("kind", list(KINDS))
def test_a_good_file_is_replayed(good, kind):
    assert replayed(good[kind])[0] == 0


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("kind", list(KINDS))
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edited=edits)
def test_a_damaged_file_is_replayed_as_far_as_it_goes_or_refused_in_one_line(good, kind, edited):
    path = good[kind].with_name(f"damaged.{KINDS[kind]}")
    path.write_bytes(damaged(good[kind].read_bytes(), edited))
    code, output = replayed(path)
    assert code in (0, 2)
    if code == 2:
        assert len(output.strip().splitlines()) == 1
        assert str(path) in output


def test_a_number_that_cannot_be_what_it_is_called_is_left_out_and_that_is_said(tmp_path):
    log = DecisionLog(tmp_path / "a.mcap")
    for k, roll_rad in enumerate([0.1, 1e30, 0.2]):
        row = {"t_s": float(k), "roll_rad": roll_rad, "pitch_rad": 0.0, "yaw_rad": 0.0}
        log.write("heard_attitude", row)
    log.close()
    flight = read_log_of_any_format(tmp_path / "a.mcap")
    assert [event.t_s for event in flight.events] == [0.0, 2.0]
    assert str(flight.findings[0]) == "sample 1: Attitude.roll_rad out of range; discarded"


@pytest.mark.parametrize("field", [b"vx", b"q"])
def test_a_ulog_topic_whose_definition_lost_a_field_is_left_out_and_that_is_said(
    make, world, tmp_path, field
):
    path = make.ulog(tmp_path / "a.ulg", world.select_rows(world.t_s < 20.0))
    name = {b"q": b"vehicle_attitude", b"vx": b"vehicle_local_position"}[field]
    raw = path.read_bytes()
    at = raw.index(b" " + field, raw.index(name + b":")) + 1
    path.write_bytes(raw[:at] + b"?" + raw[at + 1 :])
    flight = read_log_of_any_format(path)
    assert flight.events
    assert any("no field" in found.what for found in flight.findings)
