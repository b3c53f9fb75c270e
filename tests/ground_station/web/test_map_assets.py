"""External scripts, accepted only with the recorded digest; and invalid map files."""

import base64
import hashlib
import io
import json
import os
import sys
import tarfile
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.basemap import require_vector_pmtiles_file
from ground_station.adapters.web import npm_assets
from ground_station.adapters.web.npm_assets import (
    ALL_PACKAGES,
    ASSETS,
    LICENCES,
    NODE,
    PACKAGES,
    NpmPackage,
    can_write_folder,
    fetch_missing_assets,
    packages_with_missing_files,
    verify_and_unpack,
)
from ground_station.app.cli.live_map import (
    check_basemap_and_fetch_scripts,
    download_outline_if_missing,
)
from tests.ground_station.web.browser import town_tiles


def archive(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as tar:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            tar.addfile(info, io.BytesIO(content))
    return out.getvalue()


def package(raw: bytes) -> NpmPackage:
    digest = base64.b64encode(hashlib.sha512(raw).digest()).decode()
    return NpmPackage("thing", "1.0.0", digest, {"package/dist/thing.js": "thing.js"})


def test_an_archive_with_the_right_digest_gives_the_files_that_are_kept(tmp_path: Path):
    raw = archive({"package/dist/thing.js": b"export {};", "package/../../evil": b"no"})
    verify_and_unpack(package(raw), raw, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"thing.js", "thing-1.0.0.whole"}
    assert (tmp_path / "thing.js").read_bytes() == b"export {};"


def test_another_content_under_the_same_version_is_refused(tmp_path: Path):
    raw = archive({"package/dist/thing.js": b"export {};"})
    other = archive({"package/dist/thing.js": b"steal();"})
    with pytest.raises(LeewayError, match=r"thing 1\.0\.0: sha512 .*, expected"):
        verify_and_unpack(package(raw), other, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_without_them_all_are_missing_and_an_npm_that_fails_is_said(tmp_path: Path, monkeypatch):
    assert len(packages_with_missing_files(PACKAGES, tmp_path)) == len(PACKAGES)
    monkeypatch.setattr(
        "ground_station.adapters.web.npm_assets.NPM", "raise SystemExit('no network')"
    )
    with pytest.raises(
        LeewayError, match=r"no network; run `ground-station map --fetch-assets` again"
    ):
        fetch_missing_assets(tmp_path)
    assert len(packages_with_missing_files(ALL_PACKAGES, tmp_path)) == len(ALL_PACKAGES)


@pytest.mark.parametrize(
    ("at_a_terminal", "npm", "said"),
    [
        (True, "raise SystemExit('no network')", "no network"),
        (True, "import os, signal; os.kill(os.getppid(), signal.SIGINT)", "outline missing: run"),
        (False, "raise SystemExit('asked')", "run `ground-station map --fetch-assets` once"),
    ],
    ids=["no network", "ctrl-c", "a service"],
)
def test_a_map_goes_on_without_an_outline_that_cannot_be_had(
    at_a_terminal: bool, npm: str, said: str, monkeypatch, capsys
):
    monkeypatch.setattr(npm_assets, "_is_installed", lambda package, folder: False)
    monkeypatch.setattr(npm_assets, "NPM", npm)
    monkeypatch.setattr(
        npm_assets, "_temporary_npm_environment", lambda: nullcontext(dict(os.environ))
    )
    monkeypatch.setattr("sys.stdout.isatty", lambda: at_a_terminal, raising=False)
    assert not download_outline_if_missing(None)
    out = "".join(capsys.readouterr())
    assert said in out
    assert at_a_terminal == ("Ctrl-C continues without it" in out)
    assert "asked" not in out


def test_who_cannot_write_beside_the_programs_is_told_what_to_type(
    tmp_path: Path, monkeypatch, capsys
):
    monkeypatch.setattr(npm_assets, "_is_installed", lambda package, folder: False)
    monkeypatch.setattr(npm_assets.os, "access", lambda path, mode: False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    town = tmp_path / "town.pmtiles"
    town_tiles(town)
    remedy = f"sudo {sys.prefix}/bin/ground-station map --fetch-assets"
    with pytest.raises(LeewayError, match=rf"cannot write there: run `{remedy}` once"):
        check_basemap_and_fetch_scripts(town)
    assert not download_outline_if_missing(None)
    assert f"run `{remedy}` once" in capsys.readouterr().out


def test_a_folder_that_is_not_there_yet_is_made_where_its_parent_may_be_written_to(tmp_path: Path):
    assert can_write_folder(tmp_path / "web" / "assets")
    assert not can_write_folder(Path("/proc/self/assets"))


def test_a_folder_that_cannot_be_written_to_is_said(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(LeewayError, match=r"map assets: .*file"):
        fetch_missing_assets(tmp_path / "file" / "assets")


def test_every_package_comes_with_the_text_of_its_licence():
    for one in ALL_PACKAGES:
        texts = [name for name in (*one.files.values(), one.licence) if name and "LICENSE" in name]
        assert len(texts) == 1, one.name
        if one.licence is not None:
            assert "Redistributions in binary form" in (LICENCES / one.licence).read_text()


def test_the_npm_is_the_one_that_the_constraints_name():
    constraints = (Path(__file__).parents[3] / "constraints.txt").read_text()
    assert NODE in constraints.splitlines()


def test_versions_are_exact_and_digests_are_sha512():
    for one in ALL_PACKAGES:
        assert len(base64.b64decode(one.sha512)) == 64
        assert one.version.replace(".", "").isdigit()
        assert replace(one, name="x").files == one.files


def test_what_lies_there_is_what_was_fetched():
    if missing := packages_with_missing_files(ALL_PACKAGES):
        pytest.skip(f"`make map-assets` was not run: {', '.join(missing)}")
    kept = {name for one in ALL_PACKAGES for name in (*one.files.values(), one.licence) if name}
    assert kept <= {path.name for path in ASSETS.iterdir()}


def test_a_file_that_is_no_map_of_vector_tiles_is_refused(tmp_path: Path):
    town = tmp_path / "town.pmtiles"
    town_tiles(town)
    require_vector_pmtiles_file(town)
    raw = town.read_bytes()
    for wrong, words in (
        (b"", "version 3"),
        (json.dumps({}).encode() * 100, "version 3"),
        (b"PMTiles\x02" + raw[8:], "version 3"),
        (raw[:99] + b"\x02" + raw[100:], "vector tiles"),
    ):
        town.write_bytes(wrong)
        with pytest.raises(LeewayError, match=words):
            require_vector_pmtiles_file(town)
