"""The user's base map: one file of vector tiles (PMTiles, version 3)."""

from pathlib import Path

from companion.core.base.errors import LeewayError

HEAD = b"PMTiles\x03"
TILE_TYPE_AT, VECTOR = 99, 1
"""PMTiles specification v3, 3: the header is 127 bytes; at 99 the tiles' type, 1 is MVT."""
HEADER_BYTES = 127


def check_pmtiles(path: Path) -> None:
    """Raise LeewayError where this is no PMTiles file of vector tiles."""
    try:
        with path.open("rb") as file:
            header = file.read(HEADER_BYTES)
    except OSError as error:
        raise LeewayError(f"--basemap {path}: {error.strerror}") from error
    if len(header) < HEADER_BYTES or not header.startswith(HEAD):
        raise LeewayError(f"--basemap {path}: expected a PMTiles file, version 3")
    if header[TILE_TYPE_AT] != VECTOR:
        raise LeewayError(f"--basemap {path}: expected vector tiles (MVT)")
