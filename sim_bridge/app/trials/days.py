"""Whole days drawn from a seed: desk, truck, drones of both autopilots, a network, and faults.

Each case is one day by the machinery of `sim-bridge day`, in one process on one clock, judged by
truth at its end and watched while it goes on. All that decides it is in its case.
"""

import itertools
import math
import shutil
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import bundled_path
from companion.core.pilot.transitions import Phase
from companion.fleet.messages import State
from ground_station.adapters.files.compiled_code import keep_compiled_code
from ground_station.adapters.files.day_files import read_day
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_state import first_state
from ground_station.core.schema.order_states import Service
from sim_bridge.app.day.build import BuiltDay, DayWish, here
from sim_bridge.app.day.desk import DeskHere
from sim_bridge.app.day.fly import LONGEST_S, settings_of
from sim_bridge.app.day.run import DayOptions, DeskSeat, fly_day
from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.faults.verdict import TRACEBACK
from sim_bridge.app.trials.trial import TrialRow

SITES = ("harbour", "town")
AUTOPILOTS = ("px4", "ardupilot")
MOST_VEHICLES = 6
MOST_ORDERS_EACH = 4
"""Orders of a day are at most so many for each vehicle: some forty minutes, three turns each."""

LONGEST_FRONT_MPS = 4.0
"""Twice the std of the shipped forecasts: what a desk that plans with them must live with."""

NEAREST_M = 5.0
"""Of any two in the air, by truth. The plan keeps layers 12 m apart; both may be off theirs by a
barometer's drift and a gust, some 3 m each."""

ROUNDING_WH = 2e-5
FLYING = frozenset(
    phase.value
    for phase in (Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RELEASE,
                  Phase.RETURN, Phase.DIVERT, Phase.LAST_RESORT, Phase.LAND, Phase.SUSPENDED)
)  # fmt: skip
STUCK = "stuck"
"""The desk's state of an order that waits for a person, with the reason."""


class DayCase(msgspec.Struct, frozen=True, kw_only=True):
    """All that decides one day. `orders` are of the site's own."""

    seed: int
    site: str
    autopilots: tuple[str, ...]
    """One for each vehicle."""
    orders: tuple[str, ...]
    drones_only: bool
    """The driver serves no door: else the plan leaves small days to the truck."""
    forecast_mps: float
    forecast_from_deg: float
    front_mps: float
    """Size of a change of the wind that no forecast had; 0: none."""
    charge_frac: float
    temperature_c: float
    loss: float
    network_cuts: int
    companion_kills: int
    ground_kills: int
    take_overs: int
    truck_late_s: float
    searches: int
    """Trials of the plan's search."""

    @property
    def name(self) -> str:
        """Names run folder and case file."""
        return f"days-{self.site}-seed{self.seed}"

    @property
    def wish(self) -> DayWish:
        """The faults, for the day's world."""
        return DayWish(
            loss=self.loss,
            companion_kills=self.companion_kills,
            ground_kills=self.ground_kills,
            truck_late_s=self.truck_late_s,
            network_cuts=self.network_cuts,
            take_overs=self.take_overs,
            front_mps=self.front_mps,
            autopilots=self.autopilots,
        )


def drawn(
    seed: int,
    number: int,
    most_vehicles: int = MOST_VEHICLES,
    most_orders_each: int = MOST_ORDERS_EACH,
) -> DayCase:
    """The case of this number, of a trial with this seed; smaller days where bounds say so."""
    rng = np.random.default_rng([seed, number])
    site = str(rng.choice(SITES))
    vehicles = int(rng.integers(1, most_vehicles + 1))
    known = [order.id for order in read_day(path_of(site)).orders]
    count = int(rng.integers(1, min(most_orders_each * vehicles, len(known)) + 1))
    return DayCase(
        seed=1000 * seed + number,
        site=site,
        autopilots=tuple(map(str, rng.choice(AUTOPILOTS, vehicles))),
        orders=tuple(sorted(map(str, rng.choice(known, count, replace=False)))),
        drones_only=bool(rng.random() < 0.7),
        forecast_mps=round(float(rng.uniform(0.0, 8.0)), 1),
        forecast_from_deg=round(float(rng.uniform(0.0, 360.0)), 0),
        front_mps=_sometimes(rng, 0.3, 1.0, LONGEST_FRONT_MPS),
        charge_frac=round(float(rng.uniform(0.85, 1.0)), 2),
        temperature_c=round(float(rng.uniform(-5.0, 35.0)), 0),
        loss=_sometimes(rng, 0.6, 0.01, 0.3),
        network_cuts=int(rng.integers(0, 3)),
        companion_kills=int(rng.integers(0, 3)),
        ground_kills=int(rng.integers(0, 3)),
        take_overs=int(rng.random() < 0.3),
        truck_late_s=_sometimes(rng, 0.3, 20.0, 240.0),
        searches=200,
    )


