"""What a running desk says of certificates that end: it may run across the day that one is due."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from ground_station.app.views.attention import CERTIFICATES, ending_certificates
from ground_station.core.fleet.desk_figures import CertificateFigures

DAY_S = 86_400.0


class Certified(Protocol):
    """Who knows when certificates end."""

    @property
    def warning(self) -> str:
        """What a person should know about this end's own standing; empty: nothing."""
        ...

    def certificates(self) -> CertificateFigures | None:
        """When they end, the same object while nothing of it changes; None: there are none."""
        ...


@dataclass(slots=True)
class CertificateReminder:
    """Says it at the start, when something of it changes, and again every day."""

    network: Certified
    say: Callable[[str], None]
    epoch_us: Callable[[], int]
    _seen: CertificateFigures | None = None
    _said_s: float | None = None

    def turn(self, now_s: float) -> None:
        """Say what is due. Of the own one the network's opener has spoken at the start."""
        found = self.network.certificates()
        due = self._said_s is None or now_s - self._said_s >= DAY_S
        if found is None or (found is self._seen and not due):
            return
        own = self.network.warning if self._seen is not None else ""
        self._seen, self._said_s = found, now_s
        ending = ending_certificates(found, self.epoch_us())
        for words in (own, f"{CERTIFICATES}: {ending}" if ending else ""):
            if words:
                self.say(words)
