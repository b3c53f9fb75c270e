"""The shipped systemd units: every key is in the section where systemd reads it."""

import configparser
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from companion.fleet.service_manager import Watchdog, notify_systemd
from companion.fleet.zenoh_config import MESH_PORT

UNITS = sorted((Path(__file__).parents[2] / "deploy").glob("*.service"))
IN_UNIT = ("StartLimitIntervalSec", "StartLimitBurst")


def keys_of(text: str) -> dict[str, set[str]]:
    read = configparser.ConfigParser(strict=False, interpolation=None, delimiters=("=",))
    read.optionxform = str  # type: ignore[assignment, method-assign]
    read.read_string(text)
    return {section: set(read[section]) for section in read.sections()}


def misplaced(text: str) -> list[str]:
    """Return the keys outside [Unit] that systemd ignores there with a journal entry."""
    found = keys_of(text)
    return [key for key in IN_UNIT if any(key in found[s] for s in found if s != "Unit")]


@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.stem)
def test_restart_limits_stand_in_the_section_that_systemd_reads_them_from(unit: Path):
    text = unit.read_text()
    assert misplaced(text) == []
    assert "StartLimitIntervalSec" in keys_of(text)["Unit"]


def test_canary_a_limit_in_the_service_section_is_found():
    assert misplaced("[Unit]\n[Service]\nStartLimitIntervalSec=0\n") == ["StartLimitIntervalSec"]


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_is_exposed_to_little(unit: Path):
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=40", str(unit)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "unrecognized option" in done.stderr:
        pytest.skip("this systemd-analyze reads no files")
    assert done.returncode == 0, done.stdout[-200:] + done.stderr


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.stem)
def test_systemd_finds_nothing_wrong_with_a_unit(unit: Path, tmp_path: Path):
    """Programs and accounts of the target machine are replaced by ones of this machine."""
    lines = [line for line in unit.read_text().splitlines() if not line.startswith("User=")]
    lines = ["ExecStart=/bin/true" if x.startswith("ExecStart=") else x for x in lines]
    copy = tmp_path / unit.name
    copy.write_text("\n".join(lines) + "\n")
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(copy)], capture_output=True, text=True
    )
    ours = [line for line in done.stderr.splitlines() if unit.name in line]
    assert ours == []


PORT_RULES = UNITS[0].parent / "leeway-port.iptables"


def iptables_refuses(rules: str) -> str:
    done = subprocess.run(
        ["iptables-restore", "--test"], input=rules, capture_output=True, text=True
    )
    return done.stderr if done.returncode else ""


def cannot_test_rules() -> bool:
    """Return True if the program is missing or not permitted for this account."""
    if shutil.which("iptables-restore") is None:
        return True
    return bool(iptables_refuses("*filter\nCOMMIT\n"))


@pytest.mark.skipif(cannot_test_rules(), reason="iptables-restore is not here, or needs root")
@pytest.mark.parametrize("spoilt", [False, True], ids=["ours", "canary"])
def test_the_rules_for_the_tls_port_are_ones_that_iptables_takes(spoilt: bool):
    rules = PORT_RULES.read_text()
    if spoilt:
        rules = rules.replace("--hashlimit-mode", "--hashlimit-mood")
    assert bool(iptables_refuses(rules)) is spoilt


def test_the_rules_for_the_tls_port_count_new_calls_only_by_address_and_in_all():
    rules = [line for line in PORT_RULES.read_text().splitlines() if line.startswith("-A")]
    assert f"--dport {MESH_PORT} --syn -j LEEWAY-PORT" in rules[0]
    assert [rule.rpartition(" ")[2] for rule in rules[1:]] == ["DROP", "RETURN", "DROP"]
    assert "--hashlimit-mode srcip" in rules[1]
    assert "-m limit --limit 8/second" in rules[2]


def test_a_loop_that_turns_says_so_and_without_systemd_nothing_happens(tmp_path, monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notify_systemd("READY=1")
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(path))
        systemd.settimeout(5.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(path))
        watchdog = Watchdog(5.0)
        for now_s in (0.0, 1.0, 4.9, 5.0):
            watchdog.notify_systemd_if_due(now_s)
        heard = [systemd.recv(100), systemd.recv(100)]
        systemd.setblocking(False)
        with pytest.raises(BlockingIOError):
            systemd.recv(100)
    assert heard == [b"READY=1\nWATCHDOG=1", b"WATCHDOG=1"]
