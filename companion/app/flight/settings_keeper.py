"""Keeps what a flight changes on its vehicle until that is put back, whichever run does it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from companion.adapters.files.vehicle_settings import (
    read_settings,
    settings_file,
    write_settings,
)
from companion.core.base.errors import LeewayError


@dataclass(slots=True)
class SettingsKeeper:
    """One vehicle's file in `folder`; None: nothing is kept. `write` runs a deed off the flight's
    thread, `note` writes a line for people.
    """

    folder: Path | None
    write: Callable[[Callable[[], None]], None]
    note: Callable[[str], None]
    _path: Path | None = None
    _kept: dict[str, float] = field(default_factory=dict)
    _ours: bool = False
    """This flight has taken over what was left, or has changed something itself."""

    def meet(self, autopilot: str, system_id: int, board: str) -> dict[str, float]:
        """The vehicle is known: what an earlier flight left changed on it."""
        if self.folder is None or self._path is not None:
            return {}
        self._path = settings_file(self.folder, autopilot, system_id, board)
        try:
            self._kept = read_settings(self._path)
        except LeewayError as error:
            self.note(f"settings of an earlier flight are not known: {error}")
        return dict(self._kept)

    def take(self, autopilot: str, system_id: int, before: dict[str, float]) -> None:
        """Keep what is to be put back now; a vehicle that never told its board is kept too."""
        self._ours = self._ours or bool(before)
        if before == self._kept or not self._ours:
            return
        if self._path is None:
            self.meet(autopilot, system_id, "")
        path, self._kept = self._path, dict(before)
        if path is not None:
            self.write(lambda: write_settings(path, before))
