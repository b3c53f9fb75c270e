"""One flight of the suite: what is to be flown, and what came of it."""

from dataclasses import dataclass
from pathlib import Path

import msgspec


class FaultRow(msgspec.Struct, frozen=True, kw_only=True):
    """One flight under one fault, as `--json` writes it."""

    fault: str
    group: str
    autopilot: str
    phase: str
    seed: int
    outcome: str
    home: bool
    delivered: bool
    margin_wh: float
    p_home_last_go: float | None
    commands_after_takeover: int
    exceptions: int
    said: list[str]
    held: bool
    why: str
    cpu_s: float | None = None
    """What the flight took, of simulator and companions together; None: not measured."""
    charge_frac: float | None = None
    """Of the pack at power-up, where it was drawn to be tight; None: as the flight file has it."""


@dataclass(frozen=True, slots=True)
class FaultTask:
    """One flight to be flown."""

    fault: str
    autopilot: str
    phase: str
    seed: int
    run_root: Path
    tight: bool = False
    """The pack's charge is drawn from what is too little to what is plenty, and P(home) is judged
    over many flights; not each flight by whether it came home."""
