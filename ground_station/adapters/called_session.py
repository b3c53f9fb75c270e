"""zenoh session of a desk or router that listens for members: it follows the roster and its folder.

zenoh reads access rules and certificates only when a session opens. Therefore the session is
reopened when they change. Members reconnect within a second; revoked members are refused. The rules
come from the signed roster in force, so the network file need not be copied here for them.
"""

import json
import ssl
import time
from dataclasses import dataclass
from pathlib import Path

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.identity import TLS_CERTIFICATE, ZENOH, MemberIdentity
from companion.fleet.roster import Roster
from companion.fleet.zenoh_config import config_mode, read_and_check_zenoh_config
from companion.fleet.zenoh_session import open_session
from ground_station.adapters.pki.access_rules import TLS_CA, TLS_KEY, access_control_config

POLL_INTERVAL_S = 2.0

MIN_REOPEN_INTERVAL_S = 20.0
"""Minimum time between reopenings: a thousand members take 13 s to reconnect. It bounds the delay
of a revocation.
"""

REOPEN_TIMEOUT_S = 20.0
IDENTITY_FILES = (ZENOH, TLS_CERTIFICATE, TLS_KEY, TLS_CA)
RULES_KEY = "access_control"

SessionInputs = tuple[str, ...]


@dataclass(slots=True)
class ServerSession:
    """Opens the session of an identity and detects when its configuration has changed."""

    identity: MemberIdentity
    open_network: bool = False
    _active_inputs: SessionInputs = ()
    _last_fingerprints: tuple[object, ...] = ()
    _last_poll_s: float | None = None
    _last_reopen_s: float | None = None

    def open_session(self) -> zenoh.Session:
        """Open the session. Raises LeewayError if a file is invalid or the address is in use."""
        config, found = self._read_config_and_inputs()
        session = open_session(config, self.identity.zenoh_config_path)
        self._record_active_inputs(found)
        return session

    def poll_and_check_if_reopen_due(self, now_s: float) -> bool:
        """True if rules or own files have changed, are complete, and `MIN_REOPEN_INTERVAL_S` has
        elapsed.
        """
        if self._last_poll_s is not None and now_s - self._last_poll_s < POLL_INTERVAL_S:
            return False
        self._last_poll_s = now_s
        rested = self._last_reopen_s is None or now_s - self._last_reopen_s >= MIN_REOPEN_INTERVAL_S
        if not rested or (seen := self._input_fingerprints()) == self._last_fingerprints:
            return False
        try:
            config, found = self._read_config_and_inputs()
            _require_matching_key_pair(self.identity.folder)
        except (LeewayError, OSError):  # files are being copied: try again later
            return False
        self._last_fingerprints = seen
        return config_mode(config) == "router" and found != self._active_inputs

    def close_and_reopen_session(self, old_session: zenoh.Session, now_s: float) -> zenoh.Session:
        """Close the old session and open one with the current configuration.

        Raises OSError if the address cannot be bound again: the process must then restart.
        """
        config, found = self._read_config_and_inputs()
        old_session.close()
        end_s = time.monotonic() + REOPEN_TIMEOUT_S
        while True:
            try:
                session = zenoh.open(config)
            except zenoh.ZError as error:
                if time.monotonic() > end_s:
                    raise OSError(f"{self.identity.zenoh_config_path}: {error}") from error
                time.sleep(0.2)
            else:
                self._last_reopen_s = now_s
                self._record_active_inputs(found)
                return session

    def _record_active_inputs(self, session_inputs: SessionInputs) -> None:
        self._active_inputs = session_inputs
        self.identity.trust.validity.reload_own_end_if_complete()

    def _input_fingerprints(self) -> tuple[object, ...]:
        """Return cheap fingerprints of all inputs; they change whenever an input changes."""
        stats: list[object] = [self.identity.trust.roster.number]
        for name in IDENTITY_FILES:
            try:
                stat = (self.identity.folder / name).stat()
            except OSError:
                stats.append(name)
            else:
                stats.append((stat.st_mtime_ns, stat.st_size, stat.st_ino))
        return tuple(stats)

    def _read_config_and_inputs(self) -> tuple[zenoh.Config, SessionInputs]:
        """Return the zenoh configuration and the content of all files that it uses."""
        folder = self.identity.folder
        config = read_and_check_zenoh_config(
            self.identity.zenoh_config_path, open_network=self.open_network
        )
        if json.loads(config.get_json(f"{RULES_KEY}/enabled")):
            config.insert_json5(
                RULES_KEY, json.dumps(access_control_config(self.identity.trust.roster))
            )
        paths = [folder / name for name in IDENTITY_FILES[1:]]
        files = [path.read_text() if path.exists() else "" for path in paths]
        return config, (str(config), *files)


def session_reopened_message(roster: Roster) -> str:
    """Return the log message for a reopened session."""
    return f"session reopened for roster {roster.number}: members reconnect"


def _require_matching_key_pair(folder: Path) -> None:
    """Raise OSError (also ssl.SSLError) if certificate and key do not match."""
    if (folder / TLS_KEY).exists():
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / TLS_CERTIFICATE, folder / TLS_KEY)
        context.load_verify_locations(folder / TLS_CA)
