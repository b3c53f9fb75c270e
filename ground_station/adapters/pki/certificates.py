"""X.509 certificates of a fleet: an authority, and one certificate per member, by its role.

A certificate's common name is the member's name. Only a desk or router with an address has that
address in its certificate and may be a server (extended key usage, RFC 5280 section 4.2.1.12): a
vehicle's certificate cannot be used to impersonate the desk.
"""

import ipaddress
from dataclasses import dataclass
from datetime import datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from companion.core.base.errors import LeewayError
from companion.fleet.roles import SERVERS
from companion.fleet.roster import RosterMember

AUTHORITY_DAYS = 3650
CLOCK_TOLERANCE = timedelta(hours=1)
"""Certificates are valid from shortly before now: members' clocks may be behind."""


@dataclass(frozen=True, slots=True)
class TlsKey:
    """A private key of the NIST curve P-256, which every TLS library supports."""

    private: ec.EllipticCurvePrivateKey

    @classmethod
    def generate(cls) -> "TlsKey":
        """Generate a key."""
        return cls(ec.generate_private_key(ec.SECP256R1()))

    @classmethod
    def from_pem(cls, pem: bytes, error_location: str) -> "TlsKey":
        """Read a key. Raises LeewayError if it is not a P-256 private key."""
        try:
            key = serialization.load_pem_private_key(pem, None)
        except (ValueError, TypeError) as error:
            raise LeewayError(f"{error_location}: {error}") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise LeewayError(f"{error_location}: expected a P-256 key")
        return cls(key)

    @property
    def private_key_pem(self) -> bytes:
        """The private key, not encrypted: file permissions protect it."""
        kind = serialization.PrivateFormat.PKCS8
        return self.private.private_bytes(
            serialization.Encoding.PEM, kind, serialization.NoEncryption()
        )


@dataclass(frozen=True, slots=True)
class TlsAuthority:
    """Signs the certificates of one fleet."""

    key: TlsKey
    certificate: x509.Certificate

    @classmethod
    def generate(cls, fleet: str, current_time: datetime) -> "TlsAuthority":
        """Generate an authority that may sign members, but no further authority."""
        key = TlsKey.generate()
        name = _x509_name(f"{fleet} fleet authority {current_time:%Y-%m-%d}")
        until = current_time + timedelta(days=AUTHORITY_DAYS)
        public = key.private.public_key()
        builder = _certificate_builder(name, name, public, current_time, until)
        basic = x509.BasicConstraints(ca=True, path_length=0)
        builder = builder.add_extension(basic, critical=True)
        builder = builder.add_extension(_key_usage(is_authority=True), critical=True)
        return cls(key, builder.sign(key.private, hashes.SHA256()))

    @property
    def certificate_pem(self) -> bytes:
        """The authority's certificate."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    def sign_member_certificate(
        self,
        fleet: str,
        member: RosterMember,
        public_key: ec.EllipticCurvePublicKey,
        current_time: datetime,
    ) -> bytes:
        """Return a member's certificate (PEM), valid until the end stated in the roster."""
        builder = _certificate_builder(
            _x509_name(member.name),
            self.certificate.subject,
            public_key,
            current_time,
            member.not_after,
        )
        builder = builder.add_extension(
            x509.BasicConstraints(ca=False, path_length=None), critical=True
        )
        builder = builder.add_extension(_key_usage(is_authority=False), critical=True)
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if member.role in SERVERS:
            usages.insert(0, ExtendedKeyUsageOID.SERVER_AUTH)
        builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        names = x509.SubjectAlternativeName(_alternative_names(fleet, member))
        builder = builder.add_extension(names, critical=False)
        return builder.sign(self.key.private, hashes.SHA256()).public_bytes(
            serialization.Encoding.PEM
        )


def public_key_of_certificate(
    certificate_pem: bytes, error_location: str
) -> ec.EllipticCurvePublicKey:
    """Return the public key of a certificate: a renewal keeps it."""
    try:
        key = x509.load_pem_x509_certificate(certificate_pem).public_key()
    except ValueError as error:
        raise LeewayError(f"{error_location}: {error}") from error
    if not isinstance(key, ec.EllipticCurvePublicKey):
        raise LeewayError(f"{error_location}: expected a P-256 key")
    return key


def authority_from_pem(key_pem: bytes, certificate_pem: bytes, error_location: str) -> TlsAuthority:
    """Read the authority of a folder. Raises LeewayError if its files are invalid."""
    try:
        return TlsAuthority(
            TlsKey.from_pem(key_pem, error_location),
            x509.load_pem_x509_certificate(certificate_pem),
        )
    except ValueError as error:
        raise LeewayError(f"{error_location}: {error}") from error


def server_address_or_empty(member: RosterMember) -> str:
    """Return the address in a member's certificate; only listening members have one."""
    return member.address if member.role in SERVERS else ""


def _x509_name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _certificate_builder(
    subject: x509.Name,
    issuer: x509.Name,
    public_key: ec.EllipticCurvePublicKey,
    current_time: datetime,
    valid_until: datetime,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(current_time - CLOCK_TOLERANCE)
        .not_valid_after(valid_until)
    )


def _key_usage(*, is_authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not is_authority,
        key_cert_sign=is_authority,
        crl_sign=is_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _alternative_names(fleet: str, member: RosterMember) -> list[x509.GeneralName]:
    own = x509.UniformResourceIdentifier(f"leeway://{fleet}/{member.role.value}/{member.name}")
    address = server_address_or_empty(member)
    if not address:
        return [own]
    host = address.rpartition(":")[0].strip("[]")
    try:
        return [x509.IPAddress(ipaddress.ip_address(host)), own]
    except ValueError:
        return [x509.DNSName(host), own]
