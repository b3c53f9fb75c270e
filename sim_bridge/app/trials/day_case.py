"""Case of a whole day, drawn from a seed and from the orders of a bundled site."""

import dataclasses
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from companion.adapters.files.params import bundled_path
from ground_station.adapters.files.day_files import read_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.order_states import Service
from sim_bridge.app.day.faults import (
    MEMBER_CUT_RANGE_S,
    NETWORK_CUT_RANGE_S,
    DayWorldOptions,
)
from sim_bridge.autopilot.kinds import AUTOPILOTS

SITES = ("harbour", "town")
FAR_SITE, FAR_SITE_FRAC = "villages", 0.25
"""No single stop and no drone from the depot reaches all orders: only for truck days."""

SQLITE, POSTGRESQL = STORE_KINDS = ("sqlite", "postgresql")
MAX_VEHICLES = 6
MAX_ORDERS_PER_VEHICLE = 4
"""Maximum orders of a day per vehicle: about 40 minutes with three flights each."""

MIN_ORDERS_WITH_ALL_FAULTS = 2
"""With fewer orders a day can end before all faults have occurred."""

MAX_FRONT_MPS = 4.0
"""Twice the std of the bundled forecasts."""


class DayCase(msgspec.Struct, frozen=True, kw_only=True):
    """All inputs of one day. `orders` are identifiers of the site's orders."""

    seed: int
    site: str
    autopilots: tuple[str, ...]
    """One autopilot for each vehicle."""
    orders: tuple[str, ...]
    drones_only: bool
    """The driver delivers nothing; otherwise the plan gives small days to the truck."""
    forecast_mps: float
    forecast_from_deg: float
    front_mps: float
    """Strength of a gust front that is not in the forecast; 0: no front."""
    charge_frac: float
    temperature_c: float
    loss: float
    network_cuts: int
    companion_kills: int
    ground_kills: int
    take_overs: int
    truck_late_s: float
    searches: int
    """Number of trials of the plan search."""
    truck: bool = True
    """False: the drones start from the depot, and the desk has no plan."""
    store: str = SQLITE
    store_outages: int = 0
    member_cuts: int = 0
    """Number of network cuts of a single member."""
    least_cut_s: float = NETWORK_CUT_RANGE_S[0]
    """Shortest network cut."""

    @property
    def name(self) -> str:
        """Names run folder and case file."""
        kind = "" if self.truck else "-depot"
        return f"days-{self.site}{kind}-{self.store}-seed{self.seed}"

    @property
    def world_options(self) -> DayWorldOptions:
        """Requested faults, for the simulated day."""
        known = set(self.__struct_fields__)
        names = (one.name for one in dataclasses.fields(DayWorldOptions) if one.name in known)
        given = {name: getattr(self, name) for name in names}
        return DayWorldOptions(passing_front_mps=self.front_mps, **given)


def draw_case(
    seed: int,
    case_number: int,
    max_vehicles: int = MAX_VEHICLES,
    max_orders_per_vehicle: int = MAX_ORDERS_PER_VEHICLE,
    min_orders: int = 1,
    has_truck: bool | None = None,
) -> DayCase:
    """Draw case `case_number` of the trial with this seed, within the given bounds.

    `has_truck`: with or without a truck; None: drawn. New properties are drawn last, so that a
    number keeps its other properties.
    """
    rng = np.random.default_rng([seed, case_number])
    site = str(rng.choice(SITES))
    vehicles = int(rng.integers(1, max_vehicles + 1))
    known = [order.id for order in read_day(bundled_day_path(site)).orders]
    max_orders = min(max_orders_per_vehicle * vehicles, len(known))
    count = int(rng.integers(min(min_orders, max_orders), max_orders + 1))
    case = DayCase(
        seed=1000 * seed + case_number,
        site=site,
        autopilots=tuple(map(str, rng.choice(AUTOPILOTS, vehicles))),
        orders=tuple(sorted(map(str, rng.choice(known, count, replace=False)))),
        drones_only=bool(rng.random() < 0.7),
        forecast_mps=round(float(rng.uniform(0.0, 8.0)), 1),
        forecast_from_deg=round(float(rng.uniform(0.0, 360.0)), 0),
        front_mps=_draw_or_zero(rng, 0.3, 1.0, MAX_FRONT_MPS),
        charge_frac=round(float(rng.uniform(0.85, 1.0)), 2),
        temperature_c=round(float(rng.uniform(-5.0, 35.0)), 0),
        loss=_draw_or_zero(rng, 0.6, 0.01, 0.3),
        network_cuts=int(rng.integers(0, 3)),
        companion_kills=int(rng.integers(0, 3)),
        ground_kills=int(rng.integers(0, 3)),
        take_overs=int(rng.random() < 0.3),
        truck_late_s=_draw_or_zero(rng, 0.3, 20.0, 240.0),
        searches=200,
        truck=bool(rng.random() < 0.5),
        store_outages=int(rng.integers(0, 3)),
        member_cuts=int(rng.integers(0, 3)),
    )
    if has_truck is not None:
        case = msgspec.structs.replace(case, truck=has_truck)
    return _move_to_far_site(case, rng) if case.truck and rng.random() < FAR_SITE_FRAC else case


def _move_to_far_site(case: DayCase, rng: np.random.Generator) -> DayCase:
    """Move the case to the far site, with the same number of orders if available."""
    known = [order.id for order in read_day(bundled_day_path(FAR_SITE)).orders]
    selected_ids = rng.choice(known, min(len(case.orders), len(known)), replace=False)
    orders = tuple(sorted(map(str, selected_ids)))
    return msgspec.structs.replace(case, site=FAR_SITE, orders=orders)


def with_at_least_one_fault_of_each_kind(case: DayCase) -> DayCase:
    """Return the day with at least one fault of each kind, and no network cut under a minute."""
    return msgspec.structs.replace(
        case,
        ground_kills=max(case.ground_kills, 1),
        companion_kills=max(case.companion_kills, 1),
        store_outages=max(case.store_outages, 1),
        network_cuts=max(case.network_cuts, 1),
        least_cut_s=MEMBER_CUT_RANGE_S[0],
    )


def _draw_or_zero(rng: np.random.Generator, probability: float, low: float, high: float) -> float:
    """Return a value between the bounds with probability `probability`, else 0."""
    is_nonzero, value = rng.random() < probability, float(rng.uniform(low, high))
    return round(value, 2) if is_nonzero else 0.0


def bundled_day_path(site_name: str) -> Path:
    """Return the path of the bundled day with this name."""
    return bundled_path(Path(site_name), "days", "day")


def build_day_data(case: DayCase) -> DayData:
    """Return the site's day with the fleet, orders and forecast of this case."""
    data = read_day(bundled_day_path(case.site))
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
