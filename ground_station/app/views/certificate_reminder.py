"""Reminders of a running desk that certificates expire, since it may run past an expiry date."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from ground_station.app.views.operator_alerts import (
    CERTIFICATES_SUBJECT,
    expiring_certificates_text,
)
from ground_station.core.fleet.certificate_ends import CertificateExpiry

REMINDER_INTERVAL_S = 86_400.0


class CertificateSource(Protocol):
    """Source of expiry dates of certificates."""

    @property
    def own_certificate_warning(self) -> str:
        """Warning on this end's own certificate; empty: no warning."""
        ...

    def certificate_expiry_dates(self) -> CertificateExpiry | None:
        """Return the expiry dates, the same object until one changes; None: no certificates."""
        ...


@dataclass(slots=True)
class CertificateReminder:
    """Logs expiring certificates at the start, after each change, and daily."""

    network: CertificateSource
    log: Callable[[str], None]
    epoch_us: Callable[[], int]
    _last_ends: CertificateExpiry | None = None
    _last_log_s: float | None = None

    def log_expiring_certificates_if_due(self, now_s: float) -> None:
        """Log what is due. The network's opener logs the own certificate at the start."""
        found = self.network.certificate_expiry_dates()
        due = self._last_log_s is None or now_s - self._last_log_s >= REMINDER_INTERVAL_S
        if found is None or (found is self._last_ends and not due):
            return
        own_warning = self.network.own_certificate_warning if self._last_ends is not None else ""
        self._last_ends, self._last_log_s = found, now_s
        expiring = expiring_certificates_text(found, self.epoch_us())
        for message in (own_warning, f"{CERTIFICATES_SUBJECT}: {expiring}" if expiring else ""):
            if message:
                self.log(message)
