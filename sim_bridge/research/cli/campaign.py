"""The command line of `sim-bridge research campaign`: outcomes of planners on scenario files."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.running import Cluster, workers_of

app = typer.Typer()


@app.command()
def campaign(
    scenarios: Annotated[list[Path], typer.Argument(help="delivery-scenario/1 files")],
    planner: Annotated[
        list[str], typer.Option(help="ser, rer, ger, ber-paper, ber or clairvoyant; repeat")
    ],
    missions: Annotated[int, typer.Option(help="missions on each scenario")] = 2000,
    seed: Annotated[int, typer.Option(help="of winds and starts")] = 1,
    wind_classes: Annotated[int | None, typer.Option(help="4 or 8: directions seen")] = None,
    max_loss: Annotated[float, typer.Option(help="largest P(loss) that is accepted (ber)")] = 0.01,
    risk_weight: Annotated[float, typer.Option(help="the paper's lambda")] = 1.0,
    curve_factor: Annotated[float, typer.Option(help="the paper's kappa (ber-paper)")] = 1.15,
    metric_flag: Annotated[int, typer.Option(help="0 energy, 1 synthetic length (ber-paper)")] = 0,
    levels: Annotated[int, typer.Option(help="energy levels of ber's tables")] = 500,
    jobs: Annotated[int, typer.Option(help="processes; 0: all cores")] = 0,
    cluster: Cluster = None,
    json: Annotated[Path | None, typer.Option(help="write rows here; resumable")] = None,
) -> None:
    """Fly missions on scenarios with several planners that all meet the same winds."""
    from sim_bridge.research.campaign.campaign import CampaignParams
    from sim_bridge.research.cli.campaign_run import fly_campaign
    from sim_bridge.research.planners.ber_paper import BerPaperParams

    try:
        fly_campaign(
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
            workers_of(_at_least(jobs, 0, "jobs"), cluster),
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
