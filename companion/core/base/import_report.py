"""Result of an import in one shape for all files: used, skipped, suspicious, how it was read."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

MAX_NAMED_PLACES = 8
"""Places that a line names; the report holds all."""


@dataclass(frozen=True, slots=True)
class Skipped:
    """A part of a file that is not used. `is_expected`: the file is right, and the part does not
    concern the day: a zone beyond reach or not in force.
    """

    place: str
    reason: str
    is_expected: bool = False


@dataclass(slots=True)
class ImportReport:
    """Result of reading one file. `content`: the kind of its parts, plural. `notes`: how it was
    read where that differs from the documented format.
    """

    file: str
    content: str
    used: int = 0
    skipped: list[Skipped] = field(default_factory=list)
    suspicious: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """Return the report as text; empty if there is nothing to report."""
        if not (self.skipped or self.suspicious or self.notes):
            return []
        count = f"{self.used} of {self.used + len(self.skipped)}" if self.skipped else self.used
        found = [f"{self.file}: {'; '.join([f'{count} {self.content} used', *self.notes])}"]
        found += [f"{self.file}: skipped: {text}" for text in self._skipped_texts()]
        return found + [f"{self.file}: suspicious: {text}" for text in self.suspicious]

    def strict_refusals(self) -> list[str]:
        """Return what `--strict` refuses: suspicious and skipped parts that concern the day."""
        skipped = (f"{one.place}: {one.reason}" for one in self.skipped if not one.is_expected)
        return [f"{self.file}: {text}" for text in (*skipped, *self.suspicious)]

    def _skipped_texts(self) -> Iterator[str]:
        """Yield the skipped parts by reason."""
        for reason in dict.fromkeys(one.reason for one in self.skipped):
            places = [one.place for one in self.skipped if one.reason == reason]
            more = len(places) - MAX_NAMED_PLACES
            named = ", ".join(places[:MAX_NAMED_PLACES])
            yield f"{reason}: {named}{f' and {more} more' if more > 0 else ''}"


def report_lines(reports: Iterable[ImportReport]) -> list[str]:
    """Return the lines of several reports."""
    return [line for report in reports for line in report.lines()]
