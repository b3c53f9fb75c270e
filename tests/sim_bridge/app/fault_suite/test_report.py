"""The suite's printed and written reports of its rows."""

import json

import msgspec
import pytest
from rich.console import Console

from sim_bridge.adapters.json_result import write_json_result
from sim_bridge.app.fault_suite.promises import p_home_calibration
from sim_bridge.app.fault_suite.report import (
    build_suite_result,
    cpu_time_summary_line,
    p_home_calibration_table,
    pair_summary_line,
)
from sim_bridge.app.faults.fault import FaultRow
from tests.sim_bridge.app.fault_suite.made_rows import made_row


def row(group: str = "energy", *, promised: float | None = 0.999, home: bool = True) -> FaultRow:
    why = "" if home else "not home"
    return made_row(group=group, p_home_last_go=promised, home=home, passed=home, failure_text=why)


def printed(table) -> list[list[str]]:
    """Return the cells of each line, without the bounds in the last column."""
    console = Console(width=120)
    with console.capture() as capture:
        console.print(table)
    return [line.split()[:8] for line in capture.get().splitlines()]


def test_promises_are_held_against_what_came_home_group_by_group():
    rows = [row(), row(promised=0.9), row(home=False), row("link"), row("host", promised=None)]
    table = p_home_calibration_table(rows, "group")
    lines = printed(table)
    assert ["energy", "3", "0.966", "0.667", "0.3360", "1", "of", "2"] in lines
    assert ["link", "1", "0.999", "1.000", "0.0000", "1", "of", "1"] in lines
    assert not any(line[:1] == ["host"] for line in lines)


def test_the_file_holds_every_row_and_the_count(tmp_path):
    path = tmp_path / "faults.json"
    write_json_result(path, build_suite_result([row(), row(home=False)]))
    read = json.loads(path.read_text())
    assert (read["held"], read["of"]) == (1, 2)
    assert read["rows"][1]["why"] == "not home"
    nothing = {"rows": [], "held": 0, "of": 0, "left": 0, "lost": [], "groups": [], "cpu_s": None}
    assert build_suite_result([]) == nothing


def test_losses_at_a_high_p_home_are_bounded_over_all_groups_and_in_each():
    """Bounds: no loss in n flights is 1 - 0.05**(1/n); one in one is 0.05 (Clopper and Pearson)."""
    rows = [
        *[row()] * 3,
        row("link", home=False),
        row(promised=0.98, home=False),
        made_row(fault="kill-switch", p_home_last_go=1.0, home=False),  # requires no return
        made_row(outcome="TAKEN", p_home_last_go=1.0, home=False),
    ]
    energy, link, pool = build_suite_result(rows)["groups"]
    assert (pool.group, pool.flights) == ("all", 5)
    assert pool.returned_and_total_at_high_p_home == (3, 4)
    assert energy.loss_lower == 0.0
    assert energy.loss_upper == pytest.approx(1.0 - 0.05 ** (1.0 / 3.0))
    assert (link.loss_lower, link.loss_upper) == (pytest.approx(0.05), 1.0)


def test_pairs_are_counted_in_which_both_faults_took_effect():
    rows = [
        made_row(had_two_faults=both, commands_after_takeover=n)
        for both, n in ((True, 2), (False, 0))
    ]
    assert pair_summary_line(rows).startswith("pairs: 2, both faults took effect in 1; 2 commands")
    assert pair_summary_line([row()]) == ""


def test_the_file_says_how_reliable_what_was_said_is_group_by_group():
    said = [(0.999, True), (0.995, False), (0.98, True), (0.5, False), (None, True)]
    (energy,) = build_suite_result([row(promised=p, home=home) for p, home in said])["groups"]
    assert (energy.group, energy.flights) == ("energy", 4)
    # By hand: (0.001**2 + 0.995**2 + 0.02**2 + 0.5**2) / 4.
    assert energy.brier == pytest.approx(0.31010, abs=1e-5)
    classes = [(each.from_p, each.flights, each.home) for each in energy.reliability]
    assert classes == [(0.0, 1, 0.0), (0.97, 1, 1.0), (0.99, 2, 0.5)]
    assert energy.returned_and_total_at_high_p_home == (1, 2)


def test_what_a_flight_took_is_said_with_the_longest():
    assert cpu_time_summary_line([row()]) == ""
    rows = [msgspec.structs.replace(row(), cpu_s=seconds) for seconds in (9.0, 10.0, 31.0)]
    assert (
        cpu_time_summary_line(rows)
        == "CPU per flight: 10.0 s (median), at most 31.0 s (draw-2 px4 drop)"
    )


@pytest.mark.parametrize(("home", "lost", "kept"), [(19, 1, True), (18, 1, False), (0, 0, True)])
def test_a_promise_is_kept_where_nineteen_of_twenty_that_were_sure_came_home(home, lost, kept):
    unsure = [row(promised=0.6, home=False) for _ in range(5)]
    sure = [row() for _ in range(home)] + [row(home=False) for _ in range(lost)]
    (energy,) = p_home_calibration([*unsure, *sure])
    assert energy.is_high_p_home_reliable is kept
