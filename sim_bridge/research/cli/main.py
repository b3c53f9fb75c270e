"""`sim-bridge research`: the paper's experiments, the avoidance policy, and the benchmarks.

The modules here hold the command lines. What a command does is imported when it runs.
"""

import typer

from sim_bridge.research.cli import avoid, bench, campaign, promise, results, tables

app = typer.Typer(
    no_args_is_help=True,
    help="The paper's experiments, training of the avoidance policy, and benchmarks.",
)

for part in (campaign, tables, promise, avoid, results):
    app.registered_commands += part.app.registered_commands
app.add_typer(bench.app, name="bench")

BENCHMARKS = {
    "bench": "flight",
    "bench-dispatch": "dispatch",
    "planner-bench": "planner",
    "estimator-bench": "estimator",
    "paths-bench": "paths",
    "avoid-bench": "avoid",
}
"""How the benchmarks were called when they were commands of `sim-bridge` itself."""


def old_spellings() -> dict[str, tuple[str, ...]]:
    """Commands that were `sim-bridge`'s own, and where they are now."""
    names = (info.name or _dashed(info.callback) for info in app.registered_commands)
    moved: dict[str, tuple[str, ...]] = {name: ("research", name) for name in names}
    return moved | {old: ("research", "bench", new) for old, new in BENCHMARKS.items()}


def _dashed(command: object) -> str:
    return getattr(command, "__name__", "").replace("_", "-")
