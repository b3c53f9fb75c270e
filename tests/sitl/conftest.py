"""Flights for the SITL tests: a short default flight with changes per case, over real UDP."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest

from sim_bridge.app.faults.runner import merge_tables_recursively
from sim_bridge.app.flight.companion_process import suite_fork_server
from sim_bridge.app.flight.fly import FlyOptions, fly_vehicles_and_evaluate
from sim_bridge.app.flight.stage import Script
from sim_bridge.app.flight.vehicle_process import Craft

SHORT: dict[str, Any] = {
    "format": "flight/1",
    "name": "short",
    "site": {
        "depot": {"lat_deg": 55.47, "lon_deg": 8.45, "alt_amsl_m": 12.0},
        "customer": {"name": "customer", "east_m": -420.0, "north_m": -60.0, "up_m": 2.1},
        "rally": [{"name": "quay", "east_m": -210.0, "north_m": 60.0, "up_m": 1.05}],
        "terrain": {"kind": "plane", "slope_east_frac": -0.005},
    },
    "vehicle": {"airframe": "m100", "payload_kg": 0.5, "charge_frac": 0.6},
    "mission": {"cruise_height_m": 30.0, "leg_length_m": 100.0, "time_limit_s": 600.0},
    "wind": {"kind": "steady", "speed_mps": 5.0, "from_deg": 70.0, "turbulence": "dryden"},
}


@dataclass
class Flown:
    """A completed flight: the verdict and all recorded data."""

    row: dict[str, Any]
    craft: Craft
    run_dir: Path

    @property
    def kinds(self) -> list[str]:
        """Return the kinds of the decisions, in order."""
        return [d["kind"] for d in self.row["decisions"]]

    def fault_s(self, kind: str) -> float:
        """Return the start time of a fault; 0 if it did not occur."""
        return next((t for t, name in self.craft.started_faults if name == kind), 0.0)

    @property
    def said(self) -> str:
        """Return the messages to the operator's ground station, in one line."""
        return "; ".join(text for _, text in self.craft.operator.received_texts)

    def commands_after(self, t_s: float) -> list[tuple[float, str, int]]:
        """Return the companion's commands after a time."""
        return [c for c in self.craft.link.commands if c[0] > t_s]


class Keep(Script):
    """Keeps the flown craft."""

    craft: Craft

    def apply_step(self, crafts: list[Craft], t_s: float, lockstep: Any) -> None:
        self.craft = crafts[0]


@pytest.fixture
def short_flight():
    """Return `short_flight(changes)`, which gives the short flight's table with these changes."""
    return lambda changes: merge_tables_recursively(SHORT, changes)


@pytest.fixture
def short_file(tmp_path) -> Path:
    """Write the short flight to a file."""
    path = tmp_path / "short.toml"
    path.write_text(_toml(SHORT))
    return path


@pytest.fixture
def fly_case(tmp_path):
    """Return `fly_case(autopilot, changes, seed=, gate=)`, which flies the changed short flight."""

    def fly_it(
        autopilot_kind: str,
        changes: dict[str, Any] | None = None,
        *,
        seed: int = 1,
        gate: bool = True,
        name: str = "case",
        believed: str | None = None,
        signing_key: Path | None = None,
        companion_arguments: tuple[str, ...] = (),
        settings: dict[str, float] | None = None,
    ) -> Flown:
        table = merge_tables_recursively(SHORT, changes or {})
        path = tmp_path / f"{name}.toml"
        path.write_text(_toml(table))
        keep = Keep()
        options = FlyOptions(
            flight_file=path,
            autopilot=autopilot_kind,
            seed=seed,
            gate=gate,
            run_root=tmp_path / "runs",
            picture=False,
            lockstep_limit_s=30.0,
            companion_airframe=believed,
            signing_key=signing_key,
            companion_arguments=companion_arguments,
            settings=settings or {},
            fork_server=suite_fork_server(),
        )
        row = fly_vehicles_and_evaluate(options, keep)["flights"][0]
        return Flown(row, keep.craft, keep.craft.run_dir)

    return fly_it


def _toml(table: dict[str, Any]) -> str:
    return msgspec.toml.encode(table).decode()
