"""Terminal output about a flight, during and after it."""

import io
from typing import Any

from rich.console import Console

from companion.core.pilot.transitions import Phase
from sim_bridge.app.flight.report import (
    VehicleStatus,
    end_reason_and_settings_messages,
    render_vehicles,
)

LONG = "diverting to rally-2: wind 12.9 m/s from 283 leaves 3.1 Wh less than home asks for"
NAMED = {
    "LW_WINDN": -12.6,
    "LW_WINDE": 2.9,
    "LW_MARGIN": -123.4,
    "LW_PHOME": 0.9987,
    "LW_PSTATED": 0.8734,
}


def live_lines(*vehicles: VehicleStatus) -> list[str]:
    """Return the live view on a terminal of 80 columns."""
    out = io.StringIO()
    Console(width=80, file=out, color_system=None).print(render_vehicles(vehicles, 123.4, 17.0))
    return out.getvalue().splitlines()


def craft(label: str, phase: str, **changes: Any) -> VehicleStatus:
    fields = {
        "distance_m": 12345.0,
        "up_m": 1234.0,
        "named_values": NAMED,
        "status_texts": [(1.0, LONG)],
    } | changes
    return VehicleStatus(label, phase, **fields)


def test_the_live_view_cuts_nothing_at_80_columns_but_what_a_vehicle_said():
    lines = live_lines(*(craft("12 ardupilot", phase.value) for phase in Phase))
    rows, said = lines[3 : 3 + len(Phase)], lines[3 + len(Phase) :]
    for phase, row in zip(Phase, rows, strict=True):
        figures = ["12345", "1234", "12.9", "from", "347", "-123.4", "0.873*"]
        assert row.split() == ["12", "ardupilot", *phase.value.split(), *figures]
    for words in said:
        assert words.startswith("12 ardupilot reports: diverting to rally-2: wind 12.9 m/s")
        assert len(words) == 80
        assert words.endswith("…")


def test_columns_and_lines_stay_where_they_are_while_the_figures_change():
    early = live_lines(
        craft("1 px4", "arm", distance_m=0.0, up_m=0.0, named_values={}, status_texts=[])
    )
    later = live_lines(craft("1 px4", "wait for position"))
    assert early[1:3] == later[1:3]
    assert len(early) == len(later)
    assert len(early[3]) == len(later[3])


def row(**changes: Any) -> dict[str, Any]:
    ended = {"kind": "finished", "reason": "ABRT: 1 m from depot"}
    base = {"vehicle": "m100-2", "flight_time_s": 80.0, "decisions": [ended], "reason": None}
    return base | {"outcome": "ABRT", "judged_by": "truth"} | changes


def test_a_flight_tells_why_it_ended():
    assert end_reason_and_settings_messages(row()) == ["2 ended: ABRT: 1 m from depot"]
    (text,) = end_reason_and_settings_messages(row(outcome="SUC"))
    assert text.endswith("ABRT: 1 m from depot (the companion's estimate; the table is by truth)")


def test_a_vehicle_that_stayed_on_the_ground_tells_what_kept_it_there():
    decisions = [
        {"kind": "grounded", "reason": "the pack has 4 cells, 6 are stated"},
        {"kind": "finished", "reason": "ABRT: never took off"},
    ]
    words = end_reason_and_settings_messages(row(flight_time_s=0.0, decisions=decisions))
    assert words == ["2 no take-off: the pack has 4 cells, 6 are stated"]


def test_settings_are_told_apart_by_whether_the_vehicle_has_its_own_again():
    settings = [
        {"name": "A", "before": 0.0, "set": 3.0, "restored": True},
        {"name": "B", "before": 1.5, "set": None, "restored": False},
    ]
    _, restored, left = end_reason_and_settings_messages(row(settings=settings))
    assert restored == "2 settings changed and restored: A (0, set 3)"
    assert left.startswith("2 settings NOT restored: B (1.5, set as an earlier flight left it);")
    assert "companion restore" in left


def test_a_companion_that_left_no_record_ends_without_words():
    assert end_reason_and_settings_messages(row(decisions=[])) == []
