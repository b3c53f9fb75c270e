"""The study engine: no case runs twice, no result is lost, and every result is written."""

import json
import os
import signal
from pathlib import Path

import pytest
import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.journal import ProgressLog, work_digest
from ground_station.adapters.workers.side_by_side import WorkerOptions
from sim_bridge.research.study.run import Experiment, ExperimentRun, Report
from sim_bridge.research.study.sheet import Sheet, mean_and_std


def square(n: int) -> int:
    return n * n


def killed_at_three(n: int) -> int:
    if n == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return n * n


asked: list[int] = []


def noted(n: int) -> int:
    if n == 3 and 3 not in asked:
        asked.append(n)
        raise KeyboardInterrupt
    asked.append(n)
    return n * n


def test_long_work_goes_on_where_it_stopped_and_does_nothing_twice(tmp_path: Path) -> None:
    asked.clear()
    study = Experiment("squares", range(5), noted, int)
    with pytest.raises(typer.Exit) as stopped:
        ExperimentRun(tmp_path).run_cases_and_return_results(study)
    assert stopped.value.exit_code == 130
    (path,) = tmp_path.glob("*.partial")
    with path.open("a") as file:
        file.write("[3, cut")  # the power failed during a write
    assert ExperimentRun(tmp_path).run_cases_and_return_results(study) == [0, 1, 4, 9, 16]
    assert asked == [0, 1, 2, 3, 3, 4]
    assert ProgressLog(path, "other", int).read_finished_results() == {}


@pytest.mark.sample
def test_what_no_worker_came_back_with_is_named_and_all_else_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Experiment("squares", range(5), killed_at_three, int)
    with pytest.raises(typer.Exit) as lost:
        ExperimentRun(tmp_path, WorkerOptions(2)).run_cases_and_return_results(study)
    assert lost.value.exit_code == 1
    assert "lost: squares, 4 of 5:" in capsys.readouterr().err
    (journal,) = tmp_path.glob("*.partial")
    assert ProgressLog(journal, work_digest(study.cases), int).read_finished_results() == {
        0: 0,
        1: 1,
        2: 4,
        4: 16,
    }


def test_a_report_is_printed_and_written_and_the_journal_removed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ExperimentRun(tmp_path, json=tmp_path / "out.json")
    found = run.run_cases_and_return_results(Experiment("squares", range(3), square, int))
    sheet = Sheet("T", ["a", "b"], [["1", "2"]], "n")
    pictures = {"p.png": lambda path: path.write_bytes(b"PNG") and None}
    run.print_and_write_report(Report({"t": sheet}, {"squares": found}, pictures))
    assert "| 1 | 2 |" in capsys.readouterr().out
    assert "| 1 | 2 |" in (tmp_path / "t.md").read_text()
    assert (tmp_path / "t.csv").read_text().splitlines() == ["a,b", "1,2"]
    assert json.loads((tmp_path / "out.json").read_text()) == {"squares": [0, 1, 4]}
    assert (tmp_path / "p.png").read_bytes() == b"PNG"
    assert not list(tmp_path.glob("*.partial"))


def test_the_json_file_of_a_report_without_a_document_is_its_tables(tmp_path: Path) -> None:
    sheet = Sheet("T", ["a", "b %", "c"], [["x", mean_and_std([2.0]), "-"]])
    ExperimentRun(tmp_path, json=tmp_path / "out.json").print_and_write_report(Report({"t": sheet}))
    row = {"a": "x", "b % mean": 2.0, "b % std": None, "c": None}
    assert json.loads((tmp_path / "out.json").read_text()) == {"t": [row]}


def test_a_json_file_without_a_folder_is_refused_first(tmp_path: Path) -> None:
    with pytest.raises(LeewayError, match="its folder does not exist"):
        ExperimentRun(tmp_path, json=tmp_path / "no" / "out.json")


def test_processes_side_by_side_run_matrix_routines_on_one_thread_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    names = ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"]
    study = Experiment("names", names, os.getenv, str)
    assert ExperimentRun(tmp_path, WorkerOptions(2)).run_cases_and_return_results(study) == [
        "1",
        "1",
    ]
    assert [os.getenv(name) for name in names] == ["7", None]


def test_a_table_without_rows_has_its_headings(tmp_path: Path) -> None:
    sheet = Sheet("losses", ["mission", "cause"], [])
    _, table = sheet.write_markdown_and_csv(tmp_path, "losses")
    assert table.read_text(encoding="utf-8").split() == ["mission,cause"]
    assert sheet.to_records() == []
