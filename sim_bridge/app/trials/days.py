"""Whole days drawn from a seed: desk, store, truck or depot, drones, a network, and faults.

Each case is one day by the machinery of `sim-bridge day`, in one process on one clock, judged by
truth at its end and watched while it goes on. All that decides it is in its case.
"""

import itertools
import math
import shutil
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.core.pilot.transitions import Phase
from companion.fleet.messages import State
from ground_station.adapters.files.compiled_code import keep_compiled_code
from sim_bridge.app.day.rules import ASKS, STUCK, raises_nothing
from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.trials.day_case import (
    LEAST_ORDERS_FOR_ALL,
    MOST_ORDERS_EACH,
    MOST_VEHICLES,
    SQLITE,
    DayCase,
    drawn,
    with_all_faults,
)
from sim_bridge.app.trials.trial import TrialRow

ROUNDING_WH = 2e-5
FLYING = frozenset(
    phase.value
    for phase in (Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RELEASE,
                  Phase.RETURN, Phase.DIVERT, Phase.LAST_RESORT, Phase.LAND, Phase.SUSPENDED)
)  # fmt: skip


@dataclass(slots=True)
class DayWatch:
    """What must hold at every second of a day; `wrong` is the first that did not."""

    wrong: str | None = None
    _left_wh: dict[tuple[str, float], float] = field(default_factory=dict)
    """The least that each vehicle told since it was switched on."""

    def goes_on(self, world: DayWorld) -> bool:
        """Look, once a second; False where something does not hold: the day is stopped there."""
        for drone in world.drones:
            state = world.plumbing.network.states.get(drone.name)
            if drone.up is not None and drone.is_airborne and state is not None:
                self._look(drone.up.t0_s, state, world.clock.t_s)
            if drone.up is not None and drone.up.taken is not None and drone.up.taken.commands:
                self._say(f"{drone.name}: {drone.up.taken.commands[0]} after the take-over")
        return self.wrong is None

    def _look(self, since_s: float, state: State, t_s: float) -> None:
        left_wh, key = state.energy_left_wh, (state.vehicle, since_s)
        if left_wh is None or state.phase not in FLYING:
            return
        before_wh = self._left_wh.get(key, math.inf)
        if left_wh > before_wh + ROUNDING_WH:
            rose = f"from {before_wh:.2f} to {left_wh:.2f} Wh at {t_s:.0f} s"
            self._say(f"{state.vehicle}: energy left rose {rose}")
        self._left_wh[key] = min(before_wh, left_wh)

    def _say(self, words: str) -> None:
        self.wrong = self.wrong or words


def wrong_with(row: dict[str, Any], watch: DayWatch, folder: Path) -> list[str]:
    """All that did not hold. A day that was stopped has its one reason."""
    if watch.wrong is not None:
        return [watch.wrong]
    wrong = [words for ask in ASKS for words in ask(row)]
    store = [f"the store is not whole: {words}" for words in row["store_faults"]]
    return wrong + store + raises_nothing(folder)


@dataclass(frozen=True, slots=True)
class DayFlyer:
    """Flies days, each in a folder of its own under `run_root`."""

    run_root: Path

    def __call__(self, case: DayCase) -> list[TrialRow]:
        """Fly one."""
        return [attempt(case, self.run_root / case.name)]


def attempt(case: DayCase, folder: Path) -> TrialRow:
    """Fly one day and judge it; of a day that held, no folder is left."""
    keep_compiled_code()  # before the planner's first import
    from sim_bridge.app.trials.day_flight import flown

    watch = DayWatch()
    try:
        row = flown(case, folder, watch.goes_on)
    except Exception as error:  # noqa: BLE001 - desk, truck, companions run here: it is judged
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "exception.txt").write_text(traceback.format_exc())
        why = f"an exception: {type(error).__name__}: {error}"
        return TrialRow(name=case.name, held=False, why=why, told={}, case=case)
    wrong = wrong_with(row, watch, folder)
    if not wrong:
        shutil.rmtree(folder)
    why = "; ".join(wrong)
    return TrialRow(name=case.name, held=not wrong, why=why, told=told(row, case), case=case)


def told(row: dict[str, Any], case: DayCase) -> dict[str, Any]:
    """What a day came to."""
    flights = row["flights"]
    flown_s = sum((f["land_s"] or row["duration_s"]) - f["launch_s"] for f in flights)
    return {
        "program": row["settings"],
        "kind": f"{case.store}, {'truck' if case.truck else 'depot'}",
        "minutes": round(row["duration_s"] / 60.0, 1),
        "vehicle_h": row["powered_h"],
        "flown_h": round(flown_s / 3600.0, 4),
        "flights": len(flights),
        "delivered": row["delivered"],
        "orders": row["orders"],
        "taken_over": sum(flight["taken"] for flight in flights),
        **row["faults_came"],
        "longest_cut_s": row["longest_cut_s"],
        "wrong_went": row["what_went_wrong"],
        "stuck": [line for line in row["undelivered"] if line["why"].startswith(STUCK)],
        "nearest_m": row["separation_min_m"],
        "margin_min_wh": row["margin_min_wh"],
        "cpu_s": round(row["spent"]["cpu_s"], 1),
    }


@dataclass(frozen=True, slots=True)
class DayDraw:
    """How days are drawn. `truck` None: with one and without, drawn too."""

    seed: int
    stores: tuple[str, ...] = (SQLITE,)
    truck: bool | None = None
    all_faults: bool = False
    most_vehicles: int = MOST_VEHICLES
    most_orders_each: int = MOST_ORDERS_EACH

    def cases(self) -> Iterator[DayCase]:
        """The cases of a trial, without an end; each day on each of the stores."""
        for number in itertools.count():
            case = self._drawn(number)
            yield from (msgspec.structs.replace(case, store=store) for store in self.stores)

    def _drawn(self, number: int) -> DayCase:
        least = LEAST_ORDERS_FOR_ALL if self.all_faults else 1
        bounds = (self.most_vehicles, self.most_orders_each, least)
        case = drawn(self.seed, number, *bounds, truck=self.truck)
        return with_all_faults(case) if self.all_faults else case


def until_hours(rows: Iterable[TrialRow], vehicle_h: float | None) -> Iterator[TrialRow]:
    """These rows, until vehicles were switched on for so many hours in all."""
    spent_h = 0.0
    for row in rows:
        yield row
        spent_h += row.told.get("vehicle_h", 0.0)
        if vehicle_h is not None and spent_h >= vehicle_h:
            return
