"""Stores changed vehicle settings until this or a later run restores them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.files.vehicle_settings import (
    move_original_parameters,
    original_parameters_file_path,
    read_original_parameters,
    write_or_remove_original_parameters,
)
from companion.core.base.errors import LeewayError


@dataclass(slots=True)
class SettingsKeeper:
    """Settings file of one vehicle in `folder`; None: nothing is stored. `write` runs a function
    off the flight thread, `note` adds a line to the log.
    """

    folder: Path | None
    autopilot: AutopilotPort
    write: Callable[[Callable[[], None]], None]
    note: Callable[[str], None]
    _path: Path | None = None
    _stored: dict[str, float] = field(default_factory=dict)
    _has_changes: bool = False
    """This flight adopted the stored settings or changed a setting."""

    def read_unrestored_settings(self, board_serial_number: str) -> dict[str, float]:
        """Return settings that an earlier flight changed on this vehicle and did not restore.

        Values that this flight stored before the board reported its number move to its file.
        """
        if self.folder is None:
            return {}
        profile = self.autopilot.profile
        kind = "" if profile is None else profile.autopilot_kind.value
        earlier_path, own_values = self._path, self._stored
        path = original_parameters_file_path(
            self.folder, kind, self.autopilot.system_id or 0, board_serial_number
        )
        if path == earlier_path:
            return {}
        self._path, self._stored = path, {}
        try:
            self._stored = read_original_parameters(path)
        except LeewayError as error:
            self.note(f"cannot read the settings of an earlier flight: {error}")
        found = dict(self._stored)
        if earlier_path is not None and self._has_changes:
            self._stored = moved = own_values | found
            self.write(lambda: move_original_parameters(earlier_path, path, moved))
        return found

    def store_original_values_if_changed(self, original_values: dict[str, float]) -> None:
        """Store the values to restore, also for a vehicle that did not report its board."""
        self._has_changes = self._has_changes or bool(original_values)
        if original_values == self._stored or not self._has_changes:
            return
        if self._path is None:
            self.read_unrestored_settings("")
        path, stored = self._path, dict(original_values)
        self._stored = stored
        if path is not None:
            self.write(lambda: write_or_remove_original_parameters(path, stored))
