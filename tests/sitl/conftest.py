"""Flights for the SITL tests: one short default, changed case by case, flown over real UDP."""

import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import pytest

from sim_bridge.app.flight.companion_process import suite_forks
from sim_bridge.app.flight.faults import FaultPlan
from sim_bridge.app.flight.fly import FlyOptions, Progress, fly
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
    """A flight that has ended: the verdict, and all that was seen of it."""

    row: dict[str, Any]
    craft: Craft
    faults: FaultPlan
    run_dir: Path

    @property
    def kinds(self) -> list[str]:
        """The decisions, in order."""
        return [d["kind"] for d in self.row["decisions"]]

    def fault_s(self, kind: str) -> float:
        """When a fault began; 0 where it never did."""
        return next((t for t, words in self.faults.log if words.startswith(kind)), 0.0)

    @property
    def said(self) -> str:
        """What the operator's ground station was told, in one line."""
        return "; ".join(text for _, text in self.craft.operator.said)

    def commands_after(self, t_s: float) -> list[tuple[float, str, int]]:
        """What the companion commanded after a time."""
        return [c for c in self.craft.commands if c[0] > t_s]


@dataclass(slots=True)
class _Keep(Progress):
    """Keeps what was flown; ends a flight so many seconds after the companion let go."""

    kept: list[Craft] = field(default_factory=list)
    plan: FaultPlan | None = None
    after_hands_off_s: float | None = None
    _crafts: list[Craft] = field(default_factory=list)

    def update(self, crafts: list[Craft], t_s: float) -> None:
        self._crafts = crafts

    def goes_on(self, t_s: float) -> bool:
        if self.after_hands_off_s is None or not self._crafts:
            return True
        said = self._crafts[0].operator.said
        off_s = next((at_s for at_s, text in said if text.startswith("hands off")), None)
        return off_s is None or t_s < off_s + self.after_hands_off_s

    def ended(self, crafts: list[Craft], faults: FaultPlan) -> None:
        self.kept, self.plan = crafts, faults


def merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`base` with tables changed key by key; `wind` and `faults` are replaced whole."""
    out = copy.deepcopy(base)
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(out.get(key), dict) and key != "wind":
            out[key] = merged(out[key], value)
        else:
            out[key] = value
    return out


@pytest.fixture
def short_flight():
    """`short_flight(changes)` is the short flight's table so changed."""
    return lambda changes: merged(SHORT, changes)


@pytest.fixture
def short_file(tmp_path) -> Path:
    """The short flight as a file."""
    path = tmp_path / "short.toml"
    path.write_text(_toml(SHORT))
    return path


@pytest.fixture
def fly_case(tmp_path):
    """`fly_case(autopilot, changes, seed=, gate=)` flies the short flight so changed."""

    def fly_it(
        autopilot_kind: str,
        changes: dict[str, Any] | None = None,
        *,
        seed: int = 1,
        gate: bool = True,
        name: str = "case",
        after_hands_off_s: float | None = None,
        believed: str | None = None,
        signing_key: Path | None = None,
        companion_arguments: tuple[str, ...] = (),
        settings: dict[str, float] | None = None,
    ) -> Flown:
        table = merged(SHORT, changes or {})
        path = tmp_path / f"{name}.toml"
        path.write_text(_toml(table))
        keep = _Keep(after_hands_off_s=after_hands_off_s)
        options = FlyOptions(
            flight_file=path,
            autopilot=autopilot_kind,
            seed=seed,
            gate=gate,
            run_root=tmp_path / "runs",
            picture=False,
            lockstep_limit_s=30.0,
            believed=believed,
            signing_key=signing_key,
            companion_arguments=companion_arguments,
            settings=settings or {},
            forks=suite_forks(),
        )
        row = fly(options, keep)["flights"][0]
        assert keep.plan is not None
        return Flown(row, keep.kept[0], keep.plan, keep.kept[0].run_dir)

    return fly_it


def _toml(table: dict[str, Any]) -> str:
    return msgspec.toml.encode(table).decode()
