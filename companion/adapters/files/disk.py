"""Disk writes that never delay a flight and whose errors never stop one.

A busy SD card blocks a writer for seconds (fsync took 0.5 to 10 s). In flight one thread executes
the writes in order; in a simulated world they are executed immediately, so that a killed companion
leaves the same files in every run.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

MAX_QUEUED_JOBS = 20_000
"""Maximum of queued jobs: minutes of a flight's record at some 100 rows and frames a second."""

CLOSE_TIMEOUT_S = 30.0
"""Timeout for the disk at the end of a flight: three times the slowest fsync observed."""

WriteJob = Callable[[], None]


class ImmediateRecordWriter:
    """Executes write jobs, each for a named record, before it returns.

    A record is abandoned at its first error, since rows after an incomplete one are unreadable; a
    `is_replaced_at_each_write` one, replaced at each write, is retried. `on_error` gets a record's
    first error.
    """

    def __init__(self, on_error: Callable[[str], None]) -> None:
        self._on_error = on_error
        self._abandoned_records: set[str] = set()
        self._reported_records: set[str] = set()

    def submit_write_job(
        self,
        record_name: str,
        job: WriteJob,
        *,
        is_replaced_at_each_write: bool = False,
        replace_queued_job: bool = False,
    ) -> bool:
        """Execute the job, now or later. `replace_queued_job`: replace this record's last queued
        such job.

        Returns False if the job is rejected and will not be executed.
        """
        del replace_queued_job  # no job is ever queued
        self._run_job_unless_record_abandoned(
            record_name, job, is_replaced_at_each_write=is_replaced_at_each_write
        )
        return True

    def wait_until_done(self) -> None:
        """Return once all submitted jobs are done."""

    def close(self) -> None:
        """Wait for all jobs, then accept no more."""

    def _run_job_unless_record_abandoned(
        self, record_name: str, job: WriteJob, *, is_replaced_at_each_write: bool
    ) -> None:
        if record_name in self._abandoned_records:
            return
        try:
            job()
        except Exception as error:  # noqa: BLE001 - the flight continues after any record error
            if not is_replaced_at_each_write:
                self._abandoned_records.add(record_name)
            message = getattr(error, "strerror", None) or repr(error)
            self._report_first_error_of_record(record_name, f"{record_name}: {message}")

    def _report_first_error_of_record(self, record_name: str, message: str) -> None:
        if record_name not in self._reported_records:
            self._reported_records.add(record_name)
            with contextlib.suppress(Exception):
                self._on_error(message)


RecordWriter = ImmediateRecordWriter
"""Either writer."""


@dataclass(slots=True)
class _QueuedJob:
    record: str
    job: WriteJob
    whole: bool


class ThreadedRecordWriter(ImmediateRecordWriter):
    """Executes jobs on its own thread. If the queue is full, new jobs are lost (reported once).

    If no thread can be started, every record is abandoned.
    """

    def __init__(
        self, on_error: Callable[[str], None], *, max_queued: int = MAX_QUEUED_JOBS
    ) -> None:
        super().__init__(on_error)
        self._limit = max_queued
        self._job_queue: deque[_QueuedJob] = deque()
        self._newest_by_record: dict[str, _QueuedJob] = {}
        self._is_active = False
        self._closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(
            target=self._run_jobs_until_closed, name="disk", daemon=True
        )
        try:
            self._thread.start()
        except RuntimeError as error:  # no memory, or too many processes
            self._closed = True
            self._report_first_error_of_record("records", f"records: {error}")

    def submit_write_job(
        self,
        record_name: str,
        job: WriteJob,
        *,
        is_replaced_at_each_write: bool = False,
        replace_queued_job: bool = False,
    ) -> bool:
        """See the base class."""
        with self._changed:
            if self._closed:
                return False
            queued_job = (
                self._newest_by_record.get(record_name)
                if replace_queued_job
                else self._newest_by_record.pop(record_name, None)
            )
            if replace_queued_job and queued_job is not None:
                queued_job.job = job
            elif len(self._job_queue) >= self._limit:
                self._report_first_error_of_record("speed", "records: disk too slow, rows are lost")
                return False
            else:
                self._enqueue(
                    _QueuedJob(record_name, job, is_replaced_at_each_write),
                    newest_only=replace_queued_job,
                )
            return True

    def _enqueue(self, entry: _QueuedJob, *, newest_only: bool) -> None:
        self._job_queue.append(entry)
        if newest_only:
            self._newest_by_record[entry.record] = entry
        self._changed.notify_all()

    def wait_until_done(self) -> None:
        """See the base class; gives up after CLOSE_TIMEOUT_S on a disk that does not respond."""
        with self._changed:
            self._changed.wait_for(self._is_idle, CLOSE_TIMEOUT_S)

    def _is_idle(self) -> bool:
        return self._closed or (not self._job_queue and not self._is_active)

    def close(self) -> None:
        """See the base class."""
        self.wait_until_done()
        with self._changed:
            if not self._is_idle():
                self._report_first_error_of_record(
                    "speed", "records: disk does not respond, end of record lost"
                )
            self._closed = True
            self._changed.notify_all()

    def _run_jobs_until_closed(self) -> None:
        while (entry := self._wait_for_next_job()) is not None:
            self._run_job_unless_record_abandoned(
                entry.record, entry.job, is_replaced_at_each_write=entry.whole
            )

    def _wait_for_next_job(self) -> _QueuedJob | None:
        with self._changed:
            self._is_active = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._job_queue or self._closed)
            if not self._job_queue:
                return None
            self._is_active = True
            entry = self._job_queue.popleft()
            if self._newest_by_record.get(entry.record) is entry:
                del self._newest_by_record[entry.record]
            return entry
