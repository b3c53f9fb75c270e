"""Open a flight log of any known format, recognised by its content, not by its name."""

from collections.abc import Callable
from pathlib import Path

from companion.adapters.logs.csv_log import read_csv_log
from companion.adapters.logs.csv_table import GZIP, read_file_decompressing_gzip
from companion.adapters.logs.dataflash_log import read_dataflash_log
from companion.adapters.logs.mcap_log import read_mcap_log
from companion.adapters.logs.plausibility import drop_implausible_events
from companion.adapters.logs.tlog_log import is_tlog, read_tlog
from companion.adapters.logs.ulog_log import read_ulog
from companion.analysis.replay.recorded_flight import RecordedFlight
from companion.core.base.errors import LeewayError

ULOG = b"ULog\x01\x12\x35"
MCAP = b"\x89MCAP0\r\n"
DATAFLASH = b"\xa3\x95"
HEAD_BYTES = 4096
KNOWN_FORMATS = (
    "PX4 ULog (.ulg), ArduPilot dataflash (.bin), .tlog, companion .mcap or CSV (also .csv.gz)"
)
ARCHIVE_MAGIC = {b"PK": "zip", b"7z": "7-Zip", b"\xfd7zXZ": "xz"}


def read_log_of_any_format(path: Path) -> RecordedFlight:
    """Read a recorded flight; LeewayError describes the error of any other file."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    if not head:
        raise LeewayError(f"{path}: the file is empty; expected {KNOWN_FORMATS}")
    return drop_implausible_events(_reader_by_file_content(path, head)(path), str(path))


def read_multirotor_log(path: Path) -> RecordedFlight:
    """Read a recorded flight of a multirotor; LeewayError for another vehicle."""
    flight = read_log_of_any_format(path)
    if not flight.is_multirotor_or_unknown:
        raise LeewayError(f"{path}: a {flight.vehicle}; a multirotor expected")
    return flight


def _reader_by_file_content(path: Path, first_bytes: bytes) -> Callable[[Path], RecordedFlight]:
    if first_bytes.startswith(ULOG):
        return read_ulog
    if first_bytes.startswith(MCAP):
        return read_mcap_log
    if first_bytes.startswith(GZIP):  # before dataflash: compressed data may contain its two bytes
        if _is_text(read_file_decompressing_gzip(path)[:HEAD_BYTES]):
            return read_csv_log
        raise LeewayError(f"{path}: compressed file (gzip), not CSV: unpack it first")
    if DATAFLASH in first_bytes[:512]:
        return read_dataflash_log
    for magic, name in ARCHIVE_MAGIC.items():
        if first_bytes.startswith(magic):
            raise LeewayError(f"{path}: compressed file ({name}): unpack it first")
    if b"\nFMT," in b"\n" + first_bytes:
        raise LeewayError(
            f"{path}: ArduPilot text log (dataflash as text): expected the original .bin;"
            " mavlogdump.py --format csv writes single messages as CSV"
        )
    if _is_text(first_bytes):
        return read_csv_log
    if is_tlog(first_bytes):
        return read_tlog
    raise LeewayError(f"{path}: unknown log format: expected {KNOWN_FORMATS}")


def _is_text(head: bytes) -> bool:
    """Return True if the first line is printable text."""
    line = (head.removeprefix(b"\xef\xbb\xbf").splitlines() or [b""])[0][:200]
    return len(line) > 3 and all(32 <= byte < 127 or byte == 9 for byte in line)
