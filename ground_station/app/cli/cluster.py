"""`ground-station cluster`: the day's customers in groups, by any of the methods."""

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.cli.options import DayArgument, open_day

if TYPE_CHECKING:
    from rich.console import Console

    from ground_station.core.clustering.problem import Clustered, ClusteringProblem

app = typer.Typer()


class MethodName(StrEnum):
    """The clustering method."""

    OURS = "ours"
    KMEANS = "kmeans"
    NONE = "none"
    LLM = "llm"


@app.command()
def cluster(
    day: DayArgument,
    method: Annotated[MethodName, typer.Option(help="Clustering method.")] = MethodName.OURS,
    groups: Annotated[int, typer.Option(min=1, help="Number of groups to aim at.")] = 3,
    voltage: Annotated[
        float | None, typer.Option(min=1.0, help="Resting voltage of the weakest drone, V.")
    ] = None,
    llm_url: Annotated[
        str | None, typer.Option(help="An OpenAI-compatible server: http://HOST:PORT/v1.")
    ] = None,
    llm_model: Annotated[str | None, typer.Option(help="The model's name there.")] = None,
    llm_key: Annotated[Path | None, typer.Option(help="A file with the key, if any.")] = None,
    llm_timeout: Annotated[
        float, typer.Option(min=1.0, help="Time-out of the LLM, s; then ours is used.")
    ] = 30.0,
    llm_log: Annotated[
        Path, typer.Option(help="Prompt, answer and repair are appended to this file.")
    ] = Path("llm.jsonl"),
) -> None:
    """Group the day's customers. A method's proposal is checked and repaired before it is used.

    ground-station cluster harbour --method ours --groups 2
    """
    from rich.console import Console

    from ground_station.adapters.llm import LlmParams
    from ground_station.app.planning.clusters import BUILT_IN, cluster_by_llm, problem_of

    data = open_day(day)
    console = Console()
    with console.status("energy of every delivery from every stop"):
        problem = problem_of(data, groups, voltage)
    if method is MethodName.LLM:
        if llm_url is None or llm_model is None:
            raise LeewayError("--method llm: expected --llm-url and --llm-model")
        key = _key(llm_key)
        with console.status(f"asking {llm_model}"):
            params = LlmParams(llm_url, llm_model, key, llm_timeout)
            made = cluster_by_llm(problem, params, llm_log)
    else:
        made = BUILT_IN[method.value](problem)
    _show(console, problem, made)


def _show(console: "Console", problem: "ClusteringProblem", made: "Clustered") -> None:
    from ground_station.app.views.terminal import listing

    index = problem.index()
    table = listing("stop", "customers", "kg", "mean Wh", title=f"by {made.method}")
    total_wh = 0.0
    for group in made.clusters:
        mine = [index[id_] for id_ in group.customers]
        wh = sum(float(problem.energy_wh[index[group.stop], i]) for i in mine)
        total_wh += wh
        words = f"{wh:.0f}" if math.isfinite(wh) else "out of reach"
        mass_kg = float(problem.mass_kg[mine].sum())
        table.add_row(group.stop, ", ".join(group.customers), f"{mass_kg:g}", words)
    console.print(table)
    seen = problem.conditions
    to_n, to_e = seen.wind_to_ne_mps
    typer.echo(
        f"coverage {seen.coverage_m:.0f} m, wind to ({to_n:.1f}, {to_e:.1f}) m/s,"
        f" voltage {seen.voltage_v or 'unknown'}, lines blocked {100 * seen.obstacle_frac:.0f} %"
    )
    for note in made.notes:
        typer.echo(note)


def _key(path: Path | None) -> str | None:
    if path is None:
        return None
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LeewayError(
            f"{path}: expected an ASCII key, but byte {error.start} is not ASCII"
        ) from error
