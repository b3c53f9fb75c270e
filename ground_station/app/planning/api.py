"""Functions of the Python interface that read and plan days (docs/reference/api.md)."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from companion.core.base.errors import LeewayError
from ground_station.adapters.files import day_files
from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from ground_station.adapters.files.params import resolve_day_file_path
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import initial_state


def read_day(path: str | Path) -> DayData:
    """Read a `day/1` file, or a bundled day by its name, with all files that it names.

    Raises LeewayError with all problems of these files.
    """
    return day_files.read_day(resolve_day_file_path(str(path)))


def plan_day(
    day: str | Path | DayData,
    *,
    trials: int | None = None,
    seed: int = 0,
    policy: Literal["search", "dynamic"] = "search",
    on_progress: Callable[[float, float], None] | None = None,
) -> DayPlan:
    """Plan a day with a truck: its stops, drone sorties and undeliverable orders.

    The same day, seed and trials give the same plan. `trials` None: by the number of orders.
    `on_progress`: called with the completed share of the search and the best makespan (s).
    """
    if policy not in ("search", "dynamic"):
        raise LeewayError(f"policy {policy!r}: expected search or dynamic")
    data = day if isinstance(day, DayData) else read_day(day)
    enable_compile_cache_and_check_if_known()
    # After the compile cache is enabled: it contains compiled code.
    from ground_station.core.planning.day_planner import PlanParams
    from ground_station.core.planning.day_planner import plan_day as plan_from_state

    params = PlanParams(policy, trials, seed)
    return plan_from_state(
        data, initial_state(data), params, on_progress or (lambda done_frac, best_s: None)
    )
