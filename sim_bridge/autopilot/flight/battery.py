"""The autopilot's battery monitor: voltage, current, charge used, charge remaining."""

import math
from dataclasses import dataclass

from sim_bridge.autopilot.kinds import BatterySensing


@dataclass(frozen=True, slots=True)
class Px4Cells:
    """PX4's BAT1_* parameters: how charge is read from resting voltage and capacity."""

    cells: int
    charged_v: float
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
        """As the autopilot computed it last; a reboot keeps it until the next computation."""
        self.reset()

    def reset(self) -> None:
        """Start counting at zero, as at boot."""
        self.voltage_v: float | None = None
        self.current_a: float | None = None
        self.temperature_c: float | None = None
        self.consumed_mah = 0.0
        self.consumed_j = 0.0
        self.knows_current = False
        self.current_avg_a = 0.0
        self.timer_s = 0.0
        self._px4_charge_frac: float | None = None
        self._counted_mah = 0.0

    def step(
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
        self.knows_current = True
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
        if not self.knows_current or capacity_mah <= 0.0:
            return None
        return min(max((capacity_mah - self.consumed_mah) / capacity_mah, 0.0), 1.0)

    def sih_remaining_frac(self, drain_s: float, least_frac: float) -> float:
        """SIH's percentage: a timer that runs while armed."""
        return max(1.0 - self.timer_s / max(drain_s, 1.0), least_frac)

    def px4_remaining_frac(self, cells: Px4Cells) -> float | None:
        """Charge by resting cell voltage, blended with the counted charge where capacity is known.

        Source: PX4, src/lib/battery/battery.cpp (calculateStateOfChargeVoltageBased,
        estimateStateOfCharge). Call it at a steady rate.
        """
        if self.voltage_v is None or cells.cells <= 0:
            return None
        cell_v = self.voltage_v / cells.cells
        if self.current_a is not None and cells.internal_ohm > 0.0:
            cell_v += cells.internal_ohm * self.current_a
        span = max(cells.charged_v - cells.empty_v, 0.01)
        by_voltage = min(max((cell_v - cells.empty_v) / span, 0.0), 1.0)
        if cells.capacity_mah <= 0.0 or not self.knows_current:
            return by_voltage
        charge = self._px4_charge_frac
        if charge is None or not math.isfinite(charge):
            charge = by_voltage
        weight = 3e-4 * (1.0 - by_voltage)
        charge += weight * (by_voltage - charge)
        charge -= (self.consumed_mah - self._counted_mah) / cells.capacity_mah
        self._counted_mah = self.consumed_mah
        self._px4_charge_frac = min(max(charge, 0.0), 1.0)
        return self._px4_charge_frac
