"""What `sim-bridge research campaign` does; imported when it runs, not for `--help`."""

import sys
from pathlib import Path

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import Workers
from sim_bridge.research.campaign.campaign import PLANNERS, CampaignParams, CampaignRow
from sim_bridge.research.campaign.campaign_runner import campaign_journal, run
from sim_bridge.research.cli.running import INTERRUPTED, LOST, progress_bar, say_of, write_whole
from sim_bridge.research.planners.scenario import LogWind, Scenario, parse_scenario


def fly_campaign(
    paths: list[Path],
    planners: list[str],
    params: CampaignParams,
    workers: Workers,
    out: Path | None,
) -> None:
    """Fly it, write the rows to `out` and print them; LeewayError for a mistake in the input.

    Rows that lost a worker twice are named instead, and the exit code is 1.
    """
    scenarios = [read_scenario(path) for path in paths]
    planners = list(dict.fromkeys(planners))
    _check_planners(planners, scenarios)
    if out is not None and not out.parent.is_dir():
        raise LeewayError(f"{out}: its folder does not exist")
    journal = None if out is None else campaign_journal(out, scenarios, planners, params)
    with progress_bar() as bar:
        shown = bar.add_task("campaign", total=None)
        try:
            flown = run(
                scenarios,
                planners,
                params,
                workers,
                journal,
                lambda done, total: bar.update(shown, completed=done, total=total),
                say_of(bar),
            )
        except KeyboardInterrupt:
            kept = (
                f"; {journal.path} keeps what is done, the same command goes on" if journal else ""
            )
            bar.console.print(f"stopped{kept}", highlight=False, soft_wrap=True)
            raise typer.Exit(INTERRUPTED) from None
    if out is not None:
        write_whole(out, msgspec.json.format(msgspec.json.encode({"rows": flown.rows}), indent=1))
    print_rows(flown.rows)
    for words in flown.lost:
        typer.echo(f"lost: {words}", err=True)
    if flown.lost:
        kept = f"; {journal.path} keeps the others, the same command tries again" if journal else ""
        typer.echo(f"rows without a lost task: {len(flown.rows)}{kept}", err=True)
        raise typer.Exit(LOST)
    if journal is not None:
        journal.remove()


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


def print_rows(rows: list[CampaignRow]) -> None:
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
