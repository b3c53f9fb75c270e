"""X.509 certificates of a fleet: an authority, and one certificate for each member, by its role.

A certificate's common name is the member's name. Only a desk or router at an address bears that
address and may be a server (extended key usage, RFC 5280 section 4.2.1.12): with a vehicle's
certificate nobody can stand at the desk's address.
"""

import ipaddress
from dataclasses import dataclass
from datetime import datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from companion.core.base.errors import LeewayError
from companion.fleet.roles import LISTENS
from companion.fleet.roster import RosterMember

AUTHORITY_DAYS = 3650
EARLIER = timedelta(hours=1)
"""Certificates are valid from a little before now: clocks of members may be behind."""


@dataclass(frozen=True, slots=True)
class TlsKey:
    """A private key of NIST's P-256, which every TLS library takes."""

    private: ec.EllipticCurvePrivateKey

    @classmethod
    def new(cls) -> "TlsKey":
        """A fresh one."""
        return cls(ec.generate_private_key(ec.SECP256R1()))

    @classmethod
    def from_pem(cls, pem: bytes, where: str) -> "TlsKey":
        """LeewayError where it is none."""
        try:
            key = serialization.load_pem_private_key(pem, None)
        except (ValueError, TypeError) as error:
            raise LeewayError(f"{where}: {error}") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise LeewayError(f"{where}: expected a P-256 key")
        return cls(key)

    @property
    def pem(self) -> bytes:
        """The private key, not encrypted: the file's mode keeps it."""
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
    def new(cls, fleet: str, now: datetime) -> "TlsAuthority":
        """A fresh authority; it may sign members, and no further authority."""
        key = TlsKey.new()
        name = _name(f"{fleet} fleet authority {now:%Y-%m-%d}")
        until = now + timedelta(days=AUTHORITY_DAYS)
        public = key.private.public_key()
        made = _builder(name, name, public, now, until)
        basic = x509.BasicConstraints(ca=True, path_length=0)
        made = made.add_extension(basic, critical=True)
        made = made.add_extension(_usage(authority=True), critical=True)
        return cls(key, made.sign(key.private, hashes.SHA256()))

    @property
    def pem(self) -> bytes:
        """The authority's certificate."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    def certify(
        self, fleet: str, member: RosterMember, public: ec.EllipticCurvePublicKey, now: datetime
    ) -> bytes:
        """A member's certificate (PEM), until the end that the roster names."""
        made = _builder(_name(member.name), self.certificate.subject, public, now, member.not_after)
        made = made.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        made = made.add_extension(_usage(authority=False), critical=True)
        made = made.add_extension(x509.ExtendedKeyUsage(_purposes(member)), critical=False)
        names = x509.SubjectAlternativeName(_names(fleet, member))
        made = made.add_extension(names, critical=False)
        return made.sign(self.key.private, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def public_key_in(pem: bytes, where: str) -> ec.EllipticCurvePublicKey:
    """The key that a certificate is for: renewed, it stays the same."""
    try:
        key = x509.load_pem_x509_certificate(pem).public_key()
    except ValueError as error:
        raise LeewayError(f"{where}: {error}") from error
    if not isinstance(key, ec.EllipticCurvePublicKey):
        raise LeewayError(f"{where}: expected a P-256 key")
    return key


def authority_from_pem(key: bytes, certificate: bytes, where: str) -> TlsAuthority:
    """The authority of a folder; LeewayError where its files are none."""
    try:
        return TlsAuthority(
            TlsKey.from_pem(key, where), x509.load_pem_x509_certificate(certificate)
        )
    except ValueError as error:
        raise LeewayError(f"{where}: {error}") from error


def public_address_of(member: RosterMember) -> str:
    """The address that a member's certificate bears; only who is called by others has one."""
    return member.address if member.role in LISTENS else ""


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePublicKey,
    now: datetime,
    until: datetime,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - EARLIER)
        .not_valid_after(until)
    )


def _usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _purposes(member: RosterMember) -> list[x509.ObjectIdentifier]:
    client = [ExtendedKeyUsageOID.CLIENT_AUTH]
    return [ExtendedKeyUsageOID.SERVER_AUTH, *client] if member.role in LISTENS else client


def _names(fleet: str, member: RosterMember) -> list[x509.GeneralName]:
    own = x509.UniformResourceIdentifier(f"leeway://{fleet}/{member.role.value}/{member.name}")
    address = public_address_of(member)
    if not address:
        return [own]
    host = address.rpartition(":")[0].strip("[]")
    try:
        return [x509.IPAddress(ipaddress.ip_address(host)), own]
    except ValueError:
        return [x509.DNSName(host), own]
