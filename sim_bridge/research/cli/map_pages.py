"""`sim-bridge research map-picture`: the map's page as a picture."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()


@app.command("map-picture")
def map_picture(
    out: Annotated[Path, typer.Option(help="The PNG.")] = Path("docs/img/map.png"),
    day: Annotated[str, typer.Option(help="A day/1 TOML file, or a bundled day.")] = "harbour",
    seed: Annotated[int, typer.Option(min=0, help="Of the simulated day.")] = 1,
) -> None:
    """The documents' picture of the map: a simulated day, replayed in a headless Chromium.

    sim-bridge research map-picture --out docs/img/map.png
    """
    try:
        from sim_bridge.research.map_pages.map_picture import draw
    except ImportError as error:
        raise LeewayError(f"map-picture needs leeway-uas[ground]: {error}") from error
    typer.echo(draw(day, seed, out))
