"""Files of a run's folder that stay open during the flight, and its result."""

import contextlib
import json
import sys
from collections import defaultdict, deque
from pathlib import Path
from typing import Any

from companion.adapters.files.atomic_file import write_text_atomically
from companion.adapters.logs.decision_log import (
    DecisionLog,
    free_path_for_damaged_file,
    next_free_path,
    read_mcap_rows,
)
from companion.adapters.logs.text_log import TextLog
from companion.adapters.logs.tlog_writer import TlogFile

TEXT, STREAM, DECISIONS = "companion.log", "stream.tlog", "decisions.mcap"
RESULT = "result.json"
LIST_BY_TOPIC = {
    "decision": "decisions",
    "assessment": "assessments",
    "wind": "wind",
    "energy": "energy",
    "phase": "phases",
}
"""Topics of the decision log, with the corresponding lists of the result."""


class RunFiles:
    """Used on the disk's thread, where an error ends a record: a file that cannot be opened is
    missing in `open_files`. Only `error_texts` is read by the flight's thread.
    """

    def __init__(self, run_dir: Path) -> None:
        self.run_dir = run_dir
        self.error_texts: deque[str] = deque()
        self._close_stack = contextlib.ExitStack()
        self.open_files: dict[str, Any] = {}
        self._previous_lists = defaultdict[str, list[dict[str, Any]]](list)

    def open_text(self) -> None:
        """Create the folder and open the text log."""
        self.run_dir.mkdir(parents=True, exist_ok=True)
        self._register_file(TEXT, TextLog(self.run_dir / TEXT))

    def open_stream(self) -> None:
        """Open the MAVLink stream."""
        self._register_file(STREAM, TlogFile(self.run_dir / STREAM))

    def open_decisions(self, *, is_resumed: bool) -> None:
        """Open a new decision log, next to those of earlier runs."""
        if is_resumed:
            self._read_previous_lists()
        self._register_file(DECISIONS, DecisionLog(next_free_path(self.run_dir / DECISIONS)))

    def _register_file(self, record: str, file: TextLog | TlogFile | DecisionLog) -> None:
        self.open_files[record] = file
        self._close_stack.callback(file.close)

    def _read_previous_lists(self) -> None:
        """Read rows of earlier interrupted runs in this folder from their decision logs."""
        logs = sorted(
            self.run_dir.glob("decisions*.mcap"), key=lambda path: (len(path.name), path.name)
        )
        for path in logs:
            previous_log = read_mcap_rows(path)
            for topic, row in previous_log.rows:
                if topic in LIST_BY_TOPIC:
                    self._previous_lists[LIST_BY_TOPIC[topic]].append(row)
                if topic == "decision" and row.get("kind") == "finished":  # an earlier flight
                    self._previous_lists.clear()
            if previous_log.error_text:
                self.queue_and_print_error(f"{path.name}: {previous_log.error_text}: moved aside")
                path.replace(free_path_for_damaged_file(path))

    def write_frames(self, frames: list[tuple[bytes, float]]) -> None:
        """Write frames and their times to the stream."""
        for frame, t_s in frames:
            self.open_files[STREAM].write(frame, t_s)

    def write_result(self, result: dict[str, Any], lists: dict[str, list[dict[str, Any]]]) -> None:
        """Write the result with the rows of this run and of the interrupted ones."""
        all_lists = {
            name: self._previous_lists[name] + lists[name] for name in LIST_BY_TOPIC.values()
        }
        text = json.dumps(result | all_lists, allow_nan=False)
        write_text_atomically(self.run_dir / RESULT, text, sync_folder=False)

    def queue_and_print_error(self, error_text: str) -> None:
        """Queue an error for the operator; also write it to log and screen if possible."""
        self.error_texts.append(error_text)
        with contextlib.suppress(OSError, ValueError, KeyError):
            self.open_files[TEXT].write(f"recording stopped: {error_text}")
        with contextlib.suppress(OSError, ValueError):
            print(f"recording stopped: {error_text}", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Close the open files."""
        self._close_stack.close()
