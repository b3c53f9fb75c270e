"""Rows of the mFSTSP benchmark: a worker that is killed costs its row only."""

from pathlib import Path

import pytest

from ground_station.adapters.workers.journal import ProgressLog
from ground_station.adapters.workers.side_by_side import ItemDone, ItemLost
from ground_station.app.benchmarks import mfstsp_bench
from ground_station.app.benchmarks.mfstsp_bench import (
    BenchParams,
    BenchRow,
    RowsLostError,
    plan_remaining_rows,
)

ROWS = [BenchRow(Path("p1"), "101", drones) for drones in (1, 2, 3)]


def one_is_lost(work, do, workers):
    """Replaces the workers: the worker of the second row is killed twice."""
    for index, piece in enumerate(work):
        if piece.drones == 2:
            yield ItemLost(index, piece, "SIGKILL")
        else:
            yield ItemDone(index, do(piece))


def test_a_row_whose_worker_is_killed_is_named_and_all_others_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(mfstsp_bench, "run_parallel", one_is_lost)
    monkeypatch.setattr(mfstsp_bench, "solve_row", lambda row, params: {"drones": row.drones})
    journal, told = ProgressLog(tmp_path / "rows.json", "digest", dict), []
    tell = lambda number, row: told.append((number, row["drones"]))  # noqa: E731
    with pytest.raises(RowsLostError, match=r"^lost: p1 101 x2: SIGKILL$"):
        plan_remaining_rows(ROWS, BenchParams(None, 0), 2, journal, tell)
    assert told == [(0, 1), (2, 3)]
    with journal.path.open("ab") as file:
        file.write(b'[2,{"drones":')  # simulated power failure
    assert {number: row["drones"] for number, row in journal.read_finished_results().items()} == {
        0: 1,
        2: 3,
    }
    # A second run with intact workers does not repeat the kept rows.
    monkeypatch.setattr(mfstsp_bench, "run_parallel", lambda work, do, workers: (
        ItemDone(index, do(piece)) for index, piece in enumerate(work)
    ))  # fmt: skip
    monkeypatch.setattr(mfstsp_bench, "solve_row", lambda row, params: {"drones": -row.drones})
    rows = plan_remaining_rows(ROWS, BenchParams(None, 0), 2, journal, tell)
    assert [row["drones"] for row in rows] == [1, -2, 3]
