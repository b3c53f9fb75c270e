"""`ground-station cluster`: group the day's customers by one of the methods."""

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.desk_options import DayArgument, read_day_and_warn

if TYPE_CHECKING:
    from rich.console import Console

    from ground_station.core.clustering.problem import Clustering, ClusteringProblem

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
        float,
        typer.Option(min=1.0, help="Timeout of the LLM, s; then the built-in method is used."),
    ] = 30.0,
    llm_log: Annotated[
        Path, typer.Option(help="Prompt, answer and repair are appended to this file.")
    ] = Path("llm.jsonl"),
) -> None:
    """Group the day's customers by stop, to compare clustering methods; `plan` uses no groups.

    A method's proposal is checked and repaired before it is used.

    ground-station cluster harbour --method ours --groups 2
    """
    from ground_station.adapters.llm import LlmParams
    from ground_station.app.planning.clusters import (
        METHODS,
        build_clustering_problem,
        cluster_by_llm_or_energy,
    )
    from ground_station.app.views.terminal import plain_console

    data = read_day_and_warn(day)
    console = plain_console()
    with console.status("energy of every delivery from every stop"):
        problem = build_clustering_problem(data, groups, voltage)
    if method is MethodName.LLM:
        if llm_url is None or llm_model is None:
            raise LeewayError("--method llm: expected --llm-url and --llm-model")
        key = _read_api_key(llm_key)
        with console.status(f"waiting for {llm_model}"):
            params = LlmParams(llm_url, llm_model, key, llm_timeout)
            result = cluster_by_llm_or_energy(problem, params, llm_log)
    else:
        result = METHODS[method.value](problem)
    _print_groups(console, problem, result)


def _print_groups(console: "Console", problem: "ClusteringProblem", result: "Clustering") -> None:
    from ground_station.app.views.terminal import plain_table

    index = problem.customer_index_by_id()
    table = plain_table("stop", "customers", "kg", "mean Wh", title=f"by {result.method}")
    total_wh = 0.0
    for group in result.clusters:
        indices = [index[id_] for id_ in group.customers]
        wh = sum(float(problem.energy_wh[index[group.stop], i]) for i in indices)
        total_wh += wh
        energy_text = f"{wh:.0f}" if math.isfinite(wh) else "out of reach"
        mass_kg = float(problem.mass_kg[indices].sum())
        table.add_row(group.stop, ", ".join(group.customers), f"{mass_kg:g}", energy_text)
    console.print(table)
    seen = problem.conditions
    to_n, to_e = seen.wind_to_ne_mps
    speed_mps, from_deg = math.hypot(to_n, to_e), math.degrees(math.atan2(-to_e, -to_n)) % 360.0
    typer.echo(
        f"coverage {seen.coverage_m:.0f} m, wind from {from_deg:.0f} deg, {speed_mps:.1f} m/s,"
        f" voltage {seen.voltage_v or 'unknown'}, {seen.obstacle_frac:.0%} of direct routes blocked"
    )
    for note in result.notes:
        typer.echo(note)


def _read_api_key(path: Path | None) -> str | None:
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
