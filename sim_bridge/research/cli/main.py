"""`sim-bridge research`: the paper's experiments, the avoidance policy, and the benchmarks.

The modules here hold the command lines. What a command does is imported when it runs.
"""

import typer

from sim_bridge.research.cli import avoid, bench, paper, studies

app = typer.Typer(
    no_args_is_help=True,
    help="The paper's experiments, training of the avoidance policy, and benchmarks.",
)

for commands in (paper.app, studies.app, avoid.app, bench.fleet):
    app.registered_commands += commands.registered_commands
app.add_typer(bench.app, name="bench")
