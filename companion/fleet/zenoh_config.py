"""A program's zenoh configuration: loopback only, unless a file says otherwise and is safe.

Without a file the programs of one machine form a mesh: the first that comes listens on one fixed
port of loopback, all call it, and it tells them of one another. When it ends the others stay
joined, and the next that comes takes the port. Nothing is announced, nothing leaves the machine.
"""

import ipaddress
import json
from pathlib import Path
from typing import Any

import zenoh

from companion.core.base.errors import LeewayError

MEETING_PORT = 7447
"""zenoh's own."""

LEASE_MS = 10_000
"""Who has frozen, or whose cable is cut, is missed after this, a killed process at once. With less
a thousand that join at once on two cores lose their lines (with 4 s, 200 of them do).
"""

BATCH_BYTES = 8192
"""zenoh keeps transmit batches for each link and priority that has been used, by default of 64 KiB:
1,000 members would cost a desk 90 MB more. The ends of a link agree on the smaller batch. A state
has some 500 bytes, a flight file 10 kB; what is longer goes in parts.
"""

RECEIVE_BUFFER_BYTES = 2 * BATCH_BYTES
"""Of each link; zenoh's own 64 KiB would cost a desk of 1,000 members 45 MB more."""

CALL_AGAIN_MS = 500
SMALL_BUFFERS = {
    "transport/link/tx/batch_size": BATCH_BYTES,
    "transport/link/rx/buffer_size": RECEIVE_BUFFER_BYTES,
}
TLS = ("tls/", "quic/")
TLS_FILES = (
    "root_ca_certificate",
    "listen_private_key",
    "listen_certificate",
    "connect_private_key",
    "connect_certificate",
)
DEFAULT_MODE = "peer"


def read_config(path: Path | None, *, open_network: bool = False) -> zenoh.Config:
    """A configuration file (JSON5; TLS files relative to its folder), or the one for loopback.

    With `open_network` a file may let anybody in, and without a file zenoh's own default holds: a
    peer, found by multicast. Raises LeewayError where a file is not valid, or not safe.
    """
    if path is None:
        return _for_a_fleet(zenoh.Config() if open_network else loopback_config(MEETING_PORT))
    try:
        config = _for_a_fleet(zenoh.Config.from_file(str(path)))
        _resolve_tls_files(config, path.resolve().parent)
    except zenoh.ZError as error:
        raise LeewayError(f"{path}: not a zenoh configuration: {error}") from error
    why = why_open(config)
    if why and not open_network:
        raise LeewayError(
            f"{path}: {why}: expected loopback, TLS with enable_mtls, or --open-network"
        )
    return config


def _for_a_fleet(config: zenoh.Config) -> zenoh.Config:
    """No shared memory: with it zenoh 1.10 lets 351 members join a desk, and no more. Buffers are
    no larger than ours.
    """
    config.insert_json5("transport/shared_memory/enabled", "false")
    for key, most_bytes in SMALL_BUFFERS.items():
        config.insert_json5(key, str(min(_value(config, key), most_bytes)))
    return config


def loopback_config(port: int) -> zenoh.Config:
    """A peer among the programs of this machine, whichever of them came first."""
    here = f"tcp/127.0.0.1:{port}"
    table = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "listen": {
            "endpoints": [here, "tcp/127.0.0.1:0"],
            "exit_on_failure": False,
            "timeout_ms": 0,
        },
        "connect": {
            "endpoints": [here],
            "exit_on_failure": False,
            "timeout_ms": 0,
            "retry": {"period_init_ms": 200, "period_max_ms": CALL_AGAIN_MS},
        },
        "transport": {"link": {"tx": {"lease": LEASE_MS}}},
    }
    return zenoh.Config.from_json5(json.dumps(table))


def mode_of(config: zenoh.Config) -> str:
    """`client`, `peer` or `router`."""
    return _value(config, "mode") or DEFAULT_MODE


def why_open(config: zenoh.Config) -> str:
    """How strangers could reach a program with this configuration; empty: they cannot."""
    mode = mode_of(config)
    if _value(config, "scouting/multicast/enabled") is not False:
        return "found by multicast"
    for end in _endpoints(config, "listen", mode):
        if not _is_loopback(end):
            why = _listener_trouble(config, end)
            if why:
                return why
    plain = [e for e in _endpoints(config, "connect", mode) if not (_is_loopback(e) or _is_tls(e))]
    return f"calls {plain[0]} without TLS" if plain else ""


def _listener_trouble(config: zenoh.Config, endpoint: str) -> str:
    if not _is_tls(endpoint):
        return f"listens on {endpoint} without TLS"
    if _value(config, "transport/link/tls/enable_mtls") is not True:
        return f"listens on {endpoint} and lets in who shows no certificate"
    return ""


def _endpoints(config: zenoh.Config, what: str, mode: str) -> list[str]:
    """Those of one mode; zenoh's own default where the file names none."""
    found = _value(config, f"{what}/endpoints") or []
    ends = found.get(mode, []) if isinstance(found, dict) else found
    return [end if isinstance(end, str) else str(end) for end in ends]


def _is_tls(endpoint: str) -> bool:
    return endpoint.startswith(TLS)


def _is_loopback(endpoint: str) -> bool:
    host = endpoint.partition("/")[2].rpartition(":")[0]
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def _value(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _resolve_tls_files(config: zenoh.Config, folder: Path) -> None:
    """A member's folder holds its TLS files, wherever it is put."""
    for name in TLS_FILES:
        key = f"transport/link/tls/{name}"
        file = _value(config, key)
        if isinstance(file, str) and not Path(file).is_absolute():
            config.insert_json5(key, json.dumps(str(folder / file)))
