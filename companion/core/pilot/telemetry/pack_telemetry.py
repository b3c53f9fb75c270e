"""The battery messages of all monitors, and the state of the pack merged from them."""

import math
from dataclasses import dataclass, field, replace

from companion.core.mission.events import Battery
from companion.core.vehicle.airframe import PLAUSIBLE_CELL_V

BATTERY_MAX_AGE_S = 5.0

SAME_PACK_TOLERANCE_FRAC = 0.05
"""Maximum relative difference of two voltages of one pack."""

REPORTED_DIFFERENCE_FRAC, DIFFERENT_REPORTS = 0.03, 10
"""Relative difference of two voltages of one pack that is reported, and for how many messages in a
row: at 2 Hz a change of load is over by then."""

FROZEN_S, FROZEN_REPORTS = 10.0, 10
"""A measurement that is exactly constant in flight for this time and number of messages is frozen:
both resolve 10 mA and 1 mV, and no hover is that steady."""

COUNTED_FIELDS = ("current_a", "consumed_ah", "consumed_j")
"""Fields that depend on the current sensor."""


@dataclass(slots=True)
class _ConstantValue:
    """A measured value, since when and for how many messages it is constant in flight, and the
    number of changes in flight before it.
    """

    value: float
    since_s: float
    changes: int
    reports: int = 1


@dataclass(slots=True)
class FreezeDetector:
    """Detects measurements that are constant in flight, by monitor and field.

    Simulators and synthetic logs report constants: only a value that changed in flight before, at
    takeoff not counted, can freeze. A current that is too low from power-up is not frozen, but
    low (`LowCurrentDetector`).
    """

    _values: dict[tuple[int | None, str], _ConstantValue] = field(default_factory=dict)

    def message_without_frozen_fields(self, battery: Battery, *, is_airborne: bool) -> Battery:
        """Process a message; return it with frozen measurements unknown."""
        frozen = {
            name
            for field_name in ("voltage_v", "current_a")
            if self._is_frozen(battery, field_name, is_airborne=is_airborne)
            for name in (COUNTED_FIELDS if field_name == "current_a" else (field_name,))
        }
        return replace(battery, **dict.fromkeys(frozen)) if frozen else battery

    def _is_frozen(self, battery: Battery, field_name: str, *, is_airborne: bool) -> bool:
        value = getattr(battery, field_name)
        if not value:
            return False
        key, t_s = (battery.pack, field_name), battery.t_s
        last = self._values.get(key)
        if last is None or value != last.value or not is_airborne:
            changes = 0 if last is None or not is_airborne else last.changes + 1
            self._values[key] = _ConstantValue(value, t_s, changes)
            return False
        last.reports += 1
        is_constant = t_s - last.since_s >= FROZEN_S and last.reports >= FROZEN_REPORTS
        return is_constant and last.changes > 1


