"""Rows of the mFSTSP benchmark: a worker that is killed costs its row only."""

from pathlib import Path

import pytest

from ground_station.adapters.workers.side_by_side import PieceDone, PieceLost
from ground_station.app.benchmarks import mfstsp_bench
from ground_station.app.benchmarks.mfstsp_bench import (
    BenchParams,
    BenchRow,
    RowJournal,
    RowsLost,
    run_rows,
)

ROWS = [BenchRow(Path("p1"), "101", drones) for drones in (1, 2, 3)]


def one_is_lost(work, do, workers):
    """Stands for workers of which one was killed twice, by the second row."""
    for index, piece in enumerate(work):
        if piece.drones == 2:
            yield PieceLost(index, piece, "SIGKILL")
        else:
            yield PieceDone(index, do(piece))


def test_a_row_whose_worker_is_killed_is_named_and_all_others_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(mfstsp_bench, "side_by_side", one_is_lost)
    monkeypatch.setattr(mfstsp_bench, "solve_row", lambda row, params: {"drones": row.drones})
    journal, told = RowJournal(tmp_path / "rows.json", "digest"), []
    tell = lambda number, row: told.append((number, row["drones"]))  # noqa: E731
    with pytest.raises(RowsLost, match=r"^lost: p1 101 x2: SIGKILL$"):
        run_rows(ROWS, BenchParams(None, 0), 2, journal, tell)
    assert told == [(0, 1), (2, 3)]
    assert {number: row["drones"] for number, row in journal.read().items()} == {0: 1, 2: 3}
    # Run again, with workers that live: what was kept is not planned again.
    monkeypatch.setattr(mfstsp_bench, "side_by_side", lambda work, do, workers: (
        PieceDone(index, do(piece)) for index, piece in enumerate(work)
    ))  # fmt: skip
    monkeypatch.setattr(mfstsp_bench, "solve_row", lambda row, params: {"drones": -row.drones})
    rows = run_rows(ROWS, BenchParams(None, 0), 2, journal, tell)
    assert [row["drones"] for row in rows] == [1, -2, 3]
