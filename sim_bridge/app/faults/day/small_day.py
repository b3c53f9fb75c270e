"""The day of the fleet rows: its files, its desks and its fixed plan.

The truck puts both drones out at its first stop and drives slowly to its second stop, where both
land. This second stop is the promised landing site throughout.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from companion.adapters.files.params import bundled_path
from companion.core.base.geo import LocalFrame
from companion.core.base.location import Location
from companion.core.mission.flight_plan import depot_frame
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.outage import Outage
from ground_station.app.desk.truck_dispatcher import TruckDispatcher
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from sim_bridge.app.day.desk import SteppedDesk
from sim_bridge.app.day.world import DeskRecord

LAUNCH_S, LAND_S = 85.0, 185.0
"""Times at which both are ready (ArduPilot needs 60 s for its position) and have landed."""

ARRIVE_S, STOP_DURATION_S = 190.0, 20.0
FIRST_EAST_M, SECOND_EAST_M = 7.0, 77.0
PAD_NORTH_BY_DRONE_M = {"d1": 15.0, "d2": -15.0}
HEIGHT_BY_DRONE_M = {"d1": 20.0, "d2": 32.0}
"""Height layers with the planner's separation of 12 m."""

ENERGY_WH, REQUIRED_WH, USABLE_WH = 12.0, 20.0, 90.0
"""Energies of such a flight with an m100, from its own table, rounded up."""


def read_bundled_day() -> DayData:
    """Read the bundled day."""
    return read_day(bundled_path(Path("faults"), "days", "day"))


def build_fixed_plan(data: DayData) -> DayPlan:
    """Return a plan with one flight for each drone, from the first stop to the second."""
    frame = depot_frame(data.day.depot.location)
    pairs = zip(data.day.drones, data.orders, strict=False)
    return DayPlan(
        format="day-plan/1",
        day=data.day.name,
        policy="by hand",
        seed=0,
        trials=0,
        makespan_s=ARRIVE_S + STOP_DURATION_S,
        stops=[
            PlannedStop(
                id="depot",
                location=_to_geodetic_position(frame, 0.0, 0.0),
                arrive_s=0.0,
                depart_s=0.0,
            ),
            _build_planned_stop(frame, "stop-1", FIRST_EAST_M, 10.0, LAUNCH_S),
            _build_planned_stop(
                frame, "stop-2", SECOND_EAST_M, ARRIVE_S, ARRIVE_S + STOP_DURATION_S
            ),
        ],
        sorties=[_build_planned_sortie(order.id, drone.id) for drone, order in pairs],
    )


def _build_planned_stop(
    frame: LocalFrame, name: str, east_m: float, arrive_s: float, depart_s: float
) -> PlannedStop:
    pads = {
        drone: _to_geodetic_position(frame, north_m, east_m)
        for drone, north_m in PAD_NORTH_BY_DRONE_M.items()
    }
    position = _to_geodetic_position(frame, 0.0, east_m)
    return PlannedStop(id=name, location=position, arrive_s=arrive_s, depart_s=depart_s, pads=pads)


def _build_planned_sortie(order: str, vehicle: str) -> PlannedSortie:
    height_m = HEIGHT_BY_DRONE_M[vehicle]
    return PlannedSortie(
        order=order,
        vehicle=vehicle,
        launch="stop-1",
        home="stop-2",
        launch_s=LAUNCH_S,
        land_s=LAND_S,
        outbound_height_m=height_m,
        return_height_m=height_m,
        energy_wh=ENERGY_WH,
        required_wh=REQUIRED_WH,
        usable_wh=USABLE_WH,
    )


def _to_geodetic_position(frame: LocalFrame, north_m: float, east_m: float) -> Location:
    lat_rad, lon_rad, alt_m = frame.to_geodetic((north_m, east_m, 0.0))
    lat_deg, lon_deg = math.degrees(lat_rad), math.degrees(lon_rad)
    return Location(lat_deg=lat_deg, lon_deg=lon_deg, alt_amsl_m=alt_m)


