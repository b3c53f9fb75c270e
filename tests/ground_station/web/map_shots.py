"""Pictures of the map of a made-up town (`make map-shots`): FOLDER [--all]."""

import io
import sys
from pathlib import Path

from PIL import Image

from tests.ground_station.web import made_up_town
from tests.ground_station.web.chromium import browser

COLOURS = 256
"""Of a palette: a third of the bytes."""

SIZES = {1440: 900, 1024: 768, 390: 844}


def main() -> None:
    """Write map.png, or with --all one picture of each width and theme."""
    folder, is_all = Path(sys.argv[1]), "--all" in sys.argv
    with browser() as made, made_up_town.served(made_up_town.picture()) as address:
        for width, height in SIZES.items() if is_all else [(1440, 900)]:
            for scheme in ("light", "dark") if is_all else ("light",):
                look = {"viewport": {"width": width, "height": height}, "color_scheme": scheme}
                page = made.new_page(**look)
                made_up_town.sign_in(page)
                page.goto(f"{address}/#d3")
                page.wait_for_selector("#link.live")
                page.wait_for_timeout(1500)
                name = f"map-{width}-{scheme}.png" if is_all else "map.png"
                picture = Image.open(io.BytesIO(page.screenshot()))
                picture.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE).save(
                    folder / name, optimize=True
                )


if __name__ == "__main__":
    main()