def _sometimes(rng: np.random.Generator, share: float, low: float, high: float) -> float:
    """In this share of the cases a value between the bounds, else 0."""
    happens, value = rng.random() < share, float(rng.uniform(low, high))
    return round(value, 2) if happens else 0.0


def path_of(site: str) -> Path:
    """The shipped day of this name."""
    return bundled_path(Path(site), "days", "day")


def data_of(case: DayCase) -> DayData:
    """The site's day with this case's fleet, orders and forecast."""
    data = read_day(path_of(case.site))
    first = data.day.drones[0]
    drones = [
        msgspec.structs.replace(
            first,
            id=f"d{k + 1}",
            charge_frac=case.charge_frac,
            temperature_c=case.temperature_c,
        )
        for k in range(len(case.autopilots))
    ]
    forecast = msgspec.structs.replace(
        data.day.forecast, speed_mps=case.forecast_mps, from_deg=case.forecast_from_deg
    )
    day = msgspec.structs.replace(data.day, drones=drones, forecast=forecast)
    orders = [order for order in data.orders if order.id in case.orders]
    if case.drones_only:
        orders = [msgspec.structs.replace(order, service=Service.DRONE) for order in orders]
    return replace(data, day=day, orders=orders)


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


Ask = Callable[[dict[str, Any]], list[str]]
"""What is wrong with a day by one rule, in words, from the row of its end."""


def is_over(row: dict[str, Any]) -> list[str]:
    """The desk came to its end by itself."""
    return [] if row["ended"] else [f"not over after {row['duration_s']:.0f} s"]


def loses_no_vehicle(row: dict[str, Any]) -> list[str]:
    """Each flight ended at home with the reserve, or whole where a person wanted it."""
    return [f"not home: {words}" for words in row["lost"]]


def brings_nothing_twice(row: dict[str, Any]) -> list[str]:
    """No order was flown or handed over again after it had been brought."""
    return [f"twice: {order}" for order in row["flown_twice"]]


def loses_no_order(row: dict[str, Any]) -> list[str]:
    """What could be brought was brought, or waits for a person with a reason that is told."""
    return [
        f"lost: {line['order']}: {line['why']}"
        for line in row["undelivered"]
        if line["feasible"] and not line["why"].startswith(f"{STUCK} ")
    ]


def keeps_true_books(row: dict[str, Any]) -> list[str]:
    """The store says delivered of what was, and of nothing else."""
    return [f"the store is wrong about {order}" for order in row["believed_otherwise"]]


def keeps_promises(row: dict[str, Any]) -> list[str]:
    """The truck waited where a vehicle in the air had its home."""
    return row["promises_broken"]


def keeps_apart(row: dict[str, Any]) -> list[str]:
    """No two came near in the air; a vehicle that a person flies is not the plan's."""
    near, taken = row["nearest"], any(flight["taken"] for flight in row["flights"])
    if near is None or taken or near["distance_m"] >= NEAREST_M:
        return []
    pair = " and ".join(near["vehicles"])
    return [f"{pair} came to {near['distance_m']:.1f} m at {near['t_s']:.0f} s"]


def keeps_hands_off(row: dict[str, Any]) -> list[str]:
    """Not one command after the companion could know that a person had taken over."""
    return row["commands_after_take_over"]


def nobody_falls(row: dict[str, Any]) -> list[str]:
    """No companion ends that nobody had killed."""
    return [f"ended by itself: {words}" for words in row["ended_by_themselves"]]