@dataclass(slots=True)
class OffsetClock:
    """The clock of a desk's computer, with a wall clock error that changes while no desk runs."""

    day_clock: Clock
    offset_s: float = 0.0

    def monotonic_s(self) -> float:
        """Return the day's monotonic time."""
        return self.day_clock.monotonic_s()

    def epoch_us(self) -> int:
        """Return the day's wall time plus the clock error."""
        return self.day_clock.epoch_us() + round(self.offset_s * 1e6)


@dataclass(slots=True)
class TimedOutage(Outage):
    """An outage in which the store is unreachable for all clients until `until_s`."""

    until_s: float = 0.0

    @property
    def is_before_next_retry(self) -> bool:
        """Whether the store is unreachable."""
        return self.clock_s() < self.until_s


DAY_TRANSACTIONS = (
    "assign",
    "release_mission",
    "withdraw",
    "order_recovery",
    "request_home",
    "order_delivery",
    "order_drive",
)
STORE_TRANSACTIONS = ("launch",)
"""Store transactions by which a desk writes its decisions."""


def run_second_desk_before_each_first_write(first: SteppedDesk, second: SteppedDesk) -> None:
    """Force the worst interleaving of two desks: one acts between the other's read and write.

    From now on the second desk runs a cycle before each transaction of the first.
    """
    assert first.desk is not None
    dispatcher = first.desk.dispatcher
    assert isinstance(dispatcher, TruckDispatcher)
    for owner, names in (
        (dispatcher.day, DAY_TRANSACTIONS),
        (dispatcher.store, STORE_TRANSACTIONS),
    ):
        for name in names:
            setattr(owner, name, _prepend_second_desk_update(second, getattr(owner, name)))


def _prepend_second_desk_update(
    second_desk: SteppedDesk, write: Callable[..., Any]
) -> Callable[..., Any]:
    def write_after_second(*arguments: Any, **keyword_arguments: Any) -> Any:
        second_desk.run_desk_cycle()
        return write(*arguments, **keyword_arguments)

    return write_after_second


@dataclass(slots=True)
class SmallDayDesks:
    """A `SimulatedDesk` with one or more desks. The day also lasts until the procedure is over.

    `desks`: the first writes the day's log.
    """

    desks: list[SteppedDesk]
    clock: OffsetClock
    """Clock of the first desk."""
    is_procedure_running: bool = True
    """Whether the fault procedure is still running."""

    @property
    def first_desk(self) -> SteppedDesk:
        """The desk that started the day."""
        return self.desks[0]

    def start_second_desk(self, clock: OffsetClock) -> None:
        """Start a second desk on the same store, which wins every race."""
        second = self.first_desk.start_second_desk("second-desk", clock)
        self.desks.append(second)
        run_second_desk_before_each_first_write(self.first_desk, second)

    def run_desk_cycle(self) -> None:
        """Run one cycle of each desk."""
        for desk in self.desks:
            desk.run_desk_cycle()

    def kill(self) -> None:
        """Kill the first desk (SIGKILL)."""
        self.first_desk.kill()

    def restart(self) -> None:
        """Restart the first desk."""
        self.first_desk.restart()

    @property
    def is_done(self) -> bool:
        """Whether all desks have finished and the procedure is over."""
        return not self.is_procedure_running and all(desk.is_done for desk in self.desks)

    def build_desk_record(self) -> DeskRecord:
        """Return the first desk's view of the day, with the unexpected exits of all desks."""
        unexpected_exits = [message for desk in self.desks for message in desk.unexpected_exits]
        return replace(self.first_desk.build_desk_record(), unexpected_exits=unexpected_exits)

    def close(self) -> None:
        """Shut all desks down in order."""
        for desk in self.desks:
            desk.close()
