"""Commands of the systemd units with the settings that deploy/install writes: each program accepts
its command line, may write its files, and notifies its watchdog if it has one.
"""

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from companion.fleet.roles import Role
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.pki.pki_folder import PkiFolder, utc_datetime
from ground_station.adapters.store.database import Database
from tests.fleet.zenoh_net import config_file, free_port
from tests.house.parsed_command import parsed

DEPLOY = Path(__file__).parents[2] / "deploy"
INSTALLER = (DEPLOY / "install").read_text()
PARTS = re.findall(r"\ninstall_(\w+)\(\) \{\n(.*?)\n\}\n", INSTALLER, re.DOTALL)
OURS = ("companion", "ground-station")
PATIENCE_S = 60.0

Settings = dict[str, str]


def settings_of(lines: list[str]) -> Settings:
    pairs = (line.partition("=") for line in lines if re.match(r"[A-Z]+=", line))
    return {key: value for key, _, value in pairs}


def installed() -> dict[str, Settings]:
    """Return, by unit, the settings that the installer writes to the unit's environment file."""
    found: dict[str, Settings] = {}
    for _, body in PARTS:
        conf = re.search(r"settings [a-z-]+\.conf <<'END'\n(.*?)\nEND", body, re.DOTALL)
        unit = re.search(r"^  unit (\S+)$", body, re.MULTILINE)
        assert conf, body
        assert unit, body
        found[unit[1]] = settings_of(conf[1].splitlines())
    return found


SETTINGS = installed()


def values(unit: str, key: str) -> list[str]:
    text = (DEPLOY / f"{unit}.service").read_text()
    return re.findall(rf"^{key}=(.*)$", text, re.MULTILINE)


def expanded(line: str, settings: Settings) -> list[str]:
    """Expand by systemd.service(5): ${X} is (part of) one word, $X is split; unset is empty."""
    words: list[str] = []
    for word in shlex.split(line):
        if re.fullmatch(r"\$[A-Z]+", word):
            words += settings.get(word[1:], "").split()
        else:
            words.append(re.sub(r"\$\{(\w+)\}", lambda m: settings.get(m[1], ""), word))
    return words


def command_of(unit: str, settings: Settings) -> list[str]:
    """Return the program's name and its arguments."""
    (line,) = values(unit, "ExecStart")
    program, *words = expanded(line, settings)
    return [Path(program).name, *words]


@pytest.mark.parametrize("unit", SETTINGS)
def test_the_program_takes_the_command_that_a_unit_starts(unit: str):
    assert command_of(unit, SETTINGS[unit])[0] in OURS
    parsed(command_of(unit, SETTINGS[unit]))


def test_canary_a_setting_that_is_not_there_or_an_option_that_is_none_is_noticed():
    unit = "leeway-companion-fleet"
    with pytest.raises(Exception, match="--colour"):
        parsed(command_of(unit, SETTINGS[unit] | {"OPTIONS": "--colour red"}))
    assert "" in command_of(unit, {k: v for k, v in SETTINGS[unit].items() if k != "IDENTITY"})


@pytest.mark.parametrize("unit", SETTINGS)
def test_a_unit_says_in_its_head_which_settings_it_reads_and_reads_those(unit: str):
    text = (DEPLOY / f"{unit}.service").read_text()
    head = text.partition("[Unit]")[0]
    said = settings_of([line.removeprefix("#   ") for line in head.splitlines()])
    (line,) = values(unit, "ExecStart")
    assert set(said) == set(SETTINGS[unit]) == set(re.findall(r"\$\{?([A-Z]+)", line))
    assert "" not in command_of(unit, SETTINGS[unit])


def writable(unit: str) -> list[Path]:
    folders = [f"/var/lib/{one}" for line in values(unit, "StateDirectory") for one in line.split()]
    return [Path(one) for one in (*folders, *" ".join(values(unit, "ReadWritePaths")).split())]


IN_A_FLEET = [unit for unit in SETTINGS if unit != "leeway-companion"]


