"""The session of a desk or router that others call: it follows the roster and its own folder.

zenoh reads access rules and certificates when a session opens. So what is new there is taken up by
opening the session anew: who is joined calls again within a second, and who is revoked comes to
nothing any more. The rules are those of the roster in force, which the authority has signed; the
network file need not be carried here for them.
"""

import json
import ssl
import time
from dataclasses import dataclass
from pathlib import Path

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.identity import TLS_CERTIFICATE, ZENOH, Identity
from companion.fleet.roster import Roster
from companion.fleet.zenoh_config import mode_of, read_config
from ground_station.adapters.pki.access_rules import TLS_AUTHORITIES, TLS_KEY, access_control

LOOK_S = 2.0

REST_S = 20.0
"""Between two openings: a thousand members take 13 s to call again. A revocation waits no longer.
"""

OPENS_WITHIN_S = 20.0
FILES = (ZENOH, TLS_CERTIFICATE, TLS_KEY, TLS_AUTHORITIES)
RULES = "access_control"

Found = tuple[str, ...]


@dataclass(slots=True)
class CalledSession:
    """What the session of an identity is opened with, and whether that has changed since."""

    identity: Identity
    open_network: bool = False
    _in_use: Found = ()
    _seen: tuple[object, ...] = ()
    _looked_s: float | None = None
    _opened_s: float | None = None

    def open(self) -> zenoh.Session:
        """Open the session. LeewayError where a file is wrong or the address is taken."""
        config, found = self._read()
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise LeewayError(f"{self.identity.zenoh}: {error}") from error
        self._took(found)
        return session

    def is_old(self, now_s: float) -> bool:
        """Whether to open anew: rules or own files are new, whole, and the last opening is over."""
        if self._looked_s is not None and now_s - self._looked_s < LOOK_S:
            return False
        self._looked_s = now_s
        rested = self._opened_s is None or now_s - self._opened_s >= REST_S
        if not rested or (seen := self._glance()) == self._seen:
            return False
        try:
            config, found = self._read()
            _check_whole(self.identity.folder)
        except (LeewayError, OSError):  # somebody is carrying it here: look again
            return False
        self._seen = seen
        return mode_of(config) == "router" and found != self._in_use

    def open_again(self, old: zenoh.Session, now_s: float) -> zenoh.Session:
        """Close the old session and open with what is new.

        OSError where its address is not to be had again: the process must begin anew.
        """
        config, found = self._read()
        old.close()
        end_s = time.monotonic() + OPENS_WITHIN_S
        while True:
            try:
                session = zenoh.open(config)
            except zenoh.ZError as error:
                if time.monotonic() > end_s:
                    raise OSError(f"{self.identity.zenoh}: {error}") from error
                time.sleep(0.2)
            else:
                self._opened_s = now_s
                self._took(found)
                return session

    def _took(self, found: Found) -> None:
        self._in_use = found
        self.identity.trust.show_certificate()

    def _glance(self) -> tuple[object, ...]:
        """What costs little to look at, and changes with everything that counts."""
        stats: list[object] = [self.identity.trust.roster.number]
        for name in FILES:
            try:
                stat = (self.identity.folder / name).stat()
            except OSError:
                stats.append(name)
            else:
                stats.append((stat.st_mtime_ns, stat.st_size, stat.st_ino))
        return tuple(stats)

    def _read(self) -> tuple[zenoh.Config, Found]:
        """The configuration, and all that a session is made of."""
        folder = self.identity.folder
        config = read_config(self.identity.zenoh, open_network=self.open_network)
        if json.loads(config.get_json(f"{RULES}/enabled")):
            config.insert_json5(RULES, json.dumps(access_control(self.identity.trust.roster)))
        files = [_text(folder / name) for name in FILES[1:]]
        return config, (str(config), *files)


def anew_words(roster: Roster) -> str:
    """What a person is told of it."""
    return f"opened anew for roster {roster.number}: all who are joined call again"


def _text(file: Path) -> str:
    return file.read_text() if file.exists() else ""


def _check_whole(folder: Path) -> None:
    """OSError (ssl's own) where certificate and key do not belong together."""
    if (folder / TLS_KEY).exists():
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / TLS_CERTIFICATE, folder / TLS_KEY)
        context.load_verify_locations(folder / TLS_AUTHORITIES)
