"""The certificate file of an airframe file: `my.toml` has `my.certificate.json`."""

from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import write_text_atomically
from companion.core.base.documents import parse_json_object
from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import (
    Certificate,
    airframe_digest,
    certificate_from_dict,
)
from companion.core.vehicle.airframe import Airframe

SUFFIX = ".certificate.json"


def certificate_path(airframe_file: Path) -> Path:
    """Return the path of this airframe file's certificate."""
    return airframe_file.with_suffix(SUFFIX)


def write_certificate(airframe_file: Path, certificate: Certificate) -> Path:
    """Write the certificate atomically next to the airframe file; return its path."""
    path = certificate_path(airframe_file)
    text = msgspec.json.format(msgspec.json.encode(certificate), indent=1).decode()
    write_text_atomically(path, text + "\n")
    return path


def read_certificate(airframe_file: Path, airframe: Airframe) -> Certificate | None:
    """Read the certificate of an airframe file; `None` without one.

    Raises LeewayError if it is unreadable or was issued for other parameters than the airframe's.
    """
    path = certificate_path(airframe_file)
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    certificate = certificate_from_dict(parse_json_object(raw, str(path)), str(path))
    if certificate.airframe_digest != airframe_digest(airframe):
        raise LeewayError(
            f"{path}: issued for other parameters than {airframe_file.name}'s: run companion"
            " certify, or remove the certificate"
        )
    return certificate
