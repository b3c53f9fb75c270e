"""Flies a drawn day; apart, for it imports the planner, whose machine code is kept."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ground_station.adapters.store.check import check
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_state import first_state
from sim_bridge.adapters.postgres_server import postgres_server
from sim_bridge.app.day.build import BuiltDay, here
from sim_bridge.app.day.desk import DeskHere
from sim_bridge.app.day.fly import LONGEST_S, settings_of
from sim_bridge.app.day.run import DayOptions, DeskSeat, fly_day
from sim_bridge.app.day.store_host import PostgresHost, SqliteHost, StoreHost
from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.trials.day_case import POSTGRESQL, DayCase, data_of, path_of


def flown(case: DayCase, folder: Path, goes_on: Callable[[DayWorld], bool]) -> dict[str, Any]:
    """The day's row, and what `ground-station store check` finds in the store that it leaves;
    `goes_on` is asked once a second.
    """
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
    with store_of(case, folder) as host:

        def take_seat(built: BuiltDay, where: Path) -> DeskSeat:
            if not case.truck:
                return DeskHere.at_depot(built, where, host=host)
            params = PlanParams(trials=case.searches, seed=case.seed)
            plan = plan_day(built.data, first_state(built.data), params, lambda done, best_s: None)
            return DeskHere.open(built, plan, where, case.seed, case.searches, host=host)

        row = fly_day(options, here(case.loss, folder), take_seat, goes_on, host)
        return row | {"store_faults": check(host.url)}


@contextmanager
def store_of(case: DayCase, folder: Path) -> Iterator[StoreHost]:
    """Where the day's desk keeps its store: a file, or a server of PostgreSQL of its own.

    Raises LeewayError where no server is installed.
    """
    if case.store != POSTGRESQL:
        yield SqliteHost(folder)
        return
    with postgres_server() as server:
        yield PostgresHost(server, server.create_database("day"))
