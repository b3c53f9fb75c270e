"""Open a flight log of any known format, recognised by its content and not by its name."""

from collections.abc import Callable
from pathlib import Path

from companion.adapters.logs.csv_log import read_csv_log
from companion.adapters.logs.csv_table import GZIP, plain_bytes
from companion.adapters.logs.dataflash_log import read_dataflash_log
from companion.adapters.logs.mcap_log import read_mcap_log
from companion.adapters.logs.sound_events import sound
from companion.adapters.logs.tlog_log import looks_like_tlog, read_tlog
from companion.adapters.logs.ulog_log import read_ulog
from companion.core.base.errors import LeewayError
from companion.core.replay.recorded_flight import RecordedFlight

ULOG = b"ULog\x01\x12\x35"
MCAP = b"\x89MCAP0\r\n"
DATAFLASH = b"\xa3\x95"
HEAD_BYTES = 4096
KINDS = "PX4 ULog (.ulg), ArduPilot dataflash (.bin), .tlog, our .mcap or CSV (also .csv.gz)"
PACKED = {b"PK": "zip", b"7z": "7-Zip", b"\xfd7zXZ": "xz"}


def open_log(path: Path) -> RecordedFlight:
    """Read a recorded flight; LeewayError says what is wrong with a file that is none."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    if not head:
        raise LeewayError(f"{path}: the file is empty; expected {KINDS}")
    return sound(_reader(path, head)(path), str(path))


def _reader(path: Path, head: bytes) -> Callable[[Path], RecordedFlight]:
    if head.startswith(ULOG):
        return read_ulog
    if head.startswith(MCAP):
        return read_mcap_log
    if head.startswith(GZIP):  # before dataflash, whose two bytes turn up in what is packed
        return _packed_csv(path)
    if DATAFLASH in head[:512]:
        return read_dataflash_log
    for magic, name in PACKED.items():
        if head.startswith(magic):
            raise LeewayError(f"{path}: this is packed ({name}): unpack it first")
    if head.startswith(b"FMT,"):
        raise LeewayError(f"{path}: a dataflash log as text: use the .bin that it was made from")
    if _is_text(head):
        return read_csv_log
    if looks_like_tlog(head):
        return read_tlog
    raise LeewayError(f"{path}: none of the logs that are known: expected {KINDS}")


def _packed_csv(path: Path) -> Callable[[Path], RecordedFlight]:
    """CSV may be packed; other logs are read from the file itself, piece by piece."""
    if _is_text(plain_bytes(path)[:HEAD_BYTES]):
        return read_csv_log
    raise LeewayError(f"{path}: this is packed (gzip), and no CSV: unpack it first")


def _is_text(head: bytes) -> bool:
    """Tell whether it begins with a line of printable characters."""
    line = (head.removeprefix(b"\xef\xbb\xbf").splitlines() or [b""])[0][:200]
    return len(line) > 3 and all(32 <= byte < 127 or byte == 9 for byte in line)
