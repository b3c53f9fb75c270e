"""`sim-bridge research monitor`: how often does the monitor in service alarm, and when?"""

from pathlib import Path
from typing import Annotated

import typer

from sim_bridge.research.cli.running import write_whole

app = typer.Typer()


@app.command()
def monitor(
    services: Annotated[
        int, typer.Option(min=100, help="Services of 500 flights in which nothing is wrong.")
    ] = 10_000,
    seed: Annotated[int, typer.Option(min=0, help="Of all draws.")] = 1,
    json: Annotated[Path | None, typer.Option(help="Write all figures here.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for tables and the picture.")] = Path(
        "logs/monitor"
    ),
) -> None:
    """Follow simulated services by the companion's own bets, on draws of days and flights.

    Example: sim-bridge research monitor --services 10000 --seed 1 --out logs/monitor
    """
    import msgspec

    from sim_bridge.research.monitor import cost, sheets, study
    from sim_bridge.research.monitor.worlds import Season

    out.mkdir(parents=True, exist_ok=True)
    alarms = list(study.false_alarms(services, seed))
    found = list(study.times_to_find(seed))
    lost = list(study.losses(max(services // 10, 100), seed))
    spent = cost.flight_cost()
    tables = (
        (sheets.false_alarm_sheet(alarms, Season().flights), "false_alarms"),
        (sheets.found_sheet(found), "found"),
        (sheets.loss_sheet(lost), "losses"),
        (sheets.cost_sheet(spent), "cost"),
    )
    for sheet, stem in tables:
        sheet.write(out, stem)
        typer.echo(sheet.markdown())
    sheets.draw_fading_pack(seed, out / "monitor.png")
    if json is not None:
        document = msgspec.json.encode(sheets.as_document(alarms, found, lost))
        write_whole(json, msgspec.json.format(document, indent=1) + b"\n")
    typer.echo(f"wrote {out}", err=True)
