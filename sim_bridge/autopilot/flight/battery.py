"""The autopilot's battery monitor: voltage, current, charge used, charge remaining."""

import math
from dataclasses import dataclass

from sim_bridge.autopilot.kinds import BatterySensing


@dataclass(frozen=True, slots=True)
class Px4Cells:
    """PX4's BAT1_* parameters: how charge is read from resting voltage and capacity."""

    cells: int
    full_v: float
    empty_v: float
    capacity_mah: float
    internal_ohm: float


class BatteryMonitor:
    """Integrates current since boot; unknown is None.

    A reboot loses the integral, as in the real autopilots: the charge used before is forgotten.
    """

    def __init__(self, sensing: BatterySensing = BatterySensing.POWER_MODULE) -> None:
        self.sensing = sensing
        self.remaining_frac: float | None = None
        """Result of the autopilot's last computation; a reboot keeps it until the next one."""
        self.reset()

    def reset(self) -> None:
        """Start counting at zero, as at boot."""
        self.voltage_v: float | None = None
        self.current_a: float | None = None
        self.temperature_c: float | None = None
        self.consumed_mah = 0.0
        self.consumed_j = 0.0
        self.has_current = False
        self.current_avg_a = 0.0
        self.timer_s = 0.0
        self._px4_charge_frac: float | None = None
        self._counted_mah = 0.0

    def update_from_readings(
        self,
        voltage_v: float | None,
        current_a: float | None,
        temperature_c: float,
        dt_s: float,
        *,
        armed: bool,
    ) -> None:
        """Take one reading."""
        self.voltage_v = voltage_v
        self.current_a = current_a
        self.temperature_c = temperature_c
        if armed:
            self.timer_s += dt_s
        if current_a is None:
            return
        self.has_current = True
        self.consumed_mah += current_a * dt_s / 3.6
        self.current_avg_a += dt_s / 10.0 * (current_a - self.current_avg_a)
        if voltage_v is not None:
            self.consumed_j += current_a * voltage_v * dt_s

    @property
    def reported_current_a(self) -> float | None:
        """Current in the messages; PX4's SIH measures none."""
        return None if self.sensing is BatterySensing.SIH_TIMER else self.current_a

    def ardupilot_remaining_frac(self, capacity_mah: float) -> float | None:
        """Share of BATT_CAPACITY not yet drawn since boot."""
        if not self.has_current or capacity_mah <= 0.0:
            return None
        return min(max((capacity_mah - self.consumed_mah) / capacity_mah, 0.0), 1.0)

    def sih_timer_remaining_frac(
        self, full_drain_time_s: float, min_remaining_frac: float
    ) -> float:
        """SIH's percentage: a timer that runs while armed."""
        return max(1.0 - self.timer_s / max(full_drain_time_s, 1.0), min_remaining_frac)

    def update_px4_remaining_frac(self, cell_params: Px4Cells) -> float | None:
        """Charge by resting cell voltage, blended with the counted charge where capacity is known.

        Source: PX4, src/lib/battery/battery.cpp (calculateStateOfChargeVoltageBased,
        estimateStateOfCharge). Call it at a steady rate.
        """
        if self.voltage_v is None or cell_params.cells <= 0:
            return None
        cell_v = self.voltage_v / cell_params.cells
        if self.current_a is not None and cell_params.internal_ohm > 0.0:
            cell_v += cell_params.internal_ohm * self.current_a
        span = max(cell_params.full_v - cell_params.empty_v, 0.01)
        by_voltage = min(max((cell_v - cell_params.empty_v) / span, 0.0), 1.0)
        if cell_params.capacity_mah <= 0.0 or not self.has_current:
            return by_voltage
        charge = self._px4_charge_frac
        if charge is None or not math.isfinite(charge):
            charge = by_voltage
        weight = 3e-4 * (1.0 - by_voltage)
        charge += weight * (by_voltage - charge)
        charge -= (self.consumed_mah - self._counted_mah) / cell_params.capacity_mah
        self._counted_mah = self.consumed_mah
        self._px4_charge_frac = min(max(charge, 0.0), 1.0)
        return self._px4_charge_frac
