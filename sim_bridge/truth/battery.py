"""A lithium-polymer pack: open-circuit voltage, sag, cut-off, and the energy that remains.

Thevenin model with one polarisation branch. Voltage and the rise of resistance at low charge
after Chen and Rincon-Mora, "Accurate electrical battery model capable of predicting runtime and
I-V performance", IEEE Trans. Energy Conversion 21(2), 2006, eqs. 2 and 3 (a polymer Li-ion cell,
3.80 V on average), raised towards full charge for cells with a higher charging voltage.

Temperature changes resistance by an Arrhenius law; ageing changes capacity and resistance. The
cells keep their initial temperature. The electrolyte of a lithium-polymer cell alone gives 1,800 K
(17.1 kJ/mol: Ecker et al., J. Electrochem. Soc. 162, A1836, 2015), charge transfer more: the 2,250
K of params/truth are between. A pack below its cut-off voltage for `cutoff_delay_s` switches off,
and the vehicle loses its thrust.
"""

import math

from sim_bridge.truth.params import BatteryParams

_REFERENCE_K = 298.15
_KELVIN = 273.15
_LOW_CHARGE_GAIN = 0.1562 / 0.07446  # Chen and Rincon-Mora eq. 3: R_series at empty over at full
_LOW_CHARGE_RATE = 24.37
_SLICES = 48


_CURVE_FULL_V = 3.685 + 0.2156 - 0.1178 + 0.3201  # Chen and Rincon-Mora's cell at full charge


def open_circuit_cell_v(charge_frac: float, full_cell_v: float = _CURVE_FULL_V) -> float:
    """Resting voltage of a cell (Chen and Rincon-Mora 2006, eq. 2).

    Cells that are charged higher (4.20 V, or 4.35 V for LiHV) rise further over their upper half:
    the difference is added with the square of charge, as their published curves diverge.
    """
    s = charge_frac
    curve = 3.685 + s * (0.2156 + s * (-0.1178 + s * 0.3201))
    return curve + (full_cell_v - _CURVE_FULL_V) * s * s - 1.031 * math.exp(-35.0 * s)