@dataclass(slots=True)
class PackTelemetry:
    """The battery messages, and the state of the pack merged from those about it.

    The monitor that measures the pack is selected by voltage, then current, then number; while the
    vehicle is armed it stays. Its messages and matching ones of the whole vehicle are merged. After
    a reboot of the autopilot a new object replaces this one.
    """

    voltage_range_v: tuple[float, float] = (PLAUSIBLE_CELL_V[0], math.inf)
    """Lowest and highest voltage of the vehicle's pack."""
    battery: Battery | None = None
    messages: dict[int | None, Battery] = field(default_factory=dict)
    """The latest battery message of each monitor, and of the whole vehicle (`None`)."""
    has_frozen: bool = False
    """Whether a measurement was found frozen in flight."""
    differing_voltages_v: tuple[float, float] | None = None
    """Voltage of SYS_STATUS and of the monitor, while they differ."""
    _differing_reports: int = 0
    _freezes: FreezeDetector = field(default_factory=FreezeDetector)
    _monitor: int = 0
    _measured: dict[int, Battery] = field(default_factory=dict)
    _field_times_s: dict[str, float] = field(default_factory=dict)

    def store_message(
        self, message: Battery, t_s: float, *, is_armed: bool, is_airborne: bool = False
    ) -> None:
        """Process one battery message at this time."""
        battery = self._freezes.message_without_frozen_fields(message, is_airborne=is_airborne)
        if battery is not message:
            self.has_frozen = True
            for name in ("voltage_v", *COUNTED_FIELDS):
                if getattr(message, name) is not None and getattr(battery, name) is None:
                    self._field_times_s.pop(name, None)
        battery = self._without_higher_of_two_voltages(battery)
        self.messages[battery.pack] = battery
        if battery.pack is not None and battery.voltage_v is not None:
            self._measured[battery.pack] = battery
        if not (is_armed and self._monitor in self._measured):  # in flight it stays the same pack
            known = [k for k in self._measured or self.messages if k is not None]
            selected = max(known, key=lambda k: self._monitor_selection_key(k, t_s), default=0)
            if selected != self._monitor:
                self._monitor, self.battery = selected, None
        if battery.pack in (self._monitor, None) and self._is_about_pack(battery):
            self.battery = self._merge_battery(battery)

    def _without_higher_of_two_voltages(self, battery: Battery) -> Battery:
        """Compare SYS_STATUS with all monitors. While they differ the lower voltage counts."""
        system_v = battery.voltage_v
        if battery.pack is None and system_v is not None:
            others_v = [
                other.voltage_v
                for other in self._measured.values()
                if other.voltage_v is not None and battery.t_s - other.t_s <= BATTERY_MAX_AGE_S
            ]
            near_v = min(others_v, key=lambda v: abs(v - system_v), default=0.0)
            off_v, is_about_pack = abs(near_v - system_v), self._is_about_pack(battery)
            differs = near_v > 0.0 and off_v > REPORTED_DIFFERENCE_FRAC * near_v and is_about_pack
            self._differing_reports = self._differing_reports + 1 if differs else 0
            is_lasting = self._differing_reports >= DIFFERENT_REPORTS
            self.differing_voltages_v = (system_v, near_v) if is_lasting else None
        voltages_v = self.differing_voltages_v
        if voltages_v is None or battery.voltage_v is None or len(self._measured) > 1:
            return battery
        is_higher = (battery.pack is None) == (voltages_v[0] > voltages_v[1])
        return replace(battery, voltage_v=None) if is_higher else battery

    def _monitor_voltage_v(self, monitor_number: int) -> float:
        battery = self._measured.get(monitor_number)
        return 0.0 if battery is None else battery.voltage_v or 0.0

    def _has_pack_voltage(self, monitor_number: int) -> bool:
        low_v, high_v = self.voltage_range_v
        return low_v <= self._monitor_voltage_v(monitor_number) <= high_v

    def _monitor_selection_key(
        self, monitor_number: int, t_s: float
    ) -> tuple[bool, bool, bool, int]:
        battery = self._measured.get(monitor_number)
        return (
            self._has_pack_voltage(monitor_number),
            battery is not None and t_s - battery.t_s <= BATTERY_MAX_AGE_S,
            battery is not None and battery.current_a is not None,
            -monitor_number,
        )

    def _is_about_pack(self, battery: Battery) -> bool:
        """Return whether a message is about a pack; SYS_STATUS is matched by its voltage."""
        if battery.pack is not None:
            return battery.pack == self._monitor or self._has_pack_voltage(battery.pack)
        monitor_v = self._monitor_voltage_v(self._monitor)
        off_v = abs((battery.voltage_v or 0.0) - monitor_v)
        return self._monitor == 0 or off_v < SAME_PACK_TOLERANCE_FRAC * monitor_v

    @property
    def monitor(self) -> int:
        """Number of the monitor that measures the pack."""
        return self._monitor

    @property
    def latest_messages(self) -> list[Battery]:
        """The latest messages about packs; a charge from a monitor without a voltage is not one."""
        return [new for new in self.messages.values() if self._is_about_pack(new)]

    def missing_reason(self, t_s: float) -> str:
        """Return why no monitor is known to measure the pack now; `""` if one does."""
        recent = [b for b in self.messages.values() if t_s - b.t_s <= BATTERY_MAX_AGE_S]
        battery = self.battery
        is_recent = battery is not None and t_s - battery.t_s <= BATTERY_MAX_AGE_S
        if battery and is_recent and (battery.voltage_v, battery.current_a) != (None, None):
            return ""
        received = ", ".join(map(_monitor_text, recent)) or "nothing"
        return f"no battery voltage: received {received}; expected a monitor that measures the pack"

    @property
    def monitor_notes(self) -> list[str]:
        """The monitor that measures the pack, if it is not the first."""
        battery = self._measured.get(self._monitor) if self._monitor else None
        return [f"{_monitor_text(battery)}, by its voltage"] if battery else []

    def _merge_battery(self, battery: Battery) -> Battery:
        """Merge the two messages about the pack; a field stays until reported again or too old."""
        fields: dict[str, float | None] = {}
        for name in (
            "voltage_v",
            "current_a",
            "consumed_ah",
            "consumed_j",
            "remaining_frac",
            "temperature_c",
        ):
            value = getattr(battery, name)
            if value is not None:
                self._field_times_s[name] = battery.t_s
            elif (
                self.battery is not None
                and (reported_s := self._field_times_s.get(name)) is not None
                and battery.t_s - reported_s <= BATTERY_MAX_AGE_S
            ):
                value = getattr(self.battery, name)
            fields[name] = value
        return Battery(battery.t_s, **fields, pack=None)

    def current_age_s(self, t_s: float) -> float:
        """Return the age of the last current report; infinite without one."""
        reported_s = self._field_times_s.get("current_a")
        return math.inf if reported_s is None else t_s - reported_s


def _monitor_text(battery: Battery) -> str:
    monitor = "SYS_STATUS" if battery.pack is None else f"battery {battery.pack}"
    return (
        monitor if battery.remaining_frac is None else f"{monitor} at {battery.remaining_frac:.0%}"
    )
