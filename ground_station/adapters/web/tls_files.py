"""TLS certificate of a map that is served to other machines."""

import ipaddress
import ssl
import stat
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509

from companion.core.base.errors import LeewayError


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """Certificate chain and key (PEM). `names`: host names and addresses of the certificate."""

    certificate: Path
    key: Path
    names: tuple[str, ...]


def load_checked_tls_files(certificate: Path, key: Path, now_epoch_us: int) -> TlsFiles:
    """Check the files: they match, the certificate is in force and names a host.

    Raises LeewayError, also if all users of this machine can read the key.
    """
    try:
        mode = stat.S_IMODE(key.stat().st_mode)
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key)
        found = x509.load_pem_x509_certificate(certificate.read_bytes())
    except (OSError, ValueError) as error:  # an SSLError is an OSError
        raise LeewayError(f"--tls {certificate} {key}: {error}") from error
    if mode & 0o007:
        raise LeewayError(f"--tls {key}: mode {mode:04o}, expected 0600: chmod 600 {key}")
    now = datetime.fromtimestamp(now_epoch_us / 1e6, tz=UTC)
    if not found.not_valid_before_utc <= now <= found.not_valid_after_utc:
        until = f"{found.not_valid_before_utc:%Y-%m-%d} to {found.not_valid_after_utc:%Y-%m-%d}"
        raise LeewayError(f"--tls {certificate}: is in force from {until}")
    names = _host_names(found)
    if not names:
        raise LeewayError(f"--tls {certificate}: names no host, expected a subjectAltName")
    return TlsFiles(certificate, key, names)


def _host_names(certificate: x509.Certificate) -> tuple[str, ...]:
    """Return the names of its subjectAltName (RFC 6125); IPv6 addresses in brackets."""
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    addresses = found.get_values_for_type(x509.IPAddress)
    hosts = [
        f"[{one}]" if isinstance(one, ipaddress.IPv6Address) else str(one) for one in addresses
    ]
    return tuple([name.lower() for name in found.get_values_for_type(x509.DNSName)] + hosts)
