"""Write the run's log for people: a line an event, with local time and the autopilot's."""

from pathlib import Path

from companion.adapters.clock import local_time
from companion.core.base.safe_text import log_text


class TextLog:
    """Appends lines; each is handed to the system at once."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("a", encoding="utf-8")

    def write(self, line: str) -> None:
        """Append a line."""
        self._file.write(f"{line}\n")
        self._file.flush()

    def close(self) -> None:
        """End the file."""
        self._file.close()


def dated(t_s: float, text: str) -> str:
    """An entry: local time, the autopilot's seconds, the words (its further lines indented)."""
    return f"{local_time()} {t_s:9.2f}  {log_text(text)}"
