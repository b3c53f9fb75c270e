"""Check of the user's base map: one PMTiles file (version 3) of vector tiles."""

from pathlib import Path

from companion.core.base.errors import LeewayError

MAGIC_BYTES = b"PMTiles\x03"
TILE_TYPE_OFFSET, VECTOR_TILE_TYPE = 99, 1
"""PMTiles specification v3, 3: the header is 127 bytes; byte 99 is the tile type, 1 is MVT."""
HEADER_BYTES = 127


def require_vector_pmtiles_file(path: Path) -> None:
    """Raise LeewayError unless this is a PMTiles file of vector tiles."""
    try:
        with path.open("rb") as file:
            header = file.read(HEADER_BYTES)
    except OSError as error:
        raise LeewayError(f"--basemap {path}: {error.strerror}") from error
    if len(header) < HEADER_BYTES or not header.startswith(MAGIC_BYTES):
        raise LeewayError(f"--basemap {path}: expected a PMTiles file, version 3")
    if header[TILE_TYPE_OFFSET] != VECTOR_TILE_TYPE:
        raise LeewayError(f"--basemap {path}: expected vector tiles (MVT)")