@pytest.mark.parametrize("unit", IN_A_FLEET)
def test_a_member_of_a_fleet_has_an_identity_where_it_may_keep_newer_rosters(unit: str):
    command, folder = command_of(unit, SETTINGS[unit]), Path(SETTINGS[unit]["IDENTITY"])
    assert command[command.index("--identity") + 1] == str(folder)
    assert any(place in folder.parents for place in writable(unit))
    assert not any(place in Path("/etc/leeway/x").parents for place in writable(unit))  # canary


@pytest.mark.parametrize("unit", ["leeway-desk", "leeway-map", "leeway-truck"])
def test_settings_of_before_there_were_identities_mean_the_same_place(unit: str):
    """Existing settings are never overwritten: older files lack the line."""
    default = settings_of(values(unit, "Environment"))
    assert default["IDENTITY"] == SETTINGS[unit]["IDENTITY"]


# --- watchdogs -----------------------------------------------------------------------------------

MEMBERS = {
    "leeway-companion-fleet": ("d1", Role.VEHICLE),
    "leeway-desk": ("desk", Role.DESK),
    "leeway-map": ("map", Role.VIEWER),
    "leeway-truck": ("truck", Role.TRUCK),
}
MODULES = {"companion": "companion.app.cli.main", "ground-station": "ground_station.app.cli.main"}


def here(unit: str, folder: Path) -> list[str]:
    """Return the unit's command with folders under `folder` and a member made by `pki`."""
    name, role = MEMBERS[unit]
    pki = PkiFolder.create_fleet(folder / "pki", "harbour", utc_datetime(epoch_us()))
    pki.add_member(name, role, 365, "")
    zenoh = config_file(folder / "zenoh.json5", connect=free_port())
    mine = {"DAY": "harbour", "LINK": f"udpin:127.0.0.1:{free_port()}"}
    more = ["--zenoh", str(zenoh), *(["--port", "0"] if unit == "leeway-map" else [])]
    settings = SETTINGS[unit] | {k: v for k, v in mine.items() if k in SETTINGS[unit]}
    program, *words = command_of(unit, settings | {"OPTIONS": shlex.join(more)})
    words = [word.replace("/var/lib", str(folder)) for word in words]
    identity = Path(settings["IDENTITY"].replace("/var/lib", str(folder)))
    identity.parent.mkdir(parents=True, exist_ok=True)
    (folder / "pki" / "members" / name).rename(identity)
    (folder / "leeway-desk").mkdir(exist_ok=True)
    if unit == "leeway-map":
        Database(f"sqlite:///{folder}/leeway-desk/desk.db").close()
    return [sys.executable, "-m", MODULES[program], *words]


@pytest.mark.sample
@pytest.mark.drawn(keep=2)
@pytest.mark.parametrize("unit", MEMBERS)
def test_a_service_says_that_it_is_ready_and_that_it_turns(unit: str, tmp_path: Path):
    assert values(unit, "Type") == ["notify"]
    assert values(unit, "WatchdogSec") == ["60"]
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(path))
        systemd.settimeout(PATIENCE_S)
        process = subprocess.Popen(
            here(unit, tmp_path),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=os.environ | {"NOTIFY_SOCKET": str(path)},
            cwd=tmp_path,
        )
        with process:
            try:
                heard = systemd.recv(100), systemd.recv(100)
            except TimeoutError as error:
                process.kill()
                raise AssertionError(process.communicate()[0].decode()) from error
            process.send_signal(signal.SIGTERM)
            output = process.communicate(timeout=PATIENCE_S)[0].decode()
    assert heard == (b"READY=1\nWATCHDOG=1", b"WATCHDOG=1"), output
    stopped = [int(code) for line in values(unit, "SuccessExitStatus") for code in line.split()]
    assert process.returncode in (0, *stopped), output


def test_only_a_service_that_is_known_to_pet_a_watchdog_has_one():
    """The router is a foreign program and has no watchdog; both companions share one loop."""
    with_one = {p.stem for p in DEPLOY.glob("*.service") if values(p.stem, "WatchdogSec")}
    assert with_one - {"leeway-router"} == {*MEMBERS, "leeway-companion"}
