"""What the terminal says of a flight that is over."""

from typing import Any

from sim_bridge.app.flight.report import ending_words


def row(**changes: Any) -> dict[str, Any]:
    ended = {"kind": "finished", "reason": "ABRT: 1 m from depot"}
    base = {"vehicle": "m100-2", "flight_time_s": 80.0, "decisions": [ended], "reason": None}
    return base | changes


def test_a_flight_tells_why_it_ended():
    assert ending_words(row()) == ["2 ended: ABRT: 1 m from depot"]


def test_a_vehicle_that_stayed_on_the_ground_tells_what_kept_it_there():
    decisions = [
        {"kind": "grounded", "reason": "the pack has 4 cells, 6 are stated"},
        {"kind": "finished", "reason": "ABRT: never took off"},
    ]
    words = ending_words(row(flight_time_s=0.0, decisions=decisions))
    assert words == ["2 no take-off: the pack has 4 cells, 6 are stated"]


def test_settings_are_told_apart_by_whether_the_vehicle_has_its_own_again():
    settings = [
        {"name": "A", "before": 0.0, "set": 3.0, "restored": True},
        {"name": "B", "before": 1.5, "set": None, "restored": False},
    ]
    _, restored, left = ending_words(row(settings=settings))
    assert restored == "2 settings changed and put back: A (0, set 3)"
    assert left.startswith("2 settings NOT put back: B (1.5, set as an earlier flight left it);")
    assert "companion restore" in left


def test_a_companion_that_left_no_record_ends_without_words():
    assert ending_words(row(decisions=[])) == []
