"""A program's zenoh configuration: loopback only, unless a file defines a safe network.

Without a file the programs of one machine form a mesh: the first listens on a fixed loopback port,
the others connect to it, and it introduces them to each other. When it ends the others stay
connected, and the next to start uses the port. Nothing is announced outside the machine.
"""

import ipaddress
import json
from pathlib import Path
from typing import Any

import zenoh

from companion.core.base.errors import LeewayError

MESH_PORT = 7447
"""zenoh's default port."""

LEASE_MS = 10_000
"""A frozen or disconnected member is detected after this time, a killed process immediately. With a
shorter time, members are disconnected when 1,000 join at once on two cores (200 of them at 4 s).
"""

BATCH_BYTES = 8192
"""zenoh keeps transmit batches for each link and priority in use, by default of 64 KiB: 1,000
members would cost a desk 90 MB more. The ends of a link agree on the smaller batch. A state has
some 500 bytes, a flight file 10 kB; longer messages are fragmented.
"""

RECEIVE_BUFFER_BYTES = 2 * BATCH_BYTES
"""Per link; zenoh's default of 64 KiB would cost a desk of 1,000 members 45 MB more."""

RECONNECT_MS = 500
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


def read_and_check_zenoh_config(path: Path | None, *, open_network: bool = False) -> zenoh.Config:
    """Read a configuration file (JSON5; TLS files relative to its folder); default: loopback.

    With `open_network` a file may admit strangers, and without a file zenoh's default is used: a
    peer, discovered by multicast. Raises LeewayError for an invalid or unsafe file.
    """
    if path is None:
        return _set_fleet_limits_in_place(
            zenoh.Config() if open_network else loopback_config(MESH_PORT)
        )
    try:
        config = _set_fleet_limits_in_place(zenoh.Config.from_file(str(path)))
        _resolve_tls_file_paths_in_place(config, path.resolve().parent)
    except zenoh.ZError as error:
        raise LeewayError(f"{path}: not a zenoh configuration: {error}") from error
    reason = open_network_reason_or_empty(config)
    if reason and not open_network:
        raise LeewayError(
            f"{path}: {reason}: expected loopback, TLS with enable_mtls, or --open-network"
        )
    return config


def _set_fleet_limits_in_place(config: zenoh.Config) -> zenoh.Config:
    """Disable shared memory, with which zenoh 1.10 lets at most 351 members join a desk, and limit
    the buffers.
    """
    config.insert_json5("transport/shared_memory/enabled", "false")
    for key, most_bytes in SMALL_BUFFERS.items():
        config.insert_json5(key, str(min(_config_value(config, key), most_bytes)))
    return config


def loopback_config(port: int) -> zenoh.Config:
    """Return a peer configuration for the programs of this machine, in any start order."""
    loopback_endpoint = f"tcp/127.0.0.1:{port}"
    table = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "listen": {
            "endpoints": [loopback_endpoint, "tcp/127.0.0.1:0"],
            "exit_on_failure": False,
            "timeout_ms": 0,
        },
        "connect": {
            "endpoints": [loopback_endpoint],
            "exit_on_failure": False,
            "timeout_ms": 0,
            "retry": {"period_init_ms": 200, "period_max_ms": RECONNECT_MS},
        },
        "transport": {"link": {"tx": {"lease": LEASE_MS}}},
    }
    return zenoh.Config.from_json5(json.dumps(table))


def config_mode(config: zenoh.Config) -> str:
    """Return `client`, `peer` or `router`."""
    return _config_value(config, "mode") or DEFAULT_MODE


def open_network_reason_or_empty(config: zenoh.Config) -> str:
    """Return how strangers could reach a program with this configuration; empty if they cannot."""
    mode = config_mode(config)
    if _config_value(config, "scouting/multicast/enabled") is not False:
        return "found by multicast"
    for end in _endpoints_of_mode(config, "listen", mode):
        if not _is_loopback(end):
            if not _is_tls(end):
                return f"listens on {end} without TLS"
            if _config_value(config, "transport/link/tls/enable_mtls") is not True:
                return f"listens on {end} without requiring a client certificate"
    without_tls = [
        e
        for e in _endpoints_of_mode(config, "connect", mode)
        if not (_is_loopback(e) or _is_tls(e))
    ]
    return f"connects to {without_tls[0]} without TLS" if without_tls else ""


def _endpoints_of_mode(config: zenoh.Config, section: str, mode: str) -> list[str]:
    """Return the endpoints of one mode; zenoh's defaults if the file has none."""
    found = _config_value(config, f"{section}/endpoints") or []
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


def _config_value(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _resolve_tls_file_paths_in_place(config: zenoh.Config, folder: Path) -> None:
    """Make TLS file paths relative to the member's folder, wherever it is copied."""
    for name in TLS_FILES:
        key = f"transport/link/tls/{name}"
        file = _config_value(config, key)
        if isinstance(file, str) and not Path(file).is_absolute():
            config.insert_json5(key, json.dumps(str(folder / file)))
