"""Synthetic rows of the suite."""

from typing import Any

from sim_bridge.app.faults.fault import FaultRow

HELD = {
    "fault": "draw-2", "group": "energy", "autopilot": "px4", "phase": "drop", "seed": 1,
    "outcome": "SUC", "home": True, "delivered": True, "margin_wh": 1.0, "p_home_last_go": 0.999,
    "commands_after_takeover": 0, "exceptions": 0, "messages": ["mission restored"],
    "passed": True, "failure_text": "",
}  # fmt: skip


def made_row(**changes: Any) -> FaultRow:
    """Return a passed row with these changes."""
    return FaultRow(**(HELD | changes))
