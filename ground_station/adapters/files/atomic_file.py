"""Files that are replaced atomically."""

import os
from pathlib import Path

from companion.core.base.errors import LeewayError


def write_file_atomically(path: Path, content: bytes, permission_bits: int = 0o666) -> None:
    """Replace a file, at no time with more permissions than these (less the umask).

    An interrupted write leaves the previous file. Raises LeewayError.
    """
    temporary = path.with_name(f"{path.name}.new")
    try:
        temporary.unlink(missing_ok=True)
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, permission_bits)
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
