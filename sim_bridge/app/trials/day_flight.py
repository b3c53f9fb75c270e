"""Flies a drawn day; apart, for it imports the planner, whose machine code is kept."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_state import first_state
from sim_bridge.app.day.build import BuiltDay, here
from sim_bridge.app.day.desk import DeskHere
from sim_bridge.app.day.fly import LONGEST_S, settings_of
from sim_bridge.app.day.run import DayOptions, DeskSeat, fly_day
from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.trials.day_case import DayCase, data_of, path_of


def flown(case: DayCase, folder: Path, goes_on: Callable[[DayWorld], bool]) -> dict[str, Any]:
    """The day's row; `goes_on` is asked once a second."""
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

    return fly_day(options, here(case.loss, folder), take_seat, goes_on)
