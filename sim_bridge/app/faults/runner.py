"""Flies a row of one vehicle and judges it."""

import secrets
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import params_dir
from companion.adapters.files.signing_files import write_signing_key
from companion.app.flight.recorder import TEXT
from sim_bridge.app.faults.case import FaultCase
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.faults.stage import Performance
from sim_bridge.app.faults.verdict import FlownFault
from sim_bridge.app.flight.companion_process import suite_forks
from sim_bridge.app.flight.fly import FlyOptions, Progress, fly

FLIGHT = "faults.toml"
LOCKSTEP_LIMIT_S = 60.0
TIGHT_CHARGE_FRAC = (0.42, 0.54)
"""Untroubled, the suite's flight is not begun with less than the first, turns back with a little
more, and delivers with plenty left with the second."""

OUTPUT = "companion.out"
KEY, KEY_BYTES = "signing.key", 32


def fly_flight_fault(case: FaultCase, task: FaultTask) -> FaultRow:
    """Fly one row and judge it."""
    folder = task.run_root / f"{case.name}-{task.autopilot}-{task.phase}-seed{task.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    draws = np.random.default_rng([task.seed, case.number])
    performance = Performance(case.play, task.phase, draws)
    charge_frac = _tight_charge(task) if task.tight else None
    drawn = {} if charge_frac is None else {"vehicle": {"charge_frac": charge_frac}}
    told = write_flight(folder / "flight.toml", case.flight, drawn)
    options = FlyOptions(
        flight_file=write_flight(folder / "world.toml", case.flight, drawn, case.untold),
        told=told,
        autopilot=task.autopilot,
        seed=task.seed,
        run_root=folder,
        picture=False,
        lockstep_limit_s=LOCKSTEP_LIMIT_S,
        companion_arguments=case.arguments,
        before_companion=case.before_companion,
        forks=suite_forks(),
        signing_key=_key_in(folder) if case.signed else None,
    )
    ending = _Ending(after_s=case.ends_after_s, performance=performance)
    (row,) = fly(options, ending, performance)["flights"]
    assert performance.stage is not None
    flown = FlownFault(row, performance.stage, _words(performance))
    return msgspec.structs.replace(_judged(task, case, flown), charge_frac=charge_frac)


def _tight_charge(task: FaultTask) -> float:
    flight = f"{task.fault} {task.autopilot} {task.phase}"
    draws = np.random.default_rng([task.seed, *flight.encode()])
    return round(float(draws.uniform(*TIGHT_CHARGE_FRAC)), 4)


def _key_in(folder: Path) -> Path:
    """A key of its own for this flight; drawing it from a seed would make it a known one."""
    path = folder / KEY
    path.unlink(missing_ok=True)
    write_signing_key(path, secrets.token_bytes(KEY_BYTES))
    return path


def write_flight(path: Path, *changes: dict[str, Any]) -> Path:
    """Write the suite's flight with some of its tables changed; returns its file."""
    table = tomllib.loads((params_dir() / "flights" / FLIGHT).read_text())
    for changed in changes:
        table = _merged(table, changed)
    path.write_bytes(msgspec.toml.encode(table))
    return path


def _merged(table: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`table` with its tables changed key by key."""
    out = dict(table)
    for key, value in changes.items():
        known = out.get(key)
        if isinstance(value, dict) and isinstance(known, dict) and key != "wind":
            out[key] = _merged(known, value)
        else:
            out[key] = value
    return out


def _words(performance: Performance) -> str:
    assert performance.stage is not None
    return printed_and_logged(performance.stage.craft.run_dir)


def printed_and_logged(run_dir: Path) -> str:
    """All that a companion printed, and its log: an exception in its loop stands only there."""
    paths = (run_dir / name for name in (OUTPUT, TEXT))
    return "\n".join(path.read_text(errors="replace") for path in paths if path.exists())


@dataclass(slots=True, kw_only=True)
class _Ending(Progress):
    """Ends a flight some time after a person took over, where the row says so."""

    after_s: float | None
    performance: Performance

    def goes_on(self, t_s: float) -> bool:
        stage = self.performance.stage
        if self.after_s is None or stage is None or stage.took_over_s is None:
            return True
        return t_s < stage.took_over_s + self.after_s


def _judged(task: FaultTask, case: FaultCase, flown: FlownFault) -> FaultRow:
    wrong = case.wrong(flown, tight=task.tight)
    return FaultRow(
        fault=case.name,
        group=case.group,
        autopilot=task.autopilot,
        phase=task.phase,
        seed=task.seed,
        outcome=flown.row["outcome"],
        home=flown.row["home"],
        delivered=flown.row["delivered"],
        margin_wh=flown.row["margin_wh"],
        p_home_last_go=flown.p_home_last_go,
        commands_after_takeover=flown.commands_after_takeover,
        exceptions=flown.exceptions,
        said=flown.said,
        held=not wrong,
        why="; ".join(wrong),
    )
