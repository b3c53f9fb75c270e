"""The certificate beside an airframe file: `my.toml` has `my.certificate.json`."""

from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import write_text_whole
from companion.core.base.documents import json_object
from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import (
    Certificate,
    airframe_digest,
    certificate_from_dict,
)
from companion.core.vehicle.airframe import Airframe

SUFFIX = ".certificate.json"


def certificate_path(airframe_file: Path) -> Path:
    """Where the certificate of this airframe file lies."""
    return airframe_file.with_suffix(SUFFIX)


def write_certificate(airframe_file: Path, certificate: Certificate) -> Path:
    """Write it beside the airframe file, whole or not at all; returns where."""
    path = certificate_path(airframe_file)
    text = msgspec.json.format(msgspec.json.encode(certificate), indent=1).decode()
    write_text_whole(path, text + "\n")
    return path


def read_certificate(airframe_file: Path, airframe: Airframe) -> Certificate | None:
    """The certificate beside an airframe file; `None` where there is none.

    LeewayError where it cannot be read, or is of other numbers than the airframe file's.
    """
    path = certificate_path(airframe_file)
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    certificate = certificate_from_dict(json_object(raw, str(path)), str(path))
    if certificate.airframe_digest != airframe_digest(airframe):
        raise LeewayError(
            f"{path}: of other numbers than {airframe_file.name} has: companion certify again, or"
            " remove it"
        )
    return certificate
