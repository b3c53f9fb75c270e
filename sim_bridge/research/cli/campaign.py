"""`sim-bridge campaign`: outcomes of planners on scenario files (`evaluation.md`, 3)."""

import os
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from companion.core.base.errors import LeewayError
from companion.core.routing.scenario import LogWind, Scenario, parse_scenario
from sim_bridge.research.campaign.campaign import PLANNERS, CampaignParams, Row
from sim_bridge.research.campaign.campaign_runner import (
    Executor,
    InProcess,
    Pool,
    RayCluster,
    campaign_journal,
    run,
)
from sim_bridge.research.planners.ber_paper import BerPaperParams

app = typer.Typer(add_completion=False, no_args_is_help=True)

INTERRUPTED = 130  # the shell's code for a program that Ctrl-C ended


@app.command()
def campaign(
    scenarios: Annotated[list[Path], typer.Argument(help="delivery-scenario/1 files")],
    planner: Annotated[list[str], typer.Option(help=f"one of {', '.join(PLANNERS)}; repeat")],
    missions: Annotated[int, typer.Option(help="missions on each scenario")] = 2000,
    seed: Annotated[int, typer.Option(help="of winds and starts")] = 1,
    wind_classes: Annotated[int | None, typer.Option(help="4 or 8: directions seen")] = None,
    max_loss: Annotated[float, typer.Option(help="largest P(loss) that is accepted (ber)")] = 0.01,
    risk_weight: Annotated[float, typer.Option(help="the paper's lambda")] = 1.0,
    curve_factor: Annotated[float, typer.Option(help="the paper's kappa (ber-paper)")] = 1.15,
    metric_flag: Annotated[int, typer.Option(help="0 energy, 1 synthetic length (ber-paper)")] = 0,
    levels: Annotated[int, typer.Option(help="energy levels of ber's tables")] = 500,
    jobs: Annotated[int, typer.Option(help="processes; 0: all cores")] = 0,
    ray: Annotated[str | None, typer.Option(help="Ray cluster address, or 'local'")] = None,
    json: Annotated[Path | None, typer.Option(help="write rows here; resumable")] = None,
) -> None:
    """Fly missions on scenarios with several planners that all meet the same winds."""
    try:
        _campaign(
            scenarios,
            planner,
            CampaignParams(
                missions=missions,
                seed=seed,
                wind_classes=wind_classes,
                max_loss=max_loss,
                risk_weight=risk_weight,
                levels=_at_least(levels, 2, "levels"),
                paper=BerPaperParams(curve_factor=curve_factor, metric_flag=_flag(metric_flag)),
            ),
            _at_least(jobs, 0, "jobs"),
            ray,
            json,
        )
    except LeewayError as error:
        typer.echo(f"sim-bridge campaign: {error}", err=True)
        raise typer.Exit(2) from None


def _at_least(value: int, least: int, key: str) -> int:
    if value < least:
        raise LeewayError(f"{key} = {value}: expected {least} or more")
    return value


def _flag(value: int) -> int:
    if value not in (0, 1):
        raise LeewayError(f"metric flag = {value}: expected 0 or 1")
    return value


def _campaign(
    paths: list[Path],
    planners: list[str],
    params: CampaignParams,
    jobs: int,
    ray: str | None,
    out: Path | None,
) -> None:
    scenarios = [read_scenario(path) for path in paths]
    planners = list(dict.fromkeys(planners))
    _check_planners(planners, scenarios)
    if out is not None and not out.parent.is_dir():
        raise LeewayError(f"{out}: its folder does not exist")
    journal = None if out is None else campaign_journal(out, scenarios, planners, params)
    console = Console(stderr=True)
    with Progress(
        TextColumn("campaign"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    ) as bar:
        shown = bar.add_task("campaign", total=None)
        try:
            rows = run(
                scenarios,
                planners,
                params,
                _executor(scenarios, params, jobs, ray),
                journal,
                lambda done, total: bar.update(shown, completed=done, total=total),
                lambda note: console.print(note, highlight=False),
            )
        except KeyboardInterrupt:
            kept = (
                f"; {journal.path} keeps what is done, the same command goes on" if journal else ""
            )
            console.print(f"stopped{kept}", highlight=False, soft_wrap=True)
            raise typer.Exit(INTERRUPTED) from None
    if out is not None and journal is not None:
        write_whole(out, msgspec.json.format(msgspec.json.encode({"rows": rows}), indent=1))
        journal.remove()
    print_rows(rows)


def _executor(
    scenarios: list[Scenario], params: CampaignParams, jobs: int, ray: str | None
) -> Executor:
    if ray is not None:
        return RayCluster(scenarios, params, None if ray == "local" else ray)
    count = jobs or len(os.sched_getaffinity(0))
    return InProcess(scenarios, params) if count == 1 else Pool(scenarios, params, count)


def _check_planners(planners: list[str], scenarios: list[Scenario]) -> None:
    for name in planners:
        if name not in PLANNERS:
            raise LeewayError(f"planner {name!r}: expected one of {', '.join(PLANNERS)}")
    chains = [s.name for s in scenarios if not isinstance(s.wind, LogWind)]
    if "clairvoyant" in planners and chains:
        raise LeewayError(f"planner clairvoyant: {chains[0]} has no recorded wind to foresee")


def read_scenario(path: Path) -> Scenario:
    """The scenario in a file; LeewayError in one line naming file and place."""
    try:
        return parse_scenario(path.read_bytes(), str(path))
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from None


def write_whole(path: Path, content: bytes) -> None:
    """Write a file at once: a reader sees the old one or the new one."""
    part = path.with_name(path.name + ".part")
    part.write_bytes(content)
    part.replace(path)


def print_rows(rows: list[Row]) -> None:
    """The rows as a table on stdout."""
    table = Table(box=None, header_style="bold")
    for head in ("scenario", "planner", "missions", "SUC %", "DEL %", "FAIL %", "ABRT %"):
        table.add_column(head, justify="left" if head in ("scenario", "planner") else "right")
    for head in ("loss %", "energy Wh", "margin Wh", "time s", "decision us"):
        table.add_column(head, justify="right")
    for row in rows:
        shares = [f"{100.0 * n / row.missions:.2f}" for n in (row.SUC, row.DEL, row.FAIL, row.ABRT)]
        table.add_row(
            row.scenario,
            row.planner,
            str(row.missions),
            *shares,
            f"{100.0 * row.loss:.3f}",
            f"{row.energy_wh_mean:.1f}",
            "-" if row.margin_wh_mean is None else f"{row.margin_wh_mean:.1f}",
            f"{row.time_s_mean:.0f}",
            f"{row.decision_us_median:.0f}",
        )
    Console(width=160 if not sys.stdout.isatty() else None).print(table)
