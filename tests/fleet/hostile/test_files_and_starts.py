"""Attacks by files and restarts: rosters, the order of starts, audit, nested files, time stamps.
Each has a canary: with the guard removed it succeeds.
"""

import json
import re
import shutil
import subprocess
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import zenoh

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.files.signing_files import STAMPS_NAME
from companion.core.base import documents
from companion.core.base.errors import LeewayError
from companion.fleet import trust, zenoh_session
from companion.fleet.messages import Refused
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_session import open_session
from ground_station.core.people import audit_chain
from ground_station.core.people.audit_chain import AuditEntry, AuditHead
from tests.companion.adapters.test_link import heard_before_a_restart, restarted
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import GUARD, PATIENCE_S, trust_of
from tests.fleet.zenoh_net import config_file, free_port

DEPLOY = Path(__file__).parents[3] / "deploy"


@GUARD
def test_a_roster_that_nobody_signed_is_not_parsed(tmp_path, monkeypatch, guarded):
    """A dotted key of 100 kB costs a TOML parser minutes."""
    site, parsed = SecureSite(tmp_path / "pki"), list[object]()
    d1 = trust_of(site, "d1")

    def parse(*args: object) -> Refused:
        parsed.append(args)
        return Refused("parsed")

    monkeypatch.setattr(trust, "parse_verified_roster", parse)
    if not guarded:
        monkeypatch.setattr(trust, "is_roster_signed_by_authority", lambda *_: True)
    text = f'fleet = "{site.fleet}"\n' + ".".join(["a"] * 50_000) + " = 1\n"
    raw = json.dumps({"format": "signed-roster/1", "roster": text, "signatures": {}}).encode()
    assert isinstance(d1.store_roster_if_newer(raw), Refused)
    assert bool(parsed) is not guarded


@GUARD
def test_a_desk_that_starts_before_its_router_waits_for_it(tmp_path, monkeypatch, guarded):
    monkeypatch.setattr(zenoh_session, "RETRY_S", 0.05)
    if not guarded:
        monkeypatch.setattr(zenoh_session, "config_mode", lambda _: "peer")
    port = free_port()
    path = config_file(tmp_path / "desk.json5", connect=port, mode="client", listen=None)
    config = read_and_check_zenoh_config(path)
    with ThreadPoolExecutor(1) as pool:
        opening = pool.submit(open_session, config, path)
        if not guarded:
            with pytest.raises(LeewayError):
                opening.result(PATIENCE_S)
            return
        threading.Event().wait(0.3)
        assert not opening.done()
        router = read_and_check_zenoh_config(config_file(tmp_path / "r.json5", listen=port))
        with zenoh.open(router), opening.result(PATIENCE_S) as session:
            assert not session.is_closed()


ENTRIES = [AuditEntry(n, "anna", "l", "hold", "d1", "gusts") for n in range(5)]


@GUARD
@pytest.mark.parametrize("rewritten", [ENTRIES[:3], [*ENTRIES[:3], ENTRIES[0]]], ids=["cut", "new"])
def test_an_audit_that_was_cut_or_written_anew_is_not_whole(rewritten, guarded):
    (*_, last) = audit_chain.build_chained_rows(AuditHead(), ENTRIES)
    chain = list(audit_chain.build_chained_rows(AuditHead(), rewritten))
    head = AuditHead(chain[-1].n, chain[-1].digest)
    kept = last.digest if guarded else None
    assert bool(list(audit_chain.find_chain_faults(chain, head, kept))) is guarded


class RecursionErrorUnknown(Exception):
    """Stands for the guard that is removed."""


@GUARD
@pytest.mark.parametrize("kind", ["toml", "json"])
def test_a_deeply_nested_file_is_refused_in_one_line(monkeypatch, kind, guarded):
    if not guarded:
        monkeypatch.setattr(documents, "RecursionError", RecursionErrorUnknown, raising=False)
    raw = {"toml": b"a = " + b"[" * 100_000, "json": b'{"a":' * 100_000}[kind]
    parse = {"toml": documents.parse_toml, "json": documents.parse_json_object}[kind]
    with pytest.raises(LeewayError if guarded else RecursionError) as refused:
        parse(raw, "day.toml")
    assert not guarded or str(refused.value) == "day.toml: nested too deeply"


@GUARD
def test_a_torn_record_of_time_stamps_lets_no_frame_be_accepted_again(
    tmp_path, monkeypatch, guarded
):
    if not guarded:
        monkeypatch.setattr(MavlinkCodec, "refuse_streams_signed_before_start", lambda self: None)
    old = heard_before_a_restart(tmp_path)
    (tmp_path / STAMPS_NAME).write_bytes(b"{torn")
    codec, _ = restarted(tmp_path)
    assert (len(codec.parse_valid_messages(old)) == 0) is guarded


@GUARD
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
@pytest.mark.parametrize("name", ["leeway-desk", "leeway-companion"])
def test_a_service_is_exposed_to_little(tmp_path, name, guarded):
    text = (DEPLOY / f"{name}.service").read_text()
    if not guarded:
        text = re.sub(
            r"^(Protect|Private|Restrict|System|Capab|NoNew|Lock).*\n", "", text, flags=re.M
        )
    unit = tmp_path / f"{name}.service"
    unit.write_text(text)
    check = ["systemd-analyze", "security", "--offline=true", "--threshold=40", str(unit)]
    done = subprocess.run(check, capture_output=True, text=True, check=False)
    if "unrecognized option" in done.stderr:
        pytest.skip("this systemd-analyze reads no files")
    assert (done.returncode == 0) is guarded, done.stdout[-200:]
