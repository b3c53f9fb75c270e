"""deploy/install, as far as it can be tested here; `make install-check` uses a clean system."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
from importlib import import_module
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace

import pytest

DEPLOY = Path(__file__).parents[2] / "deploy"
SCRIPTS = sorted(p for p in DEPLOY.iterdir() if p.is_file() and p.read_bytes().startswith(b"#!"))
SHELL_SCRIPTS = [p for p in SCRIPTS if b"bash" in p.read_bytes().split(b"\n")[0]]


def install(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([DEPLOY / "install", *words], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_scripts_can_be_started(script: Path):
    assert os.access(script, os.X_OK)


@pytest.mark.parametrize("script", SHELL_SCRIPTS, ids=lambda path: path.name)
def test_bash_can_read_a_script_to_its_end(script: Path):
    done = subprocess.run(["bash", "-n", str(script)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_each_unit_of_a_role_is_shipped_and_named_by_the_installer():
    """A missing unit that the installer copies would otherwise fail only on the vehicle."""
    text = (DEPLOY / "install").read_text()
    named = [
        word
        for line in text.splitlines()
        if line.strip().startswith("unit leeway-")
        for word in [line.split()[1]]
    ]
    assert len(named) == 6
    for name in named:
        assert (DEPLOY / f"{name}.service").is_file(), name
        assert name in text.split("UNIT_NAMES=", 1)[1].splitlines()[0], name


def test_help_names_every_role_and_needs_no_root():
    done = install("--help")
    assert done.returncode == 0
    for role in ("companion", "fleet", "desk", "map", "router", "truck"):
        assert f"\n  {role} " in done.stdout


def test_an_unknown_role_is_refused_before_anything_is_touched():
    done = install("pilot")
    assert done.returncode == 2
    assert "install: pilot: not known; see --help" in done.stderr


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv (util-linux) is not installed")
@pytest.mark.skipif(os.getuid() != 0, reason="needs root, to run it without")
def test_without_root_it_says_so_and_does_nothing():
    command = ["setpriv", "--reuid=65534", "--clear-groups", "bash", "-s", "--", "companion"]
    done = subprocess.run(
        command, input=(DEPLOY / "install").read_text(), capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "needs root" in done.stderr


def test_a_bundle_holds_wheels_installer_and_units_with_checksums(tmp_path: Path):
    bundle = SimpleNamespace(**run_path(str(DEPLOY / "bundle")))
    wheels, out = tmp_path / "wheels", tmp_path / "b.tar"
    wheels.mkdir()
    (wheels / "leeway_uas-0.1.0-py3-none-any.whl").write_bytes(b"ours")
    (wheels / "numpy-2-cp311-cp311-manylinux2014_aarch64.whl").write_bytes(b"theirs")
    names = bundle.write_bundle(wheels, out)
    with tarfile.open(out) as tar:
        assert [f"leeway-bundle/{name}" for name in names] == tar.getnames()
        tar.extractall(tmp_path, filter="data")
    unpacked = tmp_path / "leeway-bundle"
    assert os.access(unpacked / "deploy/install", os.X_OK)
    for role in ("companion", "fleet"):  # what the installer copies for these roles is there
        block = (DEPLOY / "install").read_text().split(f"\ninstall_{role}() {{", 1)[1]
        unit = block.partition("unit ")[2].split()[0]
        assert (unpacked / f"deploy/{unit}.service").is_file()
    digest = hashlib.sha256(b"theirs").hexdigest()
    assert f"numpy==2 --hash=sha256:{digest}\n" in (unpacked / "requirements.txt").read_text()
    check = ["sha256sum", "--check", "--quiet", "SHA256SUMS"]
    assert subprocess.run(check, cwd=unpacked, check=False).returncode == 0
    (unpacked / "wheels/numpy-2-cp311-cp311-manylinux2014_aarch64.whl").write_bytes(b"damaged")
    damaged = subprocess.run(check, cwd=unpacked, check=False, capture_output=True)
    assert damaged.returncode != 0


@pytest.mark.skipif(os.getuid() != 0, reason="needs root")
@pytest.mark.skipif(
    subprocess.run(["unshare", "-mn", "true"], check=False, capture_output=True).returncode != 0,
    reason="no namespaces here",
)
def test_a_damaged_bundle_is_refused_without_a_network(tmp_path: Path):
    (tmp_path / "bundle/wheels").mkdir(parents=True)
    (tmp_path / "bundle/wheels/a.whl").write_bytes(b"damaged")
    (tmp_path / "bundle/SHA256SUMS").write_text(f"{'0' * 64}  wheels/a.whl\n")
    hide = "mount --make-rprivate / && mount -t tmpfs tmpfs /opt"
    for each in ("etc", "var/lib"):
        base = tmp_path / each.replace("/", "-")
        hide += f" && mkdir {base} && mount -t tmpfs tmpfs {base} && mkdir {base}/u {base}/w"
        hide += (
            f" && mount -t overlay o -o lowerdir=/{each},upperdir={base}/u,workdir={base}/w /{each}"
        )
    words = f"{hide} && exec {DEPLOY / 'install'} companion --from {tmp_path / 'bundle'}"
    words += f" --python {Path(sys.executable).resolve()}"
    command = ["unshare", "-mn", "bash", "-c", words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2, done.stderr
    assert "bundle: damaged" in done.stderr


IMPORT = re.compile(
    r"^from ((?:companion|ground_station|sim_bridge)[\w.]*) import ([\w, ]+)$", re.M
)


@pytest.mark.parametrize("script", sorted(p.name for p in DEPLOY.iterdir() if p.is_file()))
def test_names_that_a_script_imports_exist(script: str):
    """Type checks do not read these scripts, nor the Python code within shell scripts."""
    for module, names in IMPORT.findall((DEPLOY / script).read_text()):
        for name in names.split(", "):
            assert hasattr(import_module(module), name), f"{module} has no {name}"
