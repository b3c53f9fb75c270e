"""`sim-bridge research`: the paper's experiments, the avoidance policy, and the benchmarks.

The modules here hold the command lines. What a command does is imported when it runs.
"""

import typer

from sim_bridge.research.cli import (
    avoid,
    bench,
    campaign,
    fleet_wind,
    monitor,
    promise,
    rates,
    real_flights,
    results,
    tables,
    windbench,
)

app = typer.Typer(
    no_args_is_help=True,
    help="The paper's experiments, training of the avoidance policy, and benchmarks.",
)

for part in (
    campaign,
    tables,
    promise,
    monitor,
    rates,
    real_flights,
    windbench,
    fleet_wind,
    avoid,
    results,
):
    app.registered_commands += part.app.registered_commands
app.registered_commands += bench.fleet.registered_commands
app.add_typer(bench.app, name="bench")

_SAME_NAME = (
    "campaign", "table1", "table2", "lambda-sweep", "energy-speed", "speed-to-fly", "towns",
    "frontier", "paths", "promise", "avoid", "avoid-table", "avoid-curve", "export-avoid",
    "train-avoid",
)  # fmt: skip
OLD_SPELLINGS: dict[str, tuple[str, ...]] = {name: ("research", name) for name in _SAME_NAME}
OLD_SPELLINGS["bench"] = ("research", "bench", "flight")
"""Commands that were `sim-bridge`'s own, and where they are now. New commands do not join."""
