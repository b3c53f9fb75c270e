"""A trial's bounds and cases: no new case after the time limit; a case reads back as written."""

import functools
import os
import re
import signal
import time
from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import WorkerOptions
from sim_bridge.app.trials import day_case, fuzz, logs, stall
from sim_bridge.app.trials.damage import EDIT_KINDS, Edit, apply_edits
from sim_bridge.app.trials.logs import SUFFIXES, write_undamaged_sample_logs
from sim_bridge.app.trials.soak import SoakSample, describe_exceeded_limits
from sim_bridge.app.trials.trial import (
    TrialRow,
    build_trial_result,
    cases_until_time_limit,
    failed_rows_for_lost_worker,
    read_case_file,
    run_trial,
    write_case_file,
)


def row(case) -> TrialRow:
    return TrialRow.for_case(case, "broke")


@pytest.mark.parametrize(
    "case",
    [
        fuzz.draw_case(3, 4),
        logs.draw_case(3, 4),
        stall.draw_case(3, "px4", 30.0, 6.0),
        day_case.draw_case(3, 4),
    ],
    ids=["fuzz", "logs", "stall", "days"],
)
def test_a_case_that_was_written_out_is_read_back_the_same(tmp_path, case):
    assert read_case_file(write_case_file(tmp_path, row(case)), type(case)) == case


def test_a_file_that_is_no_case_is_refused_by_its_name(tmp_path):
    (tmp_path / "a.json").write_text('{"seed": 1}')
    with pytest.raises(LeewayError, match=r"a\.json: not a case"):
        read_case_file(tmp_path / "a.json", fuzz.FuzzCase)


def test_the_same_seed_draws_the_same_cases_and_another_seed_others():
    assert fuzz.draw_case(1, 7) == fuzz.draw_case(1, 7) != fuzz.draw_case(2, 7)
    assert logs.draw_case(1, 7) == logs.draw_case(1, 7) != logs.draw_case(2, 7)


def test_nothing_begins_after_the_time_is_up():
    cases = [fuzz.draw_case(1, number) for number in range(5)]
    assert len(list(cases_until_time_limit(cases, None))) == 5
    assert not list(cases_until_time_limit(cases, 0.0))
    rows = run_trial(cases, lambda case: [row(case)], WorkerOptions(), none_lost)
    assert len(list(rows)) == 5


def wait_for(first: Path, number: int) -> list[TrialRow]:
    """Return a row by its number. The first case ends only after the last one."""
    limit_s = time.monotonic() + 60.0
    while number == 0 and not first.exists():
        assert time.monotonic() < limit_s
        time.sleep(0.01)
    if number == LAST:
        first.touch()
    return [TrialRow(name=f"case-{number}", passed=True, reason="", metrics={}, case=None)]


LAST = 11


def none_lost(number: int, why: str) -> list[TrialRow]:
    raise AssertionError(f"{number}: {why}")


def killed_at_two(case: fuzz.FuzzCase) -> list[TrialRow]:
    if case == fuzz.draw_case(1, 2):
        os.kill(os.getpid(), signal.SIGKILL)
    return [TrialRow.for_case(case)]


@pytest.mark.sample
def test_a_case_whose_worker_is_killed_is_a_row_that_has_not_held():
    cases = [fuzz.draw_case(1, number) for number in range(5)]
    ended = run_trial(cases, killed_at_two, WorkerOptions(2), failed_rows_for_lost_worker)
    rows = list(ended)
    assert len({one.name for one in rows}) == len(rows) == 5
    (broke,) = [one for one in rows if not one.passed]
    assert broke.case == cases[2]
    assert "SIGKILL" in broke.reason


@pytest.mark.sample
def test_a_case_that_takes_long_holds_up_no_other_and_the_result_is_in_order(tmp_path):
    attempt = functools.partial(wait_for, tmp_path / "last")
    rows = list(run_trial(range(LAST + 1), attempt, WorkerOptions(2), none_lost))
    assert [row.name for row in rows[-2:]] != ["case-10", "case-11"], "the first came late"
    told = build_trial_result("fuzz", 1, rows)
    assert [row.name for row in told["rows"]] == [f"case-{number}" for number in range(LAST + 1)]


def test_stalls_of_one_vehicle_share_flights_in_the_order_of_their_instants():
    cases = stall.draw_random_subset_of_cases(1, ("px4", "ardupilot"), 50)
    flights = list(stall.group_cases_into_shared_flights(cases))
    assert sorted(case.name for flight in flights for case in flight.cases) == sorted(
        case.name for case in cases
    )
    for flight in flights:
        assert [case.at_s for case in flight.cases] == sorted(case.at_s for case in flight.cases)
        assert {case.autopilot for case in flight.cases} == {flight.autopilot}


@pytest.mark.parametrize("deed", EDIT_KINDS)
@pytest.mark.parametrize("kind", SUFFIXES)
def test_each_deed_damages_a_log_of_each_format(tmp_path, kind, deed):
    raw = write_undamaged_sample_logs(tmp_path)[kind].read_bytes()
    for at in (0.0, 0.4, 0.999):
        assert apply_edits(kind, raw, (Edit(deed, at, 64, 3),)) != raw
    assert apply_edits(kind, b"", (Edit(deed, 0.5, 64, 3),)) is not None


def sample(t_s: float, memory_mb: float, *, files: int = 20, threads: int = 9) -> SoakSample:
    return SoakSample(t_s, memory_mb, files, threads, 1.0, flights=3, is_standby=True)


def test_a_process_that_holds_what_it_held_is_within_bounds():
    assert not describe_exceeded_limits([sample(0.0, 100.0), sample(3.0 * 3600.0, 100.5)], 3.0)


@pytest.mark.parametrize(
    ("last", "hours", "words"),
    [
        (sample(600.0, 115.0), 0.2, "memory grew"),
        (sample(3.0 * 3600.0, 109.0), 3.0, r"3\.00 MB/h"),
        (sample(600.0, 260.0), 0.2, "260 MB of memory"),
        (sample(600.0, 100.0, files=25), 0.2, "25 open files"),
        (sample(600.0, 100.0, threads=10), 0.2, "10 threads"),
    ],
)
def test_a_process_that_grows_is_not(last, hours, words):
    assert re.search(words, describe_exceeded_limits([sample(0.0, 100.0), last], hours))
