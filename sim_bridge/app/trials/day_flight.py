"""Runs a drawn day. A separate module, because it imports the planner, which is compiled."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ground_station.adapters.store.check import find_store_faults
from sim_bridge.adapters.postgres_server import running_postgres_server
from sim_bridge.app.day.desk import SteppedDesk
from sim_bridge.app.day.fly import compute_day_inputs_digest, plan_whole_day
from sim_bridge.app.day.run import DayOptions, fly_day_and_write_result
from sim_bridge.app.day.store_host import PostgresHost, SqliteHost, StoreHost
from sim_bridge.app.day.world import DayWorld, SimulatedDesk
from sim_bridge.app.trials.day_case import POSTGRESQL, DayCase, build_day_data, bundled_day_path


def fly_day_case_and_check_store(
    case: DayCase, folder: Path, should_continue: Callable[[DayWorld], bool]
) -> dict[str, Any]:
    """Fly the day; return its row and the faults that `ground-station store check` finds after it.
    `should_continue` is called once per second.
    """
    options = DayOptions(
        name=case.name,
        data=build_day_data(case),
        world_options=case.world_options,
        seed=case.seed,
        folder=folder,
        settings=compute_day_inputs_digest(
            bundled_day_path(case.site), case.world_options, case.searches
        ),
    )
    with ExitStack() as stack:
        host: StoreHost = SqliteHost(folder)
        if case.store == POSTGRESQL:  # its own server; LeewayError if none is installed
            server = stack.enter_context(running_postgres_server())
            host = PostgresHost(server, server.create_database("day"))

        def open_desk(world: DayWorld, desk_folder: Path) -> SimulatedDesk:
            if not case.truck:
                return SteppedDesk.start_depot_desk(world, desk_folder, host=host)
            plan = plan_whole_day(world.data, case.seed, case.searches)
            return SteppedDesk.start_truck_desk(
                world, plan, desk_folder, case.seed, case.searches, host=host
            )

        row = fly_day_and_write_result(options, open_desk, should_continue, host)
        return row | {"store_faults": find_store_faults(host.url)}