ASKS: tuple[Ask, ...] = (
    is_over,
    loses_no_vehicle,
    brings_nothing_twice,
    loses_no_order,
    keeps_true_books,
    keeps_promises,
    keeps_apart,
    keeps_hands_off,
    nobody_falls,
)


def raises_nothing(folder: Path) -> list[str]:
    """No exception in anything that desk, companions and truck wrote."""
    texts = sorted([*folder.rglob("*.log"), *folder.rglob("*.txt")])
    return [
        f"an exception: {path.relative_to(folder)}"
        for path in texts
        if TRACEBACK in path.read_text(errors="replace")
    ]


def wrong_with(row: dict[str, Any], watch: DayWatch, folder: Path) -> list[str]:
    """All that did not hold. A day that was stopped has its one reason."""
    if watch.wrong is not None:
        return [watch.wrong]
    return [words for ask in ASKS for words in ask(row)] + raises_nothing(folder)


@dataclass(frozen=True, slots=True)
class DayFlyer:
    """Flies days, each in a folder of its own under `run_root`."""

    run_root: Path

    def __call__(self, case: DayCase) -> list[TrialRow]:
        """Fly one."""
        return [attempt(case, self.run_root / case.name)]


def attempt(case: DayCase, folder: Path) -> TrialRow:
    """Fly one day and judge it; of a day that held, no folder is left."""
    keep_compiled_code()
    watch = DayWatch()
    try:
        row = _flown(case, folder, watch)
    except Exception as error:  # noqa: BLE001 - desk, truck, companions run here: it is judged
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "exception.txt").write_text(traceback.format_exc())
        why = f"an exception: {type(error).__name__}: {error}"
        return TrialRow(name=case.name, held=False, why=why, told={}, case=case)
    wrong = wrong_with(row, watch, folder)
    if not wrong:
        shutil.rmtree(folder)
    return TrialRow(name=case.name, held=not wrong, why="; ".join(wrong), told=told(row), case=case)


def _flown(case: DayCase, folder: Path, watch: DayWatch) -> dict[str, Any]:
    options = DayOptions(
        name=case.name,
        data=data_of(case),
        wish=case.wish,
        seed=case.seed,
        folder=folder,
        limit_s=LONGEST_S,
        settings=settings_of(path_of(case.site), case.wish, case.searches),
        picture=False,
    )

    def take_seat(built: BuiltDay, where: Path) -> DeskSeat:
        params = PlanParams(trials=case.searches, seed=case.seed)
        plan = plan_day(built.data, first_state(built.data), params, lambda done, best_s: None)
        return DeskHere.open(built, plan, where, case.seed, case.searches)

    return fly_day(options, here(case.loss, folder), take_seat, watch.goes_on)


def told(row: dict[str, Any]) -> dict[str, Any]:
    """What a day came to."""
    flights = row["flights"]
    flown_s = sum((f["land_s"] or row["duration_s"]) - f["launch_s"] for f in flights)
    return {
        "program": row["settings"],
        "minutes": round(row["duration_s"] / 60.0, 1),
        "vehicle_h": row["powered_h"],
        "flown_h": round(flown_s / 3600.0, 4),
        "flights": len(flights),
        "delivered": row["delivered"],
        "orders": row["orders"],
        "taken_over": sum(flight["taken"] for flight in flights),
        "wrong_went": row["what_went_wrong"],
        "stuck": [line for line in row["undelivered"] if line["why"].startswith(STUCK)],
        "nearest_m": row["separation_min_m"],
        "margin_min_wh": row["margin_min_wh"],
        "cpu_s": round(row["spent"]["cpu_s"], 1),
    }


def cases_of(seed: int) -> Iterator[DayCase]:
    """The cases of a trial, without an end."""
    return (drawn(seed, number) for number in itertools.count())


def until_hours(rows: Iterable[TrialRow], vehicle_h: float | None) -> Iterator[TrialRow]:
    """These rows, until vehicles were switched on for so many hours in all."""
    spent_h = 0.0
    for row in rows:
        yield row
        spent_h += row.told.get("vehicle_h", 0.0)
        if vehicle_h is not None and spent_h >= vehicle_h:
            return
