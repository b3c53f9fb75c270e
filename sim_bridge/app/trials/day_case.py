"""A whole day as a case of a trial: drawn from a seed, of a shipped site's orders."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from companion.adapters.files.params import bundled_path
from ground_station.adapters.files.day_files import read_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.order_states import Service
from sim_bridge.app.day.faults import AUTOPILOTS, CUT_S, MEMBER_CUT_S, DayWish

SITES = ("harbour", "town")
FAR_SITE, FAR_SHARE = "villages", 0.25
"""No stop reaches all of its orders, and no drone from the depot: days with a truck only."""

SQLITE, POSTGRESQL = STORES = ("sqlite", "postgresql")
MOST_VEHICLES = 6
MOST_ORDERS_EACH = 4
"""Orders of a day are at most so many for each vehicle: some forty minutes, three turns each."""

LEAST_ORDERS_FOR_ALL = 2
"""With fewer a day may be over before all faults have come."""

LONGEST_FRONT_MPS = 4.0
"""Twice the std of the shipped forecasts: what a desk that plans with them must live with."""


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
    truck: bool = True
    """Else the drones start from the depot, and the desk has no plan."""
    store: str = SQLITE
    store_outages: int = 0
    member_cuts: int = 0
    """How often one member alone is cut off."""
    least_cut_s: float = CUT_S[0]
    """The shortest cut of the network."""

    @property
    def name(self) -> str:
        """Names run folder and case file."""
        kind = "" if self.truck else "-depot"
        return f"days-{self.site}{kind}-{self.store}-seed{self.seed}"

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
            truck=self.truck,
            store_outages=self.store_outages,
            member_cuts=self.member_cuts,
            least_cut_s=self.least_cut_s,
        )


def drawn(
    seed: int,
    number: int,
    most_vehicles: int = MOST_VEHICLES,
    most_orders_each: int = MOST_ORDERS_EACH,
    least_orders: int = 1,
    truck: bool | None = None,
) -> DayCase:
    """The case of this number, of a trial with this seed; smaller days where bounds say so.

    `truck`: with one or without; None: drawn too. What is new is drawn last, so that the same
    number stays the same day in all else.
    """
    rng = np.random.default_rng([seed, number])
    site = str(rng.choice(SITES))
    vehicles = int(rng.integers(1, most_vehicles + 1))
    known = [order.id for order in read_day(path_of(site)).orders]
    most = min(most_orders_each * vehicles, len(known))
    count = int(rng.integers(min(least_orders, most), most + 1))
    case = DayCase(
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
        truck=bool(rng.random() < 0.5),
        store_outages=int(rng.integers(0, 3)),
        member_cuts=int(rng.integers(0, 3)),
    )
    if truck is not None:
        case = msgspec.structs.replace(case, truck=truck)
    return _at_the_far_site(case, rng) if case.truck and rng.random() < FAR_SHARE else case


def _at_the_far_site(case: DayCase, rng: np.random.Generator) -> DayCase:
    """As many of the orders of that site."""
    known = [order.id for order in read_day(path_of(FAR_SITE)).orders]
    chosen = rng.choice(known, min(len(case.orders), len(known)), replace=False)
    orders = tuple(sorted(map(str, chosen)))
    return msgspec.structs.replace(case, site=FAR_SITE, orders=orders)


def with_all_faults(case: DayCase) -> DayCase:
    """This day with each kind of kill and cut once at least, and no cut under a minute."""
    return msgspec.structs.replace(
        case,
        ground_kills=max(case.ground_kills, 1),
        companion_kills=max(case.companion_kills, 1),
        store_outages=max(case.store_outages, 1),
        network_cuts=max(case.network_cuts, 1),
        least_cut_s=MEMBER_CUT_S[0],
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