class Battery:
    """A pack under discharge. Charge never rises; cut-off is permanent."""

    __slots__ = (
        "_capacity_c",
        "_cells",
        "_cutoff_v",
        "_full_cell_v",
        "_params",
        "_polarisation_ohm",
        "_polarisation_v",
        "_resistance_ohm",
        "_under_voltage_s",
        "charge_frac",
        "chemical_j",
        "current_a",
        "cut_off",
        "delivered_j",
        "lost_j",
        "temperature_c",
        "voltage_v",
    )

    def __init__(
        self,
        params: BatteryParams,
        *,
        charge_frac: float = 1.0,
        temperature_c: float = 25.0,
        health_frac: float = 1.0,
    ) -> None:
        """A rested pack. `health_frac` is its capacity now over its capacity when new."""
        kelvin = temperature_c + _KELVIN
        cold = math.exp(params.resistance_activation_k * (1.0 / kelvin - 1.0 / _REFERENCE_K))
        worn = 1.0 + params.resistance_growth_per_fade * (1.0 - health_frac)
        self._params = params
        self._cells = params.cells
        self._full_cell_v = params.full_cell_v
        self._capacity_c = params.capacity_ah * 3600.0 * health_frac
        self._resistance_ohm = params.resistance_ohm * cold * worn
        self._polarisation_ohm = params.polarisation_ohm * cold * worn
        self._polarisation_v = 0.0
        self._cutoff_v = params.cells * params.cutoff_cell_v
        self._under_voltage_s = 0.0
        self.temperature_c = temperature_c
        self.charge_frac = charge_frac
        self.voltage_v = params.cells * open_circuit_cell_v(charge_frac, params.full_cell_v)
        self.current_a = 0.0
        self.cut_off = False
        self.delivered_j = 0.0
        self.lost_j = 0.0
        self.chemical_j = 0.0

    @property
    def capacity_ah(self) -> float:
        """Present capacity of the pack."""
        return self._capacity_c / 3600.0

    @property
    def polarisation_energy_j(self) -> float:
        """Energy held by the polarisation capacitance, C v^2 / 2 with C = time constant / R."""
        if self._polarisation_ohm == 0.0:
            return 0.0
        farad = self._params.polarisation_time_s / self._polarisation_ohm
        return 0.5 * farad * self._polarisation_v**2

    def _series_ohm(self, charge_frac: float) -> float:
        rise = _LOW_CHARGE_GAIN * math.exp(-_LOW_CHARGE_RATE * charge_frac)
        return self._resistance_ohm * (1.0 + rise)

    def discharge_at_power(self, power_w: float, dt_s: float) -> None:
        """Deliver `power_w` at the terminals for `dt_s`; after cut-off deliver nothing.

        Sets `voltage_v` and `current_a`. A draw beyond what the pack can give (V_oc^2 / 4 R)
        gets the largest power that it can, and sags towards the cut-off.
        """
        if self.cut_off:
            power_w = 0.0
        open_v = self._cells * open_circuit_cell_v(self.charge_frac, self._full_cell_v)
        series_ohm = self._series_ohm(self.charge_frac)
        source_v = open_v - self._polarisation_v
        current_a = _current_for_power_a(source_v, series_ohm, power_w)
        self.current_a = current_a
        self.voltage_v = source_v - current_a * series_ohm
        if self.cut_off:
            return
        self._update_charge_and_energies(current_a, open_v, series_ohm, dt_s)
        self._update_cutoff(dt_s)

    def _update_charge_and_energies(
        self, current_a: float, open_v: float, series_ohm: float, dt_s: float
    ) -> None:
        ohm = self._polarisation_ohm
        before_v = self._polarisation_v
        settled = -math.expm1(-dt_s / self._params.polarisation_time_s)
        self._polarisation_v += (current_a * ohm - before_v) * settled
        if ohm > 0.0:
            mean_v = 0.5 * (before_v + self._polarisation_v)
            self.lost_j += mean_v * mean_v / ohm * dt_s
        self.lost_j += current_a * current_a * series_ohm * dt_s
        self.delivered_j += self.voltage_v * current_a * dt_s
        self.chemical_j += open_v * current_a * dt_s
        self.charge_frac = max(self.charge_frac - current_a * dt_s / self._capacity_c, 0.0)

    def _update_cutoff(self, dt_s: float) -> None:
        low = self.voltage_v < self._cutoff_v
        self._under_voltage_s = self._under_voltage_s + dt_s if low else 0.0
        if self.charge_frac <= 0.0 or self._under_voltage_s > self._params.cutoff_delay_s:
            self.cut_off = True

    def short_one_cell(self) -> None:
        """Short a cell: the pack loses its voltage, and its cut-off is one cell lower."""
        self._cells -= 1
        self._cutoff_v = self._cells * self._params.cutoff_cell_v

    def settled_loaded_voltage_v(self, charge_frac: float, draw_w: float) -> float:
        """Settled terminal voltage at a charge under a constant draw; 0 if it cannot deliver it."""
        open_v = self._cells * open_circuit_cell_v(charge_frac, self._full_cell_v)
        ohm = self._series_ohm(charge_frac) + self._polarisation_ohm
        inside = open_v * open_v - 4.0 * ohm * draw_w
        return 0.0 if inside < 0.0 else 0.5 * (open_v + math.sqrt(inside))

    def usable_wh(self, draw_w: float) -> float:
        """Compute the energy in Wh deliverable at this constant draw until cut-off.

        Uses settled voltages: a charged pack at rest delivers slightly more until polarisation
        builds up.
        """
        if self.cut_off or self.settled_loaded_voltage_v(self.charge_frac, draw_w) < self._cutoff_v:
            return 0.0
        empty = self._charge_frac_at_cutoff(draw_w)
        width = (self.charge_frac - empty) / _SLICES
        total_v = sum(
            self.settled_loaded_voltage_v(empty + (index + 0.5) * width, draw_w)
            for index in range(_SLICES)
        )
        return total_v * width * self._capacity_c / 3600.0

    def _charge_frac_at_cutoff(self, draw_w: float) -> float:
        """Charge at which the settled voltage under `draw_w` meets the cut-off (bisection)."""
        low, high = 0.0, self.charge_frac
        if self.settled_loaded_voltage_v(low, draw_w) >= self._cutoff_v:
            return 0.0
        for _ in range(24):
            middle = 0.5 * (low + high)
            if self.settled_loaded_voltage_v(middle, draw_w) < self._cutoff_v:
                low = middle
            else:
                high = middle
        return high


def _current_for_power_a(source_v: float, ohm: float, power_w: float) -> float:
    """Return the lesser root of V I - R I^2 = P, or the current of maximum power if there is no
    root."""
    if ohm == 0.0:
        return power_w / source_v
    inside = source_v * source_v - 4.0 * ohm * power_w
    if inside < 0.0:
        return source_v / (2.0 * ohm)
    return 2.0 * power_w / (source_v + math.sqrt(inside))
