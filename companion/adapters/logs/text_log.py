"""Write the run's text log: one line per event, with local time and the autopilot's time."""

from pathlib import Path

from companion.adapters.clock import local_time_text
from companion.core.base.safe_text import to_indented_log_lines


class TextLog:
    """Appends lines; each is flushed immediately."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("a", encoding="utf-8")

    def write(self, line: str) -> None:
        """Append a line."""
        self._file.write(f"{line}\n")
        self._file.flush()

    def close(self) -> None:
        """End the file."""
        self._file.close()


def format_log_entry(t_s: float, text: str) -> str:
    """Format an entry: local time, autopilot seconds, text (continuation lines indented)."""
    return f"{local_time_text()} {t_s:9.2f}  {to_indented_log_lines(text)}"
